"""CartPole against gymnasium's CartPole-v1, whose `force_mag` is set to the force of each step."""

from collections.abc import Callable

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.base import State
from gpcjax.envs.cartpole import CartPole

Plant = Callable[..., State]

step = jax.jit(lambda env, state, action: env.step(state, action))


class Reference:
    """gymnasium's cart-pole, planted anywhere and pushed by any force."""

    def __init__(self) -> None:
        self.env = gymnasium.make("CartPole-v1").unwrapped

    def plant(self, physics: np.ndarray) -> None:
        self.env.reset(seed=0)
        self.env.state = np.array(physics)

    def step(self, action: float) -> tuple[np.ndarray, float, bool]:
        self.env.force_mag = abs(10.0 * action)
        _, reward, terminated, _, _ = self.env.step(int(action > 0))
        return np.asarray(self.env.state), reward, terminated


@pytest.fixture
def reference() -> Reference:
    return Reference()


def test_one_step_from_anywhere(reference: Reference, plant: Plant) -> None:
    rng = np.random.default_rng(0)
    physics = rng.uniform(-1, 1, (300, 4)) * [2.6, 3.0, 0.24, 3.0]
    actions = np.concatenate([rng.uniform(-1, 1, 200), np.resize([1.0, -1.0, 0.0], 100)])
    env = CartPole()
    one = lambda p, action: env.step(plant(env, p), action)  # noqa: E731
    after = jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(physics, actions[:, None]))
    seen = set()
    for i, (start, action) in enumerate(zip(physics, actions, strict=True)):
        reference.plant(start)
        expected, reward, terminated = reference.step(action)
        np.testing.assert_allclose(after.physics[i], expected, rtol=0, atol=1e-12)
        assert after.reward[i] == reward
        assert after.terminated[i] == terminated
        seen.add(terminated)
    assert seen == {True, False}
    np.testing.assert_array_equal(after.obs, after.physics)


@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 4)), 0])
def test_whole_episode(seed: int, reference: Reference, plant: Plant) -> None:
    """Each follows the same noisy law from its own state: open-loop, the pole would amplify rounding without end."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-0.05, 0.05, 4)
    env = CartPole()
    state = plant(env, start)
    reference.plant(start)
    expected = start
    for length in range(1, 2000):
        noise = 3.0 * rng.normal()  # it falls sooner
        actions = [
            float(np.clip(9 * s[2] + 2.4 * s[3] + noise, -1, 1))
            for s in (np.asarray(state.physics), expected)
        ]
        state = step(env, state, np.array(actions[:1]))
        expected, reward, terminated = reference.step(actions[1])
        np.testing.assert_allclose(state.physics, expected, rtol=0, atol=1e-10)
        seen = tuple(map(np.asarray, (state.reward, state.terminated, state.time)))
        assert seen == (reward, terminated, length)
        if terminated:
            break
    assert length > 20
    assert state.terminated and not state.truncated and state.done


def test_action_is_clipped(plant: Plant) -> None:
    env = CartPole()
    state = plant(env, np.zeros(4))
    for wild, legal in ((5.0, 1.0), (-np.inf, -1.0)):
        got, want = (step(env, state, np.array([action])) for action in (wild, legal))
        np.testing.assert_array_equal(got.physics, want.physics)


@pytest.mark.parametrize(
    ("x", "theta", "time", "terminated", "truncated"),
    [
        (0.0, 0.0, 0, False, False),
        (2.5, 0.0, 0, True, False),
        (-2.5, 0.0, 0, True, False),
        (0.0, 0.22, 0, True, False),
        (0.0, -0.22, 0, True, False),
        (0.0, 0.0, 2498, False, False),
        (0.0, 0.0, 2499, False, True),
        (2.5, 0.0, 2499, True, True),
    ],
)
def test_ends(x: float, theta: float, time: int, terminated: bool, truncated: bool, plant: Plant) -> None:
    env = CartPole()
    state = step(env, plant(env, np.array([x, 0.0, theta, 0.0]), time), np.zeros(1))
    assert (state.terminated, state.truncated, state.done) == (terminated, truncated, terminated or truncated)
    assert state.time == time + 1
    assert state.reward == 1


def test_reset(starts: Callable[[int], jax.Array]) -> None:
    env = CartPole()
    state = jax.jit(jax.vmap(env.reset))(starts(2000))
    physics = np.asarray(state.physics)
    assert np.abs(physics).max() <= 0.05
    np.testing.assert_allclose(physics.min(0), -0.05, atol=1e-3)
    np.testing.assert_allclose(physics.max(0), 0.05, atol=1e-3)
    assert (
        not np.asarray(state.done).any()
        and not np.asarray(state.time).any()
        and not np.asarray(state.reward).any()
    )


def test_parameters_are_vmapped(plant: Plant) -> None:
    masses = jnp.array([0.05, 0.1, 0.4])
    physics = jnp.array([0.1, -0.2, 0.05, 0.3])

    def push(mass: jax.Array) -> jax.Array:
        env = CartPole(pole_mass=mass)
        return env.step(plant(env, physics), jnp.array([0.7])).physics

    reference = Reference().env
    for mass, got in zip(masses, jax.jit(jax.vmap(push))(masses), strict=True):
        reference.reset(seed=0)
        reference.masspole, reference.total_mass = float(mass), 1.0 + float(mass)
        reference.polemass_length, reference.force_mag = 0.5 * float(mass), 7.0
        reference.state = np.asarray(physics)
        reference.step(1)
        np.testing.assert_allclose(got, reference.state, rtol=0, atol=1e-12)


def test_parameters_are_leaves_and_sizes_static() -> None:
    leaves = jax.tree.leaves(CartPole())
    assert len(leaves) == 9
    assert all(eqx.is_array(leaf) and leaf.dtype == jnp.float64 for leaf in leaves)


@pytest.mark.parametrize(
    "bad",
    [{"cart_mass": 0.0}, {"half_length": -1.0}, {"tau": np.nan}, {"gravity": np.inf}, {"max_steps": 0}],
)
def test_impossible_parameters(bad: dict[str, float]) -> None:
    (name,) = bad
    with pytest.raises(ValueError, match=rf"cartpole: {name} (must be|0: give a whole number)"):
        CartPole(**bad)
