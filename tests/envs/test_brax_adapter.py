"""brax environments in our shape."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.brax_adapter import BraxEnv, brax_env

# brax and its dependencies announce deprecations as they load and run
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")


@pytest.fixture
def fast() -> BraxEnv:
    return brax_env("fast", max_steps=4)


@functools.partial(jax.jit, static_argnums=(0, 2))
def _run(env: BraxEnv, action: jax.Array, n: int, key: jax.Array) -> Any:
    def advance(state: Any, _: None) -> tuple[Any, Any]:
        state = env.step(state, action)
        return state, state

    return jax.lax.scan(advance, env.reset(key), None, n)[1]


def run(env: BraxEnv, action: Any, n: int, seed: int = 0) -> Any:
    return _run(env, action, n, jax.random.key(seed))


def test_fast(fast: BraxEnv) -> None:
    assert (fast.name, fast.obs_size, fast.action_size, fast.max_steps) == ("fast", 2, 1, 4)
    states = run(fast, jnp.ones(1), 5)
    np.testing.assert_array_equal(states.time, [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(states.truncated, [False, False, False, True, True])
    assert not states.terminated.any()
    np.testing.assert_allclose(states.obs[:, 1], 0.02 * np.arange(1, 6))
    np.testing.assert_array_equal(states.reward, states.obs[:, 0])
    assert states.obs.dtype == states.reward.dtype == jnp.float64


def test_traced_once(fast: BraxEnv) -> None:
    step, state = jax.jit(fast.step), fast.reset(jax.random.key(0))
    before = fast.env.step_count
    for _ in range(5):
        state = step(state, jnp.ones(1))
    assert fast.env.step_count == before + 1


@pytest.mark.slow
def test_inverted_pendulum() -> None:
    env = brax_env("inverted_pendulum", max_steps=50)
    assert (env.name, env.obs_size, env.action_size) == ("inverted_pendulum", 4, 1)
    states = run(env, jnp.array([7.0]), 30)
    np.testing.assert_array_equal(states.terminated, np.abs(states.obs[:, 1]) > 0.2)
    assert states.terminated.any() and not states.truncated.any()
    np.testing.assert_array_equal(states.reward, 1.0)
    np.testing.assert_array_equal(states.obs, run(env, jnp.array([1.0]), 30).obs)
    assert not np.allclose(states.obs[0], run(env, jnp.array([7.0]), 30, seed=1).obs[0])


def test_lanes_on_the_last_axis(fast: BraxEnv) -> None:
    keys = jax.random.split(jax.random.key(0), 3)
    state = jax.jit(jax.vmap(fast.reset, out_axes=-1))(keys)
    after = jax.jit(jax.vmap(fast.step, in_axes=-1, out_axes=-1))(state, jnp.array([[1.0, -1.0, 0.5]]))
    assert after.obs.shape == (2, 3)
    np.testing.assert_allclose(after.obs[1], [0.02, 0.0, 0.02])


def test_truncation_by_brax_is_no_termination() -> None:
    from brax.envs.wrappers.training import EpisodeWrapper

    fast = brax_env("fast").env
    env = brax_env(EpisodeWrapper(fast, episode_length=3, action_repeat=1))
    states = run(env, jnp.ones(1), 3)
    assert env.name == "Fast" and env.max_steps == 1000
    np.testing.assert_array_equal(states.truncated, [False, False, True])
    assert not states.terminated.any()


def test_refusals() -> None:
    from brax.envs.wrappers.training import AutoResetWrapper, VmapWrapper

    fast = brax_env("fast").env
    with pytest.raises(ValueError, match=r"unknown brax environment 'fats'; allowed: ant, fast, .*walker2d"):
        brax_env("fats")
    with pytest.raises(ValueError, match="Fast is wrapped in AutoResetWrapper"):
        brax_env(AutoResetWrapper(VmapWrapper(fast, 2)))
    with pytest.raises(ValueError, match="max_steps 0: give a whole number from 1"):
        brax_env("fast", max_steps=0)
    with pytest.raises(ValueError, match="backend: only a brax environment given by its name"):
        brax_env(fast, backend="spring")
    with pytest.raises(ValueError, match="fast: observations must be one flat array"):
        brax_env("fast", obs_mode="dict_state")
