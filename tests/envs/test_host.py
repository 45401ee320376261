"""Tasks on the host: what gymnasium simulates, one simulation an episode, and the lander's expert."""

import itertools

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.envs.box2d.lunar_lander import heuristic

from gpcjax.engine import streams
from gpcjax.engine.evaluate import evaluate, idle
from gpcjax.envs.experts import LanderHeuristic
from gpcjax.envs.host import HostEnv, Simulation, lunar_lander
from gpcjax.envs.registry import make_env
from tests.engine.host_tasks import host_drift


def random_actions(seed: int, steps: int, size: int = 2) -> np.ndarray:
    """As gymnasium takes them, float32."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, size)).astype(np.float32)


def episode(simulation: Simulation, seed: int, actions: np.ndarray) -> list[np.ndarray]:
    """Observation, reward and both flags of every step, after the first observation."""
    trace = [simulation.reset(seed)]
    for action in actions:
        outcome = simulation.step(action.astype(float))
        trace.append(np.array([*outcome.obs, outcome.reward, outcome.terminated, outcome.truncated]))
        if outcome.terminated or outcome.truncated:
            break
    return trace


def assert_same(got: list[np.ndarray], expected: list[np.ndarray]) -> None:
    assert len(got) == len(expected)
    for step, (a, b) in enumerate(zip(got, expected, strict=True)):
        np.testing.assert_array_equal(a, b, err_msg=f"step {step}")


class TestParity:
    """What gymnasium itself says, through all of its wrappers."""

    @pytest.mark.parametrize("seed", [0, 1, 2**32 - 1])
    def test_lunar_lander(self, seed: int) -> None:
        """Down to the ground, by the engines' luck; observations are float32, and none of their bits is lost."""
        theirs, ours = gymnasium.make("LunarLander-v3", continuous=True), lunar_lander().simulate()
        first, _ = theirs.reset(seed=seed)
        obs = ours.reset(seed)
        assert obs.dtype == np.float64 and first.dtype == np.float32
        np.testing.assert_array_equal(obs, first)
        for action in random_actions(seed, 1000):
            obs, reward, terminated, truncated, _ = theirs.step(action)
            got = ours.step(action.astype(float))
            np.testing.assert_array_equal(got.obs, obs)
            assert (got.reward, got.terminated, got.truncated) == (reward, terminated, truncated)
            if terminated or truncated:
                break
        assert terminated and not truncated
        theirs.close()

    def test_truncated_at_max_steps(self) -> None:
        """Theirs and ours, also in a second episode; hovering keeps the lander in the air."""
        theirs = gymnasium.make("LunarLander-v3", continuous=True, max_episode_steps=40)
        ours = lunar_lander(max_steps=40).simulate()
        for seed in (3, 4):
            obs, _ = theirs.reset(seed=seed)
            ours.reset(seed)
            for step in range(1, 41):
                action = heuristic(theirs, obs)
                obs, _, terminated, truncated, _ = theirs.step(action)
                got = ours.step(action)
                assert not terminated and not got.terminated
                assert truncated == got.truncated == (step == 40)

    def test_actions_are_scaled_to_other_bounds(self) -> None:
        """The pendulum's torque goes up to 2; beyond it is clipped."""
        env, theirs = HostEnv("swing", "Pendulum-v1", 200), gymnasium.make("Pendulum-v1")
        ours = env.simulate()
        np.testing.assert_array_equal(ours.reset(5), theirs.reset(seed=5)[0])
        actions = random_actions(5, 198, 1).astype(float)
        for action in [*actions, np.array([1.0]), np.array([-7.0])]:
            obs, reward, terminated, truncated, _ = theirs.step(2 * action.clip(-1, 1))
            got = ours.step(env.scaled(action))
            np.testing.assert_array_equal(got.obs, obs)
            assert (got.reward, got.terminated, got.truncated) == (reward, terminated, truncated)
        assert truncated
        together = env.scaled(np.array([[-7.0, -0.5, 0.0, 1.0]]))
        np.testing.assert_array_equal(together, [[-2.0, -1.0, 0.0, 2.0]])

    def test_options_reach_gymnasium(self) -> None:
        windy = HostEnv("windy", "LunarLander-v3", 1000, {"continuous": True, "enable_wind": True})
        theirs = gymnasium.make("LunarLander-v3", continuous=True, enable_wind=True)
        theirs.reset(seed=0)
        trace = episode(windy.simulate(), 0, random_actions(0, 20))
        for action, got in zip(random_actions(0, 20), trace[1:], strict=True):
            np.testing.assert_array_equal(got[:8], theirs.step(action)[0])
        still = episode(lunar_lander().simulate(), 0, random_actions(0, 20))
        assert not np.array_equal(trace[-1], still[-1])


class TestSimulation:
    env = lunar_lander()

    def test_sizes(self) -> None:
        assert (self.env.name, self.env.obs_size, self.env.action_size, self.env.max_steps) == (
            *("lunarlander", 8, 2),
            1000,
        )

    @pytest.mark.parametrize("options", [{}, {"enable_wind": True, "turbulence_power": 1.5}])
    def test_an_episode_follows_from_its_seed_and_actions_alone(self, options: dict) -> None:
        """Whatever was simulated before: nothing, the same, another seed up to its end, or a few steps of it."""
        env = HostEnv("lander", "LunarLander-v3", 1000, {"continuous": True, **options})
        actions, simulation = random_actions(0, 300), env.simulate()
        expected = episode(simulation, 7, actions)
        assert len(expected) > 50
        assert_same(episode(simulation, 7, actions), expected)
        episode(simulation, 8, random_actions(1, 1000))
        assert_same(episode(simulation, 7, actions), expected)
        episode(simulation, 9, random_actions(2, 5))
        simulation.reset(10)
        assert_same(episode(simulation, 7, actions), expected)
        assert_same(episode(env.simulate(), 7, actions), expected)

    def test_seeds_and_actions_make_a_difference(self) -> None:
        simulation, actions = self.env.simulate(), random_actions(0, 3)
        first = [simulation.reset(seed) for seed in range(30)]
        assert len(np.unique(first, axis=0)) == 30
        a, b = episode(simulation, 0, actions), episode(simulation, 0, -actions)
        assert not np.array_equal(a[-1], b[-1])

    def test_two_simulations_do_not_disturb_each_other(self) -> None:
        alone = [episode(self.env.simulate(), seed, random_actions(seed, 60)) for seed in (0, 1)]
        pair = [self.env.simulate() for _ in range(2)]
        together = [[simulation.reset(seed)] for seed, simulation in enumerate(pair)]
        for step, seed in itertools.product(range(60), (0, 1)):
            outcome = pair[seed].step(random_actions(seed, 60)[step].astype(float))
            together[seed].append(
                np.array([*outcome.obs, outcome.reward, outcome.terminated, outcome.truncated])
            )
        for got, expected in zip(together, alone, strict=True):
            assert_same(got[: len(expected)], expected)

    @pytest.mark.parametrize("env", [env, host_drift()], ids=lambda env: env.name)
    def test_what_is_beyond_is_clipped(self, env: HostEnv) -> None:
        """Whether the task does that by itself or not."""
        actions = 3 * random_actions(4, 40).T
        assert (np.abs(actions) > 1).any(1).all()
        scaled = env.scaled(actions)
        np.testing.assert_array_equal(scaled, env.scaled(actions.clip(-1, 1)))
        simulation = env.simulate()
        assert_same(episode(simulation, 4, scaled.T), episode(simulation, 4, scaled.T.clip(-1, 1)))

    def test_an_observation_is_kept(self) -> None:
        """No later step writes into it."""
        simulation = HostEnv("swing", "Pendulum-v1", 200).simulate()
        first = simulation.reset(0)
        second, copy = simulation.step(np.ones(1)).obs, first.copy()
        after = second.copy()
        simulation.step(np.ones(1))
        np.testing.assert_array_equal(first, copy)
        np.testing.assert_array_equal(second, after)


@pytest.mark.filterwarnings("ignore:.*LunarLander-v2 is out of date")
@pytest.mark.parametrize(
    ("gym_id", "max_steps", "message"),
    [
        ("LunarLander-v2", 10, r"task: gymnasium cannot make 'LunarLander-v2': .*LunarLander-v3"),
        ("NoSuchTask-v0", 10, r"task: gymnasium cannot make 'NoSuchTask-v0': .*NoSuchTask"),
        ("CartPole-v1", 10, r"task: its actions are Discrete\(2\), a bounded flat Box is supported"),
        ("LunarLander-v3", 10, r"task: its actions are Discrete\(4\), a bounded flat Box is supported"),
        ("CarRacing-v3", 10, r"task: its observations are Box\(.*\(96, 96, 3\).*, a flat Box is supported"),
        ("FrozenLake-v1", 10, r"task: its observations are Discrete\(16\), a flat Box is supported"),
        ("Pendulum-v1", 0, r"task: max_steps 0: give a whole number from 1"),
    ],
)
def test_refusals(gym_id: str, max_steps: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HostEnv("task", gym_id, max_steps)


class TestLanderHeuristic:
    expert = staticmethod(jax.jit(LanderHeuristic()))

    def agrees(self, observations: np.ndarray) -> np.ndarray:
        env = gymnasium.make("LunarLander-v3", continuous=True)
        got = np.asarray(jax.jit(jax.vmap(LanderHeuristic()))(observations.astype(float)))
        np.testing.assert_allclose(got, [heuristic(env, obs) for obs in observations], atol=1e-5)
        return got

    def test_on_random_states(self) -> None:
        """With no leg, one or both on the ground; most of their actions are no bounds."""
        rng = np.random.default_rng(0)
        obs = rng.normal(size=(1000, 8)) * [0.5, 0.05, 0.3, 0.05, 0.2, 0.1, 0, 0]
        obs[:, 6:] = rng.random((1000, 2)) < 0.3
        actions = self.agrees(obs)
        assert (np.abs(actions) < 1).mean() > 0.2 and {-1.0, 1.0} <= set(actions.ravel().tolist())

    def test_on_visited_states(self) -> None:
        """As gymnasium gives them, float32."""
        env = gymnasium.make("LunarLander-v3", continuous=True)
        visited = [env.reset(seed=0)[0]]
        for _ in range(250):
            visited.append(env.step(heuristic(env, visited[-1]))[0])
        visited = np.stack(visited)
        assert visited.dtype == np.float32 and visited[:, 6:].any() and not visited[:, 6:].all()
        self.agrees(visited)

    def test_lanes_may_be_last_and_numbers_of_their_own(self) -> None:
        obs = np.random.default_rng(1).normal(size=(8, 5))
        batch = jax.jit(jax.vmap(self.expert, in_axes=-1, out_axes=-1))(obs)
        np.testing.assert_allclose(batch.T, [self.expert(each) for each in obs.T], atol=1e-12)
        steep = LanderHeuristic(lean=0.1)(jnp.array([2.0, 1, 0, 0, 0.04, 0, 0, 0]))
        np.testing.assert_allclose(steep[1], -20.0 * 0.5 * (0.1 - 0.04), rtol=1e-12)


def test_evaluate_on_the_host() -> None:
    """The expert lands; each start is that of its seed's first episode, whatever the number of starts."""
    env = lunar_lander()
    landed = evaluate(env, LanderHeuristic(), starts=4)
    assert landed.returns.shape == landed.length.shape == (4,)
    assert landed.returns.mean() > 240 and len(np.unique(landed.returns)) == 4
    fallen = evaluate(env, idle(env), starts=3)
    assert fallen.returns.mean() < -50
    still = [
        episode(env.simulate(), streams.reset_seeds(seed, 1)[0], np.zeros((1000, 2))) for seed in range(3)
    ]
    np.testing.assert_allclose(fallen.returns, [sum(step[8] for step in trace[1:]) for trace in still])
    np.testing.assert_array_equal(fallen.length, [len(trace) - 1 for trace in still])
    assert np.ptp(fallen.length) > 0


@pytest.mark.slow
def test_a_task_of_mujoco():
    pytest.importorskip("imageio", reason="the extra mujoco is not installed")
    env = make_env("gym:InvertedPendulum-v5")
    assert isinstance(env, HostEnv) and (env.obs_size, env.action_size) == (4, 1)
    found = evaluate(env, lambda obs: np.clip(2 * obs[1:2] + obs[3:4], -1, 1), 2)
    # A reward of one for each step, but for the one in which it falls.
    assert abs(np.asarray(found.returns) - found.length).max() <= 1 and found.length.min() > 10
