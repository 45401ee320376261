"""What a learner of a person's own has learned, as arrays and the recipe that makes it again."""

import dataclasses
import enum
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.learners.carried import carried
from gpcjax.learners.descriptions import LEARNERS
from gpcjax.learners.packed import unpack_learner
from gpcjax.learners.recipes import Recipe, check_recipe, pack_own
from gpcjax.sweep.packing import packed, unpacked
from tests.trees import assert_same_bits

ROOT = Path(__file__).parents[2]
HERE = "tests.learners.test_recipes"
(SPEC,) = (spec for spec in LEARNERS if spec.name == "gpc")
GROWING = dataclasses.replace(SPEC, name=f"{HERE}:GROWING")
"""A description with a dictionary, which is not built in."""


class Counting(gpcjax.Learner):
    """A state of several types, with a number that is infinite until something is learned."""

    gain: float = 0.5

    def init(self, key):
        draw = jax.random.normal(key, (self.action_size, self.obs_size))
        return {"weights": draw, "count": jnp.int32(0), "seen": jnp.zeros(0), "least": jnp.inf}

    def propose(self, state, obs):
        return state["weights"] @ obs

    def learn(self, state, moment, advice, key):
        change = self.gain * jnp.outer(advice, moment.obs)
        new = {"weights": state["weights"] + change, "count": state["count"] + 1}
        return {**state, **new}, gpcjax.Info.of(rate=jnp.abs(change @ moment.obs))


class Drawing(Counting):
    def init(self, key):
        return {"key": key}


def begun(learner, seed):
    """The first state, as a sweep has it."""
    return jax.tree.map(np.asarray, learner.init(jax.random.key(seed)))


COUNTING = Recipe(f"{HERE}:Counting", "mountaincar", {"gain": 0.25})


def taken_back(recipe, learner, state):
    """As the store does it: a card of JSON, and bytes."""
    text, content = packed(*pack_own(recipe, learner, state))
    return unpack_learner(*unpacked(text, content))


def test_it_comes_back_to_the_bit():
    learner = COUNTING.made()
    state = begun(learner, 3)
    again, same = taken_back(COUNTING, jax.tree.map(np.asarray, learner), state)
    assert_same_bits(same, state)
    assert type(again) is Counting and again.gain == 0.25 and np.isinf(same["least"])
    obs = jnp.array([0.3, 0.01])
    assert_same_bits(again.policy_of(same)(obs), learner.policy_of(state)(obs))


def test_what_is_infinite_from_the_start_is_no_mistake():
    """A correction is dropped if something becomes so, by learning or by going on."""
    learner = COUNTING.made()
    state, info = learner.correct(begun(learner, 0), [0.5, 1.0], [0.0], [1])
    assert int(info.status) == 0 and int(state["count"]) == 1 and np.isinf(state["least"])
    spoiled = dataclasses.replace(learner, gain=jnp.array(jnp.inf))
    same, info = spoiled.correct(state, [0.5, 1.0], [0.0], [1])
    assert int(info.status) == 2 and float(info.rate[0]) == 0.0
    assert_same_bits(same, state)
    after, status = learner._idle(state, jax.random.key(0))
    assert int(status) == 0
    assert_same_bits(after, state)


def test_a_dictionary_may_have_grown():
    recipe = Recipe(GROWING.name, "mountaincar", {"policy_capacity": 8, "human_capacity": 8})
    learner = recipe.made()
    state = learner.resize(learner.init(), 16, 24)
    _, same = taken_back(recipe, learner, state)
    assert_same_bits(same, state)


def test_one_of_0_2_0_that_is_built_as_gpc_has_no_array_for_a_rate_that_nobody_gave():
    recipe = Recipe(GROWING.name, "mountaincar", {"policy_capacity": 8, "human_capacity": 8})
    learner = recipe.made()
    card, arrays = pack_own(recipe, learner, learner.init())
    del card["shapes"]["learner.static_rate"], arrays["learner.static_rate"]
    assert_same_bits(unpack_learner(json.loads(json.dumps(card)), arrays), (learner, learner.init()))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"algo": f"{HERE}:Gone"}, "has no Gone"),
        ({"algo": "gone:Gone"}, "there is no module gone"),
        ({"env": "pendulum"}, "Counting makes a learner of other shapes now than when this was kept"),
        ({"settings": {"gain": 1.0, "more": 2.0}}, "'more' is not an option of this learner"),
    ],
)
def test_what_is_made_otherwise_now_is_refused(change, line):
    learner = COUNTING.made()
    card, arrays = pack_own(COUNTING, learner, begun(learner, 0))
    card = json.loads(json.dumps(card))
    card["recipe"] |= change
    with pytest.raises(UserError, match="x: ") as refused:
        unpack_learner(card, arrays, "x")
    assert line in str(refused.value)


def test_what_has_no_form_is_refused():
    check_recipe(COUNTING, "keep")
    recipe = Recipe(f"{HERE}:Drawing", "mountaincar")
    with pytest.raises(
        UserError, match=r"keep: .*Drawing learns .* as its state\['key'\] is no array of numbers"
    ):
        check_recipe(recipe, "keep")


def test_its_state_goes_to_its_own_kind():
    learner = COUNTING.made()
    state = begun(learner, 1)
    other = dataclasses.replace(COUNTING, settings={"gain": 1.0}).made()
    assert carried(learner, state, other, (1, 1)) is state
    with pytest.raises(UserError, match="of a Counting of another kind"):
        carried(learner, state, gpcjax.make_learner("gpc", "mountaincar"), (1, 1))


class Wide(Counting):
    """What is compiled in is part of how it is made again; a function that is not the usual one cannot be."""

    units: int = 2
    share: float = eqx.field(default=0.5, static=True)
    activation: Callable = jnp.tanh
    squash: bool = True
    kind: str = "wide"
    note: str | None = "kept"

    def init(self, key=None):
        state = super().init(jax.random.key(0) if key is None else key)
        return {**state, "more": jnp.full(self.units, self.share)}


OTHERS = {"units": 3, "share": 0.25, "squash": False, "kind": "narrow", "note": None}


@pytest.mark.parametrize("made", [fixed, lambda learner: learner], ids=["fixed", "as its class makes it"])
def test_what_is_compiled_in_comes_back(made, tmp_path):
    """Whole numbers, truth values and texts, whoever has made the learner."""
    learner = made(Wide(obs_size=2, action_size=1, **OTHERS))
    gpcjax.save_learner(tmp_path / "saved", learner, learner.init())
    again, _ = gpcjax.load_learner(tmp_path / "saved")
    assert {name: getattr(again, name) for name in OTHERS} == OTHERS


GO_ON = """
import sys, gpcjax
session = gpcjax.Session.load(sys.argv[1])
for step in range(3):
    session.propose([0.1 * step, -0.2])
    session.advise([1])
session.save(sys.argv[2])
print(repr(float(gpcjax.load_policy(sys.argv[3])([0.3, 0.01])[0])))
"""


def here(monkeypatch, capsys, *paths):
    """What `GO_ON` prints here."""
    monkeypatch.setattr(sys, "argv", ["", *paths])
    exec(GO_ON, {})
    return capsys.readouterr().out


def in_another_process(monkeypatch, capsys, *paths):
    command = [sys.executable, "-c", GO_ON, *paths]
    return subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True).stdout


@pytest.mark.parametrize("go_on", [here, pytest.param(in_another_process, marks=pytest.mark.slow)])
def test_the_public_functions_save_it_too(tmp_path, monkeypatch, capsys, go_on):
    """A session of it goes on where it is loaded, to the bit; its policy is loaded there."""
    learner = gpcjax.make_learner(f"{HERE}:Wide", "mountaincar", **OTHERS)
    session = gpcjax.Session(learner)
    for obs in ([0.5, 0.1], [-0.3, 0.0]):
        session.propose(obs)
        session.advise([-1])
    session.save(tmp_path / "session")
    gpcjax.save_policy(tmp_path / "policy", learner, session.state)
    printed = go_on(monkeypatch, capsys, *(str(tmp_path / name) for name in ("session", "later", "policy")))
    assert float(printed) == float(session.policy()([0.3, 0.01])[0])
    for step in range(3):
        session.propose([0.1 * step, -0.2])
        session.advise([1])
    again, state = gpcjax.load_learner(tmp_path / "later")
    assert_same_bits((again, state), (learner, session.state))
    assert (again.units, again.share, float(again.gain)) == (3, 0.25, 0.5)


class Roomy(Counting):
    """Keeps where it was corrected, in as much room as it is given."""

    where: object = None
    gain: jax.Array = eqx.field(default=0.5, converter=jnp.asarray)

    def init(self, key=None):
        return {
            "weights": jnp.zeros((self.action_size, self.obs_size)),
            "n": 0,
            "kept": jnp.zeros((4, self.obs_size)),
        }

    def learn(self, state, moment, advice, key):
        change = self.gain.sum() * jnp.outer(advice, moment.obs)
        kept = state["kept"].at[state["n"] % state["kept"].shape[0]].set(moment.obs)
        new = {"weights": state["weights"] + change, "n": state["n"] + 1, "kept": kept}
        return new, gpcjax.Info.of(rate=jnp.abs(change @ moment.obs))

    def grow(self, state):
        return {**state, "kept": jnp.concatenate([state["kept"], jnp.zeros_like(state["kept"])])}

    def _like(self, state):
        return {**self.init(), "kept": jnp.zeros(state["kept"].shape)}


class Shade(enum.Enum):
    DARK = 1
    LIGHT = 2


class Odd(Counting):
    """Fields of kinds that have no form on a card, and settings whose class takes whole numbers alone."""

    shade: Shade = Shade.DARK
    layer: eqx.nn.Linear | None = None
    key: Any = None
    sharpness: float = 2


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"shade": Shade.LIGHT}, r"\(shade <Shade.LIGHT: 2> is <Shade.DARK: 1> as its class makes it\)$"),
        (
            {"layer": eqx.nn.Linear(2, 1, key=jax.random.key(0))},
            r"\(learner.layer.weight is of shape \(1, 2\), and",
        ),
        ({"key": jax.random.key(3)}, r"its learner.key is no array of numbers \(of a random key"),
        ({"sharpness": 2.5}, r"cannot be saved: .* \(sharpness 2.5: give a whole number"),
    ],
)
def test_what_a_class_does_not_make_is_named(settings, message, tmp_path):
    learner = Odd(obs_size=2, action_size=1, **settings)
    with pytest.raises(UserError, match=message):
        gpcjax.save_learner(tmp_path / "saved", learner, begun(learner, 0))
    assert not list(tmp_path.iterdir())


SINGLE, LARGE = np.float32(0.3), {"gain": [0.1, 0.2], "where": 0.5}
ODD = {
    "a state that has grown": ({}, lambda learner, state: learner.grow(learner.grow(state))),
    "an untaught state with a number of Python's": ({}, lambda learner, state: learner.init()),
    "numbers of half the digits": ({"gain": jnp.float32(0.3)}, lambda learner, state: state),
    "one of numpy's": ({"gain": SINGLE}, lambda learner, state: {**state, "n": np.int32(3)}),
    "a state of half the digits": ({}, lambda learner, state: {**state, "kept": np.ones((4, 2), np.float32)}),
    "a field of another shape, one that is usually none": (LARGE, lambda learner, state: state),
}


QUICK = {"learner": tuple(ODD), "policy": tuple(ODD)[:1], "session": tuple(ODD)[1:2]}


@pytest.mark.parametrize(
    ("how", "odd"),
    [
        pytest.param(how, odd, marks=() if odd in quick else pytest.mark.slow)
        for how, quick in QUICK.items()
        for odd in ODD
        if (how, odd) != ("session", "a state of half the digits")  # refused by `check_state`
    ],
)
def test_whatever_is_saved_is_loaded(odd, how, tmp_path):
    """Where a state has numbers of other types than its class gives, they are the same ones of these types."""
    settings, change = ODD[odd]
    learner = Roomy(obs_size=2, action_size=1, **settings)
    state, _ = learner.correct(learner.init(), [0.2, 0.1], [0.0], [1])
    state, path, obs = change(learner, state), tmp_path / "saved", [0.3, 0.01]
    if how == "policy":
        gpcjax.save_policy(path, learner, state)
        assert_same_bits(gpcjax.load_policy(path)(obs), learner.policy_of(state)(obs))
        return
    if how == "session":
        gpcjax.Session(learner, state).save(path)
        again, same = gpcjax.load_learner(path)
        gpcjax.Session.load(path)
    else:
        gpcjax.save_learner(path, learner, state)
        again, same = gpcjax.load_learner(path)
    for one, other in zip(jax.tree.leaves((again, same)), jax.tree.leaves((learner, state)), strict=True):
        np.testing.assert_array_equal(one, other)
    types = [leaf.dtype for leaf in jax.tree.leaves(same)]
    assert types == [leaf.dtype for leaf in jax.tree.leaves(jax.eval_shape(learner.init))]
    assert again.where == learner.where


def test_what_was_saved_with_other_types_opens_again():
    """As 0.2.0 and before kept them: nobody had looked."""
    learner = COUNTING.made()
    state = {**begun(learner, 0), "count": np.int64(3)}
    card, arrays = pack_own(COUNTING, learner, state)
    again, same = unpack_learner(card, {**arrays, "learner.gain": np.asarray(0.25, np.float32)})
    assert (same["count"].dtype, int(same["count"]), float(again.gain)) == (np.int32, 3, 0.25)
    with pytest.raises(
        UserError, match=r"^x: this learner is damaged \(state\['count'\] is not what the card"
    ):
        unpack_learner(card, {**arrays, "state['count']": np.asarray(2**40)}, "x")


def test_what_cannot_be_saved_is_refused(tmp_path):
    odd = Wide(obs_size=2, action_size=1, activation=jnp.sin)
    within = type("Within", (Counting,), {"__qualname__": "made.<locals>.Within"})(obs_size=2, action_size=1)
    usual, several = (
        Counting(obs_size=2, action_size=1),
        Roomy(obs_size=2, action_size=1, where=["a"]),
    )
    for learner, state, message in (
        (
            odd,
            odd.init(),
            r"cannot be saved: .* \(activation is another function than its class has: write a",
        ),
        (within, begun(within, 0), "its class is defined within a function"),
        (
            usual,
            {**begun(usual, 0), "count": np.zeros(2, np.int32)},
            r"cannot be saved: give a learner .* \(state\['count'\] is of shape \(2,\), and of shape \(\) as ",
        ),
        (usual, {**begun(usual, 0), "count": np.int64(2**40)}, "holds numbers that int32 cannot hold"),
        (usual, {**begun(usual, 0), "count": np.float64(0.5)}, "holds numbers that int32 cannot hold"),
        (usual, {**begun(usual, 0), "more": np.zeros(2)}, r"more'\] is of shape \(2,\), and not there as "),
        (several, begun(several, 0), r"\(where \['a'\] is None as its class makes it"),
        (usual, {"key": jax.random.key(0)}, r"cannot be kept, as its state\['key'\] is no array of numbers"),
    ):
        with pytest.raises(UserError, match=message):
            gpcjax.save_learner(tmp_path / "saved", learner, state)
    assert not list(tmp_path.iterdir())
