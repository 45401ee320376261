"""Pendulum against gymnasium's Pendulum-v1; its state is compared, since its observations are float32."""

from collections.abc import Callable

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.base import State
from gpcjax.envs.pendulum import Pendulum

Plant = Callable[..., State]


@pytest.fixture
def reference() -> gymnasium.Env:
    env = gymnasium.make("Pendulum-v1").unwrapped
    env.reset(seed=0)
    return env


def test_one_step_from_anywhere(reference: gymnasium.Env, plant: Plant) -> None:
    rng = np.random.default_rng(0)
    physics = rng.uniform(-1, 1, (300, 2)) * [20.0, 8.0]
    actions = rng.uniform(-1.5, 1.5, 300)
    env = Pendulum()
    step = lambda p, action: env.step(plant(env, p), action)  # noqa: E731
    after = jax.tree.map(np.asarray, jax.jit(jax.vmap(step))(physics, actions[:, None]))
    for i, (start, action) in enumerate(zip(physics, actions, strict=True)):
        reference.state = np.array(start)
        _, reward, terminated, _, _ = reference.step(np.array([2 * action]))
        np.testing.assert_allclose(after.physics[i], reference.state, rtol=0, atol=1e-12)
        np.testing.assert_allclose(after.reward[i], reward, rtol=0, atol=1e-12)
        theta, theta_dot = reference.state
        np.testing.assert_allclose(
            after.obs[i], [np.cos(theta), np.sin(theta), theta_dot], rtol=0, atol=1e-12
        )
        assert after.terminated[i] == terminated == False  # noqa: E712


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 5))])
def test_whole_episode(seed: int, reference: gymnasium.Env, plant: Plant) -> None:
    rng = np.random.default_rng(seed)
    start = rng.uniform(-1, 1, 2) * [np.pi, 1.0]
    env = Pendulum()
    step = jax.jit(lambda state, action: (after := env.step(state, action), after.done))
    state, done = plant(env, start), False
    reference.state = start
    for time in range(1, 201):
        assert not done
        action = np.clip(np.sign(reference.state[1]) + 0.3 * rng.normal(), -1, 1)
        state, done = step(state, np.array([action]))
        _, reward, _, _, _ = reference.step(np.array([2 * action]))
        np.testing.assert_allclose(state.physics, reference.state, rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.reward, reward, rtol=0, atol=1e-8)
        assert state.time == time
    assert state.truncated and not state.terminated and done
    assert np.abs(reference.state[0]) > 2 * np.pi, "the rod never turned over, so nothing was normalised"


def test_cost_at_the_seam(plant: Plant) -> None:
    env = Pendulum()
    for theta in (np.pi, -np.pi, 3 * np.pi, np.nextafter(np.pi, 0)):
        np.testing.assert_allclose(
            env.step(plant(env, np.array([theta, 0.0])), jnp.zeros(1)).reward, -(np.pi**2)
        )


def test_reset(starts: Callable[[int], jax.Array]) -> None:
    state = jax.jit(jax.vmap(Pendulum().reset))(starts(4000))
    theta, theta_dot = np.asarray(state.physics).T
    assert np.abs(theta).max() <= np.pi and np.abs(theta_dot).max() <= 1
    assert (
        min(np.abs(theta.min()), theta.max()) > 3.1 and min(np.abs(theta_dot.min()), theta_dot.max()) > 0.99
    )
    np.testing.assert_allclose(state.obs, np.stack([np.cos(theta), np.sin(theta), theta_dot], -1), atol=1e-14)


@pytest.mark.slow
def test_parameters_are_vmapped(plant: Plant) -> None:
    gravities = jnp.array([5.0, 9.81, 20.0])
    physics = jnp.array([2.0, -0.5])

    def swing(gravity: jax.Array) -> jax.Array:
        env = Pendulum(gravity=gravity)
        return env.step(plant(env, physics), jnp.array([0.3])).physics

    for gravity, got in zip(gravities, jax.vmap(swing)(gravities), strict=True):
        reference = gymnasium.make("Pendulum-v1", g=float(gravity)).unwrapped
        reference.reset(seed=0)
        reference.state = np.asarray(physics)
        reference.step(np.array([0.6]))
        np.testing.assert_allclose(got, reference.state, rtol=0, atol=1e-12)


def test_impossible_parameters() -> None:
    with pytest.raises(ValueError, match="pendulum: mass must be finite and > 0, got -1"):
        Pendulum(mass=-1.0)
