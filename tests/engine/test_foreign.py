"""Tasks of other people that give something else than they declare: one line that names the class and the field."""

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.engine.rollout import Loop
from gpcjax.envs.base import State, started, stepped
from gpcjax.envs.host import HostEnv
from gpcjax.errors import UserError
from tests.engine.tasks import Drift, expert, learner, oracle

KEY = jax.random.key(0)


class Odd(Drift):
    """`Drift` whose reset or step replaces fields of the state, as a module that is checked by nobody would."""

    after_reset: dict = eqx.field(default_factory=dict, static=True)
    after_step: dict = eqx.field(default_factory=dict, static=True)

    __hash__ = Drift.__hash__
    __eq__ = Drift.__eq__

    def reset(self, key):
        return replaced(super().reset(key), self.after_reset)

    def step(self, state, action):
        return replaced(super().step(state, action), self.after_step)


def replaced(state, changes):
    for name, change in changes.items():
        value = change(getattr(state, name))
        state = eqx.tree_at(lambda state, name=name: getattr(state, name), state, value)
    return state


def flat(value):
    return value[None]


ODD = [
    (
        "obs",
        lambda obs: jnp.zeros(3),
        r"obs is float64 of shape \(3,\), declared is real numbers of shape \(2,\)",
    ),
    ("obs", flat, r"obs is float64 of shape \(1, 2\), declared"),
    ("obs", lambda obs: obs > 0, r"obs is bool of shape \(2,\), declared is real numbers"),
    ("obs", lambda obs: None, r"obs is None, declared"),
    ("reward", flat, r"reward is float64 of shape \(1,\), declared is a real number of shape \(\)"),
    ("reward", lambda reward: reward + 1j, r"reward is complex128 of shape \(\), declared"),
    (
        "terminated",
        lambda flag: flag * 1.0,
        r"terminated is float64 of shape \(\), declared is a truth value",
    ),
    ("truncated", flat, r"truncated is bool of shape \(1,\), declared is a truth value of shape \(\)"),
    ("time", lambda time: time * 1.0, r"time is float64 of shape \(\), declared is a whole number"),
]


@pytest.mark.parametrize(("name", "change", "message"), ODD)
def test_a_compiled_task_is_named_with_its_field(name, change, message):
    wrong = Odd(after_reset={name: change}), Odd(after_step={name: change})
    with pytest.raises(UserError, match=rf"^Odd\.reset: {message}"):
        jax.eval_shape(lambda: started(wrong[0], KEY))
    with pytest.raises(UserError, match=rf"^Odd\.step: {message}"):
        jax.eval_shape(lambda: stepped(wrong[1], started(wrong[1], KEY), jnp.zeros(2)))


def test_physics_keep_their_form():
    env = Odd(after_step={"physics": lambda physics: jnp.zeros(3)})
    with pytest.raises(UserError, match=r"^Odd\.step: physics becomes .*\(3,\).*, it was .*\(2,\)"):
        jax.eval_shape(lambda: stepped(env, started(env, KEY), jnp.zeros(2)))
    env = Odd(after_step={"physics": lambda physics: (physics, physics)})
    with pytest.raises(UserError, match=r"^Odd\.step: physics becomes "):
        jax.eval_shape(lambda: stepped(env, started(env, KEY), jnp.zeros(2)))


def test_a_state_is_a_state(monkeypatch):
    monkeypatch.setattr(Odd, "reset", lambda self, key: (jnp.zeros(2), {}))
    with pytest.raises(UserError, match=r"^Odd\.reset gives a tuple, declared is a State"):
        jax.eval_shape(lambda: started(Odd(), KEY))


def test_other_real_numbers_are_taken():
    """Observations of float32 and whole rewards are cast; counts become those of the loops."""
    single = {"obs": lambda obs: obs.astype(jnp.float32), "time": lambda time: time.astype(int)}
    env = Odd(
        after_reset=single, after_step={**single, "reward": lambda reward: jnp.int32(1), "truncated": bool_}
    )
    state = jax.eval_shape(lambda: stepped(env, started(env, KEY), jnp.zeros(2)))
    assert isinstance(state, State)
    assert [getattr(state, name).dtype for name in ("obs", "reward", "time")] == [
        "float64",
        "float64",
        "int32",
    ]


def bool_(flag):
    return np.bool_(False)


@pytest.mark.parametrize("policy", [lambda obs: jnp.zeros(2), lambda obs: np.zeros(2)], ids=["jax", "numpy"])
def test_evaluate_says_it(policy):
    with pytest.raises(UserError, match=r"^Odd\.step: reward is float64 of shape \(1,\), declared"):
        gpcjax.evaluate(Odd(after_step={"reward": flat}), policy, 2)
    with pytest.raises(UserError, match=r"^Odd\.reset: obs is float64 of shape \(1, 2\), declared"):
        gpcjax.evaluate(Odd(after_reset={"obs": flat}), policy, 2)


def test_the_teaching_loop_says_it():
    given = learner("coach"), oracle()
    with pytest.raises(UserError, match=r"^Odd\.reset: obs is "):
        jax.eval_shape(lambda: Loop(Odd(after_reset={"obs": flat}), expert, 2).begin(*given, jnp.int64(0), 2))

    def taught():
        loop = Loop(Odd(after_step={"reward": flat}), expert, 2)
        lane = loop.begin(*given, jnp.int64(0), 2)
        after, _ = loop._act(lanes(lane.env), lanes(lane.tally), jnp.zeros((2, 1)), jnp.ones(1, bool))
        return after

    with pytest.raises(UserError, match=r"^Odd\.step: reward is float64 of shape \(1,\), declared"):
        jax.eval_shape(taught)


def lanes(tree):
    return jax.tree.map(lambda leaf: leaf[..., None], tree)


class OddGym(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)
    started, given = (np.zeros(2), {}), (np.zeros(2), 0.0, False, False, {})

    def reset(self, *, seed=None, options=None):
        return self.started

    def step(self, action):
        return self.given


gymnasium.register("OddGym-v0", entry_point=OddGym)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((np.zeros(3), 0.0, False, False, {}), r"obs is float64 of shape \(3,\), declared is real numbers"),
        (([True, False], 0.0, False, False, {}), r"obs is \[True, False\], declared is real numbers"),
        ((np.zeros(2), np.zeros(1), False, False, {}), r"reward is float64 of shape \(1,\), declared is a real number"),
        ((np.zeros(2), None, False, False, {}), r"reward is None, declared is a real number"),
        ((np.zeros(2), 0.0, 0.0, False, {}), r"terminated is 0.0, declared is a truth value"),
        (None, r"result is None, declared is \(obs, reward, terminated, truncated, info\)"),
        ((np.zeros(2), 0.0, False, {}), r"result is .*, declared is \(obs, reward, terminated, truncated, info\)"),
    ],
    ids=str,
)  # fmt: skip
def test_a_simulated_task_is_named_with_its_field(monkeypatch, given, message):
    env = HostEnv("odd", "OddGym-v0", 3)
    monkeypatch.setattr(OddGym, "given", given)
    with pytest.raises(UserError, match=rf"^OddGym\.step: {message}"):
        gpcjax.evaluate(env, lambda obs: np.zeros(1), 2)


def test_so_is_its_reset(monkeypatch):
    env = HostEnv("odd", "OddGym-v0", 3)
    for given, message in (
        (np.zeros(2), "result is float64"),
        (np.zeros(3), "result is"),
        (([0.0], {}), "obs is"),
    ):
        monkeypatch.setattr(OddGym, "started", given)
        with pytest.raises(UserError, match=rf"^OddGym\.reset: {message}"):
            env.simulate().reset(0)


def test_other_forms_of_numbers_are_taken_there_too(monkeypatch):
    env = HostEnv("odd", "OddGym-v0", 3)
    monkeypatch.setattr(OddGym, "given", ([0, 1], np.float32(0.5), np.bool_(False), False, {}))
    assert gpcjax.evaluate(env, lambda obs: np.zeros(1), 2).returns.tolist() == [1.5, 1.5]
