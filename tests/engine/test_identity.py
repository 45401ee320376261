"""The digest of a program: the same for the same program, another for any other, none for code that is not known."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax import make_env, make_expert, make_learner, make_oracle
from gpcjax.elementary import tanh
from gpcjax.engine.block import Block, Counters, Tier
from gpcjax.engine.history import Credit
from gpcjax.engine.identity import Unknown, digest
from gpcjax.engine.keeping import Keep
from gpcjax.engine.lanes import Start
from gpcjax.engine.rollout import Loop
from gpcjax.teachers.oracle import Oracle
from tests.engine import tasks

NUMBERS = {
    "policy_length_scale": 0.7,
    "policy_variance": 0.01,
    "human_length_scale": 0.3,
    "human_variance": 0.01,
}


def gpc(algo="gpc", **options):
    return make_learner(algo, obs_size=2, action_size=1, capacity=8, **NUMBERS | options)


def teacher(**numbers):
    return jax.tree.map(np.asarray, make_oracle("cartpole", "lqr", **numbers).oracle)


def test_equal_things_are_told_alike_however_often_they_are_made():
    one, other = (
        [gpc(), teacher(), {"a": (1, 2.0, None)}, functools.partial(tanh), Keep(every=2)] for _ in range(2)
    )
    assert digest(one, ()) == digest(other, ())
    assert len(digest(one, ())) == 32


@pytest.mark.parametrize(
    "one, other",
    [
        (1, 1.0),
        (1, True),
        ("1", 1),
        ((1, 2), [1, 2]),
        ((1, (2, 3)), ((1, 2), 3)),
        ({"a": 1}, {"b": 1}),
        (0.0, -0.0),
        (np.zeros(2), np.zeros(2, np.float32)),
        (np.zeros(2), np.zeros((2, 1))),
        (np.zeros(2), np.array([0.0, 1e-300])),
        (np.float64(1.0), np.float64(2.0)),
        (jax.random.key(0), jax.random.key(1)),
        (Keep(every=2), Keep(every=3)),
        (Tier(4, 8, 8), Tier(8, 8, 8)),
        (tanh, jnp.tanh),
        (functools.partial(tanh, 1), functools.partial(tanh, 2)),
    ],
)
def test_what_differs_by_value_is_told_apart(one, other):
    assert digest(one, ()) != digest(other, ())


def test_a_saved_policy_is_told_by_its_numbers(tmp_path):
    one, other = (make_expert("cartpole", name) for name in ("gpc", "gpc-2"))
    assert digest(one, ()) == digest(make_expert("cartpole", "gpc"), ()) != digest(other, ())


def test_arguments_differ_by_shape_and_type_alone():
    assert digest((), np.zeros(3)) == digest((), np.ones(3)) == digest((), jnp.ones(3))
    assert digest((), np.zeros(3)) != digest((), np.zeros(4))
    assert digest((), np.zeros(3)) != digest((), np.zeros(3, np.int64))
    assert digest((), gpc()) == digest((), gpc(policy_length_scale=0.9))
    # What is static is compiled in.
    assert digest((), gpc()) != digest((), gpc(sparsify=False))
    assert digest((), gpc()) != digest((), gpc(on_full="drop"))
    assert digest((), gpc()) != digest((), gpc("gpc-ns"))
    assert digest((), teacher()) != digest((), teacher(active_gain=0.1))


@functools.wraps(tanh)
def disguised(x):
    return 2.0 * x


class Foreign(Oracle):
    """Somebody's own."""


@pytest.mark.parametrize(
    "thing",
    [
        lambda obs: obs,
        tasks.expert,
        disguised,
        Foreign,
        Foreign(
            **{name: jnp.asarray(0.1) for name in ("rate", "error", "delta", "active_gain")}, active=False
        ),
        functools.partial(tasks.expert, 1),
        functools.partial(tanh, tasks.expert),
        {"a": [tasks.expert]},
        tasks.Drift(),
        np.array([object()]),
        object(),
        iter(()),
    ],
    ids="lambda function disguised class instance partial argument inside task objects object iterator".split(),
)
@pytest.mark.parametrize("compiled_in", [True, False])
def test_code_of_others_has_none(thing, compiled_in):
    with pytest.raises(Unknown):
        digest(*((thing, ()) if compiled_in else ((), thing)))


def test_what_holds_itself_has_none():
    endless = []
    endless.append(endless)
    with pytest.raises(Unknown):
        digest(endless, ())


TIER = Tier(4, 8, 8)
LOOP = {"env": "cartpole", "expert": "lqr", "episodes": 3, "grows": True, "keep": None}
VARIANTS = {
    "usual": {},
    "other numbers": {"learner": {"policy_length_scale": 0.9}, "teacher": {"rate": 0.2, "error": 0.3}},
    "as many rows": {"loop": {"episodes": 30}},
    "more rows": {"loop": {"episodes": 40}},
    "another expert": {"loop": {"expert": "network"}},
    "the last tier": {"loop": {"grows": False}},
    "kept": {"loop": {"keep": Keep(every=2)}},
    "another room": {"tier": Tier(4, 16, 8)},
    "another width": {"tier": Tier(4, 8, 16)},
    "active": {"teacher": {"active_gain": 0.1}},
    "no SPARS": {"learner": {"sparsify": False}},
    "late": {"credit": Credit.of(0.1, 0.3, None, 0.02)},
}
ALIKE = {"usual", "other numbers", "as many rows"}


def block(loop=None, learner=None, teacher_=None, tier=TIER, credit=None):
    given = LOOP | (loop or {})
    env, expert = make_env(given["env"]), make_expert(given["env"], given["expert"])
    made = make_learner("gpc", given["env"], capacity=4, **(learner or {}))
    start = Start("run", jax.tree.map(np.asarray, made), teacher(**(teacher_ or {})), 0, credit)
    return Block(
        tier, Loop(env, expert, given["episodes"], given["grows"], keep=given["keep"]), start, Counters()
    )


@pytest.mark.slow
def test_programs_have_the_same_digest_where_they_have_the_same_text():
    """Of what is lowered: everything that a digest leaves out must leave the program as it is."""
    texts, digests = {}, {}
    for name, variant in VARIANTS.items():
        made = block(**{{"teacher": "teacher_"}.get(key, key): value for key, value in variant.items()})
        made.lanes = made._empty()
        rounds = np.int32(4)

        def flat(leaves, rounds, made=made, structure=made._structure):
            return jax.tree.leaves(made._loop.advance(structure.unflatten(leaves), rounds))

        texts[name] = jax.jit(flat, donate_argnums=0).lower(made._leaves, rounds).as_text()
        digests[name] = made._digest("advance", (rounds,))
    for one in VARIANTS:
        for other in VARIANTS:
            assert (texts[one] == texts[other]) == (digests[one] == digests[other]), (one, other)
    assert {name for name in VARIANTS if digests[name] == digests["usual"]} == ALIKE


def test_a_block_has_a_digest_for_each_of_its_programs():
    made, again = block(), block(learner={"policy_length_scale": 0.9})
    arguments = (np.zeros(3),)
    assert made._digest("begin", arguments) == again._digest("begin", arguments)
    assert made._digest("begin", arguments) != made._digest("promote", arguments)
    assert made._digest("begin", arguments) != made._digest("begin", (np.zeros(4),))
    foreign = dataclasses.replace(made._template, teacher=Foreign(**vars(teacher())))
    assert Block(TIER, made._loop, foreign, Counters())._digest("begin", arguments) is None
