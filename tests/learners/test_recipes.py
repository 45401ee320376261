"""What a learner of a person's own has learned, as arrays and the recipe that makes it again."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.learners.carried import carried
from gpcjax.learners.descriptions import LEARNERS
from gpcjax.learners.packed import unpack_learner
from gpcjax.learners.recipes import Recipe, check_recipe, pack_own
from gpcjax.sweep.packing import packed, unpacked
from tests.trees import assert_same_bits

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


def test_a_dictionary_may_have_grown():
    recipe = Recipe(GROWING.name, "mountaincar", {"policy_capacity": 8, "human_capacity": 8})
    learner = recipe.made()
    state = learner.resize(learner.init(), 16, 24)
    _, same = taken_back(recipe, learner, state)
    assert_same_bits(same, state)


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
