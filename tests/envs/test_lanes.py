"""What every environment and expert of ours owes to a batched engine."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.base import Env, State
from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.experts import LQR, EnergySwingUp
from gpcjax.envs.pendulum import Pendulum

Starts = Callable[[int], jax.Array]
TASKS = pytest.mark.parametrize(
    ("make_env", "make_expert"),
    [(CartPole, LQR), pytest.param(Pendulum, EnergySwingUp, marks=pytest.mark.slow)],
    ids=["cartpole", "pendulum"],
)


def steps(env: Env, expert: Callable[[jax.Array], jax.Array], state: State, axis: int, n: int) -> State:
    def advance(state: State, _: None) -> tuple[State, None]:
        action = jax.vmap(expert, in_axes=axis, out_axes=axis)(state.obs)
        return jax.vmap(env.step, in_axes=axis, out_axes=axis)(state, action), None

    return jax.lax.scan(advance, state, None, n)[0]


@TASKS
def test_seeds_differ_and_repeat(make_env: type, make_expert: type, starts: Starts) -> None:
    env = make_env()
    reset = jax.jit(jax.vmap(env.reset))
    first = np.asarray(reset(starts(50)).physics)
    assert len(np.unique(first, axis=0)) == 50
    for column in first.T:
        assert len(np.unique(column)) == 50
    np.testing.assert_array_equal(first, reset(starts(50)).physics)


@TASKS
@pytest.mark.parametrize("axis", [pytest.param(0, marks=pytest.mark.slow), -1])
def test_batched_equals_single(make_env: type, make_expert: type, axis: int, starts: Starts) -> None:
    env, expert, n = make_env(), make_expert(), 5
    begun, reset = jax.jit(jax.vmap(env.reset, out_axes=axis))(starts(n)), jax.jit(env.reset)
    batch = jax.jit(lambda s: steps(env, expert, s, axis, 40))(begun)
    single = jax.jit(lambda s: jax.lax.scan(lambda s, _: (env.step(s, expert(s.obs)), None), s, None, 40)[0])
    for lane, key in enumerate(starts(n)):
        alone = single(reset(key))
        got = jax.tree.map(lambda leaf, lane=lane: np.take(np.asarray(leaf), lane, axis), batch)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-12), got, alone)


@TASKS
def test_types_are_those_of_a_carry(make_env: type, make_expert: type) -> None:
    env = make_env()
    state = env.reset(jax.random.key(0))
    after = jax.eval_shape(env.step, state, jnp.zeros(1))
    before = jax.eval_shape(lambda: state)
    assert jax.tree.structure(before) == jax.tree.structure(after)
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (old.shape, old.dtype, old.weak_type) == (new.shape, new.dtype, new.weak_type)
    assert state.obs.shape == (env.obs_size,) and state.obs.dtype == jnp.float64
    assert make_expert()(state.obs).shape == (env.action_size,) == (1,)


@TASKS
def test_one_trace(make_env: type, make_expert: type, starts: Starts) -> None:
    traces = 0

    @eqx.filter_jit
    def advance(env: Env, expert: Callable[[jax.Array], jax.Array], state: State) -> State:
        nonlocal traces
        traces += 1
        return steps(env, expert, state, -1, 3)

    state = jax.vmap(make_env().reset, out_axes=-1)(starts(4))
    for _ in range(3):
        state = advance(make_env(), make_expert(), state)
    heavier = eqx.tree_at(lambda env: env.gravity, make_env(), jnp.asarray(11.0, jnp.float64))
    advance(heavier, make_expert(), state)
    assert traces == 1


@TASKS
def test_an_episode_never_resets_itself(make_env: type, make_expert: type) -> None:
    env = make_env(max_steps=2)
    step, state, times = jax.jit(env.step), env.reset(jax.random.key(3)), []
    for _ in range(4):
        state = step(state, jnp.ones(1))
        times.append((int(state.time), bool(state.truncated)))
    assert times == [(1, False), (2, True), (3, True), (4, True)]


@TASKS
def test_names_and_sizes_are_read_without_tracing(make_env: type, make_expert: type) -> None:
    def sizes(env: Env) -> tuple[str, int, int, int]:
        return env.name, env.obs_size, env.action_size, env.max_steps

    assert all(isinstance(size, int) for size in sizes(make_env())[1:])
    assert eqx.filter_jit(lambda env: jnp.zeros(env.obs_size))(make_env()).shape == (make_env().obs_size,)


def test_an_env_must_be_complete() -> None:
    with pytest.raises(TypeError, match="abstract"):
        Env()  # pyright: ignore[reportAbstractUsage]
