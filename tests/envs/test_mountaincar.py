"""MountainCar against gymnasium's MountainCarContinuous-v0, which keeps its state in single precision.

Gymnasium computes a step from the state that it is given and rounds the result. So the two are compared step by step,
each from the same state: what remains is that rounding, and that of 3 x where x was rounded before.
"""

from collections.abc import Callable

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.base import State
from gpcjax.envs.experts import ValleyPump
from gpcjax.envs.mountaincar import MountainCar

Plant = Callable[..., State]
StepAll = Callable[[np.ndarray, np.ndarray, np.ndarray], State]

WALL, FLOOR = -1.2, -np.pi / 6


def rounding(values: np.ndarray) -> np.ndarray:
    """How far a number that was rounded to single precision may be from itself, after our own rounding."""
    return np.spacing(np.abs(np.float32(values))).astype(float) / 2 + 1e-15


@pytest.fixture
def reference() -> gymnasium.Env:
    """With its time limit."""
    env = gymnasium.make("MountainCarContinuous-v0")
    env.reset(seed=0)
    return env


@pytest.fixture
def step_all(plant: Plant) -> StepAll:
    """A step from each state, with each action, after each number of steps."""
    env = MountainCar()
    step = lambda physics, action, time: env.step(plant(env, physics, time), action)  # noqa: E731
    return lambda *planted: jax.tree.map(np.asarray, jax.jit(jax.vmap(step))(*planted))


def test_one_step_from_anywhere(reference: gymnasium.Env, step_all: StepAll) -> None:
    rng = np.random.default_rng(0)
    physics = rng.uniform([WALL, -0.07], [0.6, 0.07], (400, 2))
    physics[:60, 0] = rng.uniform(WALL, WALL + 0.05, 60)
    physics[60:120, 0] = rng.uniform(0.4, 0.5, 60)
    actions = np.concatenate([rng.uniform(-1, 1, 300), np.resize([1.0, -1.0, 0.0], 100)])
    car = reference.unwrapped
    after = step_all(physics, actions[:, None], np.zeros(400, int))
    for i, (start, action) in enumerate(zip(physics, actions, strict=True)):
        car.state = np.array(start)
        expected, reward, terminated, _, _ = car.step(np.array([action]))
        assert (np.abs(after.physics[i] - expected) <= rounding(expected)).all()
        np.testing.assert_allclose(after.reward[i], reward, rtol=0, atol=1e-12)
        assert after.terminated[i] == terminated
    at_wall = after.physics[:, 0] == WALL
    assert at_wall.any() and not after.physics[at_wall, 1].any(), "no car came to the wall"
    assert (np.abs(after.physics[:, 1]) == 0.07).any(), "no velocity was clipped"
    assert (after.physics[:, 0] == 0.6).any(), "no car came to the bound on the right"
    assert set(after.terminated) == {True, False}
    np.testing.assert_array_equal(after.obs, after.physics)


@pytest.mark.parametrize(
    ("policy", "arrives"),
    [pytest.param("expert", True, marks=pytest.mark.slow), ("noisy expert", True), ("random", False)],
)
def test_whole_episode(
    policy: str, arrives: bool, reference: gymnasium.Env, plant: Plant, step_all: StepAll
) -> None:
    """Ours takes each step from the state that gymnasium has rounded."""
    rng, pump = np.random.default_rng(1), jax.jit(ValleyPump())
    choose = {
        "expert": lambda obs: np.asarray(pump(obs)),
        "noisy expert": lambda obs: np.clip(np.asarray(pump(obs)) + rng.normal(size=1), -1, 1),
        "random": lambda obs: rng.uniform(-1, 1, 1),
    }[policy]
    starts, actions, results, over = [np.asarray(reference.unwrapped.state)], [], [], False
    while not over:
        actions.append(choose(starts[-1]))
        obs, reward, terminated, truncated, _ = reference.step(actions[-1])
        results.append((reward, terminated, truncated))
        starts.append(obs.astype(float))
        over = terminated or truncated
    assert (terminated, truncated) == (arrives, not arrives)

    expected = np.stack(starts[1:])
    after = step_all(np.stack(starts[:-1]), np.stack(actions), np.arange(len(actions)))
    # 3 x, rounded at up to 3.6, is that far from the cosine's argument; it moves velocity and position alike.
    of_slope = 0.0025 * np.spacing(np.float32(3.6)).astype(float) / 2
    assert (np.abs(after.physics - expected) <= rounding(expected) + of_slope).all()
    reward, terminated, truncated = map(np.array, zip(*results, strict=True))
    np.testing.assert_allclose(after.reward, reward, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(after.terminated, terminated)
    np.testing.assert_array_equal(after.truncated, truncated)


@pytest.mark.parametrize(
    ("x", "velocity", "goal_velocity", "time", "terminated", "truncated"),
    [
        (0.44, 0.02, 0.0, 0, True, False),
        (0.44, 0.0, 0.0, 0, False, False),
        (0.5, -0.03, 0.0, 0, False, False),  # beyond the goal, but on the way back
        (0.44, 0.02, 0.03, 0, False, False),
        (0.44, 0.04, 0.03, 0, True, False),
        (-0.5, 0.0, 0.0, 997, False, False),
        (-0.5, 0.0, 0.0, 998, False, True),
        (0.44, 0.02, 0.0, 998, True, True),
    ],
)
def test_ends(
    x: float,
    velocity: float,
    goal_velocity: float,
    time: int,
    terminated: bool,
    truncated: bool,
    plant: Plant,
) -> None:
    env = MountainCar(goal_velocity=goal_velocity)
    state = env.step(plant(env, np.array([x, velocity]), time), jnp.array([0.5]))
    assert (state.terminated, state.truncated, state.done) == (terminated, truncated, terminated or truncated)
    assert state.time == time + 1
    np.testing.assert_allclose(state.reward, 100.0 * terminated - 0.1 * 0.25, rtol=1e-15)


def test_the_wall_stops_a_car_and_lets_it_go(plant: Plant) -> None:
    env = MountainCar()
    stopped = env.step(plant(env, np.array([-1.19, -0.06])), jnp.array([-1.0]))
    np.testing.assert_array_equal(stopped.physics, [WALL, 0.0])
    assert not stopped.done
    away = env.step(stopped, jnp.array([-1.0]))
    assert away.physics[0] > WALL and away.physics[1] > 0, "the slope is steeper than the motor is strong"


def test_action_is_clipped_and_charged_as_clipped(plant: Plant) -> None:
    env = MountainCar()
    state = plant(env, np.array([-0.5, 0.01]))
    for wild, legal in ((5.0, 1.0), (-np.inf, -1.0)):
        got, want = env.step(state, jnp.array([wild])), env.step(state, jnp.array([legal]))
        np.testing.assert_array_equal(got.physics, want.physics)
        assert got.reward == want.reward == -0.1


def test_reset(starts: Callable[[int], jax.Array]) -> None:
    state = jax.jit(jax.vmap(MountainCar().reset))(starts(2000))
    x, velocity = np.asarray(state.physics).T
    assert -0.6 <= x.min() < -0.599 and -0.401 < x.max() <= -0.4
    np.testing.assert_allclose(np.histogram(x, 4, (-0.6, -0.4))[0], 500, atol=80)
    for zero in (velocity, state.done, state.time, state.reward):
        assert not np.asarray(zero).any()


@pytest.mark.slow
def test_parameters_are_vmapped(plant: Plant) -> None:
    powers = jnp.array([0.0005, 0.0015, 0.01])
    physics = jnp.array([-0.7, 0.02])

    def push(power: jax.Array) -> jax.Array:
        env = MountainCar(power=power)
        return env.step(plant(env, physics), jnp.array([0.7])).physics

    car = gymnasium.make("MountainCarContinuous-v0").unwrapped
    for power, got in zip(powers, jax.vmap(push)(powers), strict=True):
        car.state, car.power = np.asarray(physics), float(power)
        expected = car.step(np.array([0.7]))[0]
        assert (np.abs(np.asarray(got) - expected) <= rounding(expected)).all()


def test_parameters_are_leaves_and_sizes_static() -> None:
    leaves = jax.tree.leaves(MountainCar())
    assert len(leaves) == 9
    assert all(eqx.is_array(leaf) and leaf.dtype == jnp.float64 for leaf in leaves)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"power": 0.0}, "power must be finite and > 0, got 0"),
        ({"gravity": -1.0}, "gravity must be finite and >= 0, got -1"),
        ({"goal_position": np.nan}, "goal_position must be finite, got nan"),
        ({"max_position": -1.3}, "max_position must be right of min_position, got -1.3 and -1.2"),
        ({"max_steps": 0}, "max_steps 0: give a whole number"),
    ],
)
def test_impossible_parameters(bad: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=f"mountaincar: {message}"):
        MountainCar(**bad)


def test_pump_reaches_the_goal_from_every_start(
    expert_returns: Callable[..., np.ndarray], starts: Callable[[int], jax.Array]
) -> None:
    """Also from rest on the valley's floor, where a push along the velocity would be none."""
    returns = expert_returns(MountainCar(), ValleyPump(), starts(100))
    assert 96 < returns.mean() < 98 and returns.min() > 95
    resting = MountainCar(start_position=FLOOR, start_range=0.0)
    assert expert_returns(resting, ValleyPump(), starts(100)).min() > 95
    assert ValleyPump(nudge=0.0)(jnp.array([FLOOR, 0.0])) == 0 < ValleyPump()(jnp.array([FLOOR, 0.0]))


def test_pump_is_bounded_and_smooth() -> None:
    obs = np.random.default_rng(0).uniform([WALL, -0.07], [0.6, 0.07], (2000, 2))
    by_each = jax.jit(lambda pump, observations: jax.vmap(pump)(observations))
    act = lambda observations, strength=0.7: by_each(ValleyPump(strength=strength), observations)  # noqa: E731
    action = np.asarray(act(obs))
    assert 0.69 < np.abs(action).max() <= 0.7
    np.testing.assert_allclose(np.sign(action[:, 0]), np.sign(obs[:, 1] + 0.001))
    assert np.abs(act(obs + 1e-6) - action).max() < 1e-3
    assert np.abs(act(obs, 5.0)).max() == 1
