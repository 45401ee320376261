"""Learners, tasks and oracles of a person's own, made and called from Python."""

import dataclasses
import sys
import types

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.fixed import fixed
from gpcjax.registry import find
from tests.trees import assert_same_bits


class Units(gpcjax.Learner):
    """Whole numbers and a text, which are no arrays; and a number."""

    units: int = 3
    kind: str = "more"
    step_size: jax.Array = eqx.field(default=0.5, converter=gpcjax.parameter)

    def init(self, key):
        return jnp.zeros((self.units, self.action_size, self.obs_size))

    def propose(self, state, obs):
        total = sum(state[unit] @ obs for unit in range(self.units))
        return total if self.kind == "more" else -total

    def learn(self, state, moment, advice, key):
        change = self.step_size * jnp.outer(advice, moment.obs)
        return state + change[None], gpcjax.Info.of(rate=jnp.abs(change @ moment.obs))


STEP = gpcjax.Setting("step_size", "alpha", gpcjax.Numbers(0, 1, above=True), "how far", default=0.5)
SIZES = {"obs_size": 2, "action_size": 1}
OBS = np.array([0.3, -0.1])


@pytest.fixture
def module(monkeypatch):
    """A person's module, `mine_here`."""
    made = types.ModuleType("mine_here")
    monkeypatch.setitem(sys.modules, "mine_here", made)
    monkeypatch.setattr("gpcjax.registry._FOUND", {})
    made.Units = Units
    made.UNITS = gpcjax.LearnerSpec(name="units", make=Units, settings=(STEP,))
    return made


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("UNITS", {"step_size": 5.0}, r"^step_size 5.0: give a number from 0 to 1"),
        ("UNITS", {"step_size": np.nan}, "^step_size nan: give a number"),
        ("UNITS", {"step_size": [0.1, 0.2]}, r"^step_size \[0.1, 0.2\]: give a number"),
        ("Units", {"step_size": "0.5"}, "^step_size '0.5': give a finite number"),
        ("Units", {"step_size": True}, "^step_size True: give a finite number"),
        ("Units", {"units": 2.5}, "^units 2.5: give a whole number"),
        ("Units", {"unit": 2}, r"'unit' is not an option of this learner \(did you mean units\?\)"),
    ],
)
def test_settings_are_held_to_their_bounds(module, name, value, message):
    with pytest.raises(ValueError, match=message):
        gpcjax.make_learner(f"mine_here:{name}", **SIZES, **value)


def test_all_that_a_class_takes_may_be_given(module):
    made = gpcjax.make_learner("mine_here:Units", **SIZES, units=np.int64(2), kind="less", step_size=1)
    assert (made.units, made.kind, float(made.step_size)) == (2, "less", 1.0)


@pytest.mark.parametrize("kind", ["more", "less"])
def test_one_made_by_its_class_has_a_policy(kind):
    learner = Units(**SIZES, kind=kind)
    state, _ = learner.correct(learner.init(jax.random.key(0)), OBS, [0.0], [1])
    action = learner.act(state, OBS)
    assert action != 0
    assert_same_bits(learner.policy_of(state)(OBS), action)
    session = gpcjax.Session(learner, state)
    np.testing.assert_array_equal(session.policy()(OBS), action)


class Several(Units):
    shapes: list = dataclasses.field(default_factory=lambda: [jnp.tanh, jnp.sin])
    more: dict = dataclasses.field(default_factory=lambda: {"kind": "more", "by": 2})

    def propose(self, state, obs):
        return self.shapes[0](self.more["by"] * super().propose(state, obs))


def test_several_functions_in_a_field_are_compiled_in(tmp_path):
    learner, shapes = Several(**SIZES), [jnp.tanh, jnp.sin]
    state, _ = learner.correct(learner.init(jax.random.key(0)), OBS, [0.0], [1])
    assert_same_bits(learner.policy_of(state)(OBS), learner.act(state, OBS))
    np.testing.assert_array_equal(gpcjax.Session(learner, state).policy()(OBS), learner.act(state, OBS))
    gpcjax.save_learner(tmp_path / "saved", learner, state)
    assert_same_bits(gpcjax.load_learner(tmp_path / "saved")[1], state)
    changed = fixed(Several(**SIZES, shapes=shapes))
    shapes.clear()
    assert_same_bits(changed.act(state, OBS), learner.act(state, OBS))


def test_a_function_beside_numbers_is_refused():
    learner = Several(**SIZES, shapes=[jnp.tanh, 0.5])
    state = learner.init(jax.random.key(0))
    for use in (lambda: learner.policy_of(state), lambda: gpcjax.Session(learner)):
        with pytest.raises(
            ValueError, match=r"^Several.shapes\[0\] .*: there are numbers beside it, give it a"
        ):
            use()


LEARNERS = {
    "gpc": lambda: gpcjax.make_learner("gpc", **SIZES, capacity=4),
    "coach": lambda: gpcjax.make_learner(
        "coach", obs_size=2, action_size=1, lower=-1, upper=1, counts=[3, 3]
    ),
    "d-coach": lambda: gpcjax.make_learner("d-coach", **SIZES, width=4, buffer_size=8, batch_size=2),
    "units": lambda: fixed(Units(**SIZES)),
}


@pytest.mark.parametrize(
    "name", ["coach", "units", *(pytest.param(name, marks=pytest.mark.slow) for name in ("gpc", "d-coach"))]
)
def test_a_policy_stays_when_its_state_is_given_away(name):
    learner = LEARNERS[name]()
    state, _ = learner.correct(learner.init(jax.random.key(0)), OBS, [0.0], [1])
    early, late = learner.policy_of(state), learner.policy_of(state)
    before = np.array(early(OBS))
    for _ in range(3):
        state, _ = learner.correct(state, OBS, [0.0], [1], donate=True)
    assert_same_bits(np.array(early(OBS)), before)
    assert_same_bits(np.array(late(OBS)), before)
    assert_same_bits(np.array(late(jnp.asarray(OBS))), np.array(early(jnp.asarray(OBS))))


def test_a_class_that_is_written_anew_is_the_new_one(module):
    def drift(reward):
        class Drift(gpcjax.Env):
            obs_size, action_size, max_steps = 1, 1, 5

            def reset(self, key):
                return self.begin(jnp.zeros(1))

            def step(self, state, action):
                return self.advance(state, state.physics, reward=reward)

        return Drift

    for reward in (1.0, 2.0):
        module.Drift = drift(reward)
        env = gpcjax.make_env("mine_here:Drift")
        assert gpcjax.evaluate(env, lambda obs: obs, 1).returns.tolist() == [5 * reward]
    assert find("task", "mine_here:Drift") is find("task", "mine_here:Drift")
    with pytest.raises(ValueError, match=r"^mine_here:Drift has no expert: give expert_name"):
        gpcjax.make_oracle("mine_here:Drift")


class Drawn(Units):
    """What it learns is drawn."""

    def learn(self, state, moment, advice, key):
        return jax.random.uniform(key, state.shape), gpcjax.Info.of(rate=jnp.abs(advice))


@pytest.mark.parametrize(
    ("name", "value", "algo"),
    [
        ("jax_random_seed_offset", 7, "drawn"),
        *(
            pytest.param(*setting, "d-coach", marks=pytest.mark.slow)
            for setting in (("jax_random_seed_offset", 7), ("jax_default_prng_impl", "rbg"))
        ),
    ],
)
def test_what_is_drawn_without_a_key_is_drawn_alike(name, value, algo):
    drawing = gpcjax.make_learner("d-coach", **SIZES, width=4, buffer_size=8, batch_size=2)
    learner = drawing if algo == "d-coach" else Drawn(**SIZES)
    twice = []
    before = getattr(jax.config, name)
    try:
        for each in (before, value):
            jax.config.update(name, each)
            if each is value:
                jax.clear_caches()
            state = learner.init(None)
            for _ in range(3):
                state, _ = learner.correct(state, OBS, [0.0], [1])
            twice.append((state, drawing.init()))
    finally:
        jax.config.update(name, before)
    assert_same_bits(*twice)


@pytest.fixture(scope="module")
def session():
    """Which has learned nothing, before and after each test."""
    return gpcjax.Session(Units(**SIZES))


@pytest.mark.parametrize(
    ("obs", "message"),
    [
        ([[0.1], [0.2], [0.3]], r"give real numbers of shape \(2, points\)"),
        ([0.1, 0.2], r"give real numbers of shape \(2, points\)"),
        ([[0.1], [0.2, 0.3]], r"give real numbers of shape \(2, points\)"),
        ([["a"], ["b"]], r"give real numbers of shape \(2, points\)"),
        ([[np.nan], [0.2]], "each entry must be finite"),
    ],
)
def test_observations_of_act_at(session, obs, message):
    with pytest.raises(ValueError, match=rf"^obs .*{message}"):
        session.act_at(obs)
    assert session.act_at([[0, 1, 2], [0, 1, 2]]).shape == (1, 3)


def test_a_note_is_what_json_knows(session, tmp_path):
    recorded = gpcjax.Session(Units(**SIZES), record=tmp_path / "it.jsonl")
    for each in (session, recorded):
        each.note(x=np.float32(1), several=np.arange(2), yes=np.True_, jaxs=jnp.float64(0.5), text="a")
        for value in (np.nan, jnp.inf, object(), {1, 2}, np.array("2026", "M8")):
            with pytest.raises(ValueError, match=r"^note .*: give what JSON knows"):
                each.note(x=value)
    assert '"values": {"x": 1.0, "several": [0, 1], "yes": true, "jaxs": 0.5, "text": "a"}' in (
        tmp_path / "it.jsonl"
    ).read_text("utf-8")


def test_an_advice_of_zero_is_one_to_take_back(session):
    session.propose(OBS)
    session.advise(0)
    assert (session.undos, session.corrections) == (1, 0)
    assert session.undo() and session.undos == 0


def test_an_oracle_is_given_numbers_and_a_key():
    oracle, key = gpcjax.make_oracle("cartpole", rate=1.0), jax.random.key(0)
    others = [np.zeros(size, np.uint32) for size in (0, 1, 4, 5)]  # of old-style keys' type
    for given in (0, None, jax.random.split(key, 2), np.zeros(2), *others):
        with pytest.raises(ValueError, match=r"^key .*: give a random key, from jax.random.key"):
            oracle.advise(given, np.zeros(4), [0.0])
    with pytest.raises(ValueError, match=r"^obs .*: each entry must be finite"):
        oracle.advise(key, [np.nan, 0, 0, 0], [0.0])
    with pytest.raises(ValueError, match=r"^action .*: each entry must be finite"):
        oracle.advise(key, np.zeros(4), [np.nan])
    old = jax.random.key_data(key)
    assert oracle.advise(old, np.zeros(4), [0.0]) == oracle.advise(key, np.zeros(4), [0.0])
    # COACH does not know how uncertain it is.
    oracle.advise(key, np.zeros(4), [0.0], sigma_human=[np.nan])
    assert jax.jit(oracle.advise)(key, jnp.zeros(4), jnp.zeros(1)).shape == (1,)


@pytest.mark.parametrize("value", [np.array([0.1, 0.2]), jnp.array([0.1]), np.float64("nan")])
def test_a_parameter_of_a_task_is_one_number(value):
    with pytest.raises(ValueError, match=r"^cartpole: pole_mass .*: give a finite number"):
        gpcjax.make_env("cartpole", pole_mass=value)
    masses = jax.vmap(lambda mass: gpcjax.make_env("cartpole", pole_mass=mass).pole_mass)(jnp.ones(2))
    assert masses.tolist() == [1.0, 1.0]
    assert float(gpcjax.make_env("cartpole", pole_mass=np.float32(0.5)).pole_mass) == 0.5


def test_a_whole_number_of_any_length_is_told():
    assert gpcjax.Numbers(whole=True).admits(10**400)
    assert not gpcjax.Numbers(0, 9, whole=True).admits(10**400)
