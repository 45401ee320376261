"""Learners by name: the tables of the thesis, and refusals that name what is wrong."""

import math

import jax
import numpy as np
import pytest

from gpcjax.learners.descriptions import LEARNERS
from gpcjax.learners.factory import make_learner
from gpcjax.registry import built_in, find
from tests.reference.domains import DOMAINS
from tests.trees import assert_same_bits


@pytest.mark.parametrize("name", DOMAINS)
@pytest.mark.parametrize("algo", ["gpc", "gpc-ns"])
def test_tables_5_1_to_5_3(algo, name):
    """Against the reference's own transcription."""
    domain = DOMAINS[name]
    table = domain.gpc if algo == "gpc" else domain.gpc_ns
    learner = make_learner(algo, name)
    assert (learner.obs_size, learner.action_size) == (domain.obs_size, domain.action_size)
    for process in ("policy", "human"):
        kernel = getattr(learner, process).kernel
        assert kernel.variance == table[f"{process}_variance"]
        assert kernel.length_scale == table[f"{process}_length_scale"]
        assert getattr(learner, process).noise == 1e-7
        assert getattr(learner, process).normalise == (algo == "gpc-ns")
    assert learner.policy.kernel.smoothness == table["policy_nu"]
    assert learner.human.kernel.smoothness == math.inf
    assert learner.constant_rate == table["constant_rate"] and np.isnan(learner.static_rate)
    if algo == "gpc":
        np.testing.assert_array_equal(learner.scaling, table["weights"])
    assert learner.sparsify and learner.on_full == "error"
    assert learner.policy_capacity == learner.human_capacity == 512


@pytest.mark.parametrize("name", DOMAINS)
def test_table_a_1(name):
    learner, table = make_learner("coach", name), DOMAINS[name].coach
    lower, counts, upper = zip(*table["grid"], strict=True)
    np.testing.assert_array_equal(learner.grid.lower, lower)
    np.testing.assert_array_equal(learner.grid.upper, upper)
    assert learner.grid.counts == counts
    for field, key in (("beta", "beta"), ("magnitude", "magnitude"), ("constant", "coach_constant")):
        np.testing.assert_array_equal(getattr(learner, field), table[key])


def test_every_task_of_the_thesis_has_its_sizes():
    assert set(built_in("task")) >= set(DOMAINS)
    for name, domain in DOMAINS.items():
        assert find("task", name).sizes == (domain.obs_size, domain.action_size)


SETTINGS = {setting.name for spec in LEARNERS for setting in spec.settings}


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_every_setting_is_an_option(name):
    """And it is refused where it is none of the learner's."""
    kinds = {setting.name: setting.kind for spec in LEARNERS for setting in spec.settings}
    value = 0.5 if name == "policy_nu" else 7 if kinds[name] is int else 0.123
    for spec in LEARNERS:
        if name in {setting.name for setting in spec.settings}:
            learner, usual = (
                make_learner(spec.name, "cartpole", **{name: value}),
                make_learner(spec.name, "cartpole"),
            )
            assert jax.tree.structure(learner) != jax.tree.structure(usual) or any(
                (a != b).any() for a, b in zip(jax.tree.leaves(learner), jax.tree.leaves(usual), strict=True)
            )
        else:
            with pytest.raises(ValueError, match=f"'{name}' is not an option of this learner"):
                make_learner(spec.name, "cartpole", **{name: value})


class TestATaskOfOnesOwn:
    def test_as_the_readme_has_it(self):
        learner = make_learner(
            "gpc",
            obs_size=2,
            action_size=3,
            capacity=16,
            policy={"variance": 0.02, "length_scale": 0.3, "nu": 2.5},
            human={"variance": 0.5, "length_scale": 0.1},
        )
        assert (learner.policy.kernel.variance, learner.policy.kernel.length_scale) == (0.02, 0.3)
        assert learner.policy.kernel.smoothness == 2.5
        assert (learner.human.kernel.variance, learner.human.kernel.length_scale) == (0.5, 0.1)
        assert learner.init().policy.points.shape == (3, 16, 2)
        assert learner.init().human.points.shape == (3, 16, 3)
        np.testing.assert_array_equal(learner.scaling, [1, 1])
        np.testing.assert_array_equal(learner.act(learner.init(), np.zeros(2)), np.zeros(3))

    def test_the_lander_gives_what_is_not_said(self):
        own, lander = make_learner("gpc-ns", obs_size=2, action_size=1), make_learner("gpc-ns", "lunarlander")
        assert own.constant_rate == lander.constant_rate
        assert own.human.kernel.variance == lander.human.kernel.variance

    def test_a_table_with_changes(self):
        learner = make_learner(
            "gpc", "cartpole", policy={"length_scale": 0.9}, static_rate=0.04, sparsify=False
        )
        assert learner.policy.kernel.length_scale == 0.9 and learner.policy.kernel.variance == 0.01
        assert learner.static_rate == 0.04 and not learner.sparsify

    def test_capacities_for_each_model(self):
        state = make_learner("gpc", "cartpole", capacity=8, human_capacity=20).init()
        assert (state.policy.points.shape[1], state.human.points.shape[1]) == (8, 20)

    def test_coach_on_a_grid(self):
        grid = {"lower": (-1, 0), "upper": (1, 2), "counts": (3, 4)}
        learner = make_learner("coach", obs_size=2, action_size=2, **grid, beta=(1.0, 2.0), magnitude=0.5)
        assert learner.init().policy.shape == (2, 3, 4)
        np.testing.assert_array_equal(learner.beta, [1, 2])
        np.testing.assert_array_equal(learner.magnitude, [0.5, 0.5])


OWN = {"obs_size": 2, "action_size": 1}
GRID = {"lower": (-1, 0), "upper": (1, 2), "counts": (3, 4)}


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("gcp", "cartpole"), {}, "algo 'gcp': give gpc, gpc-ns, coach, d-coach .*did you mean gpc"),
        (
            ("gpc", "cartpol"),
            {},
            "env 'cartpol': give cartpole, pendulum, .*did you mean cartpole",
        ),
        (("gpc",), {}, "obs_size and action_size missing: give sizes, or a task's name, one of cartpole"),
        (("gpc",), {"obs_size": 3}, "action_size missing"),
        (("gpc",), {"obs_size": 0, "action_size": 1}, "obs_size 0: give a whole number from 1"),
        (("gpc",), {"obs_size": 2.5, "action_size": 1}, "obs_size 2.5: give a whole number"),
        (("gpc", "cartpole"), {"capacity": 0}, "policy_capacity 0: give a whole number"),
        (("gpc", "cartpole"), {"capacity": True}, "policy_capacity True: give a whole number"),
        (("gpc", "cartpole"), {"human_capacity": -1}, "human_capacity -1: give a whole number"),
        (("gpc", "cartpole"), {"capacity": math.nan}, "policy_capacity nan: give a whole number"),
        (("gpc", "cartpole"), {"capacity": math.inf}, "policy_capacity inf: give a whole number"),
        (("gpc", "cartpole"), {"capacity": "8"}, "policy_capacity '8': give a whole number"),
        (("gpc", "cartpole"), {"capacity": None}, "policy_capacity None: give a whole number"),
        (
            ("gpc", "cartpole"),
            {"nosie": 1.0},
            "'nosie' is not an option of this learner .did you mean noise..: choose from .*noise",
        ),
        (("coach", "cartpole"), {"capacity": 8}, "'capacity' is not an option of this learner"),
        (
            ("coach", "cartpole"),
            {"policy": {"variance": 1.0}},
            "'policy_variance' is not an option of this learner",
        ),
        (("gpc", "cartpole"), {"human": {"nu": 0.5}}, "'human_nu' is not an option of this learner"),
        (("gpc", "cartpole"), {"policy": {"variance": 0.0}}, "policy_variance 0.0: give a number above 0"),
        (
            ("gpc", "cartpole"),
            {"policy": {"length_scale": -1}},
            "policy_length_scale -1: give a number above 0",
        ),
        (
            ("gpc", "cartpole"),
            {"human": {"length_scale": math.inf}},
            "human_length_scale inf: give a number above 0",
        ),
        (("gpc", "cartpole"), {"noise": 0.0}, "noise 0.0: give a number above 0"),
        (("gpc", "cartpole"), {"noise": "small"}, "noise 'small': give a number above 0"),
        (("gpc", "cartpole"), {"noise": None}, "noise None: give a number above 0"),
        (("gpc", "cartpole"), {"constant_rate": -0.1}, "constant_rate -0.1: give a number of at least 0"),
        (("gpc", "cartpole"), {"constant_rate": math.nan}, "constant_rate nan: give a number of at least 0"),
        (("gpc", "cartpole"), {"policy_nu": 2}, "policy_nu 2: give 0.5, 1.5 or 2.5"),
        (
            ("gpc", "cartpole"),
            {"on_full": "drpo"},
            "on_full 'drpo': give error, replace-nearest or drop .did you mean drop",
        ),
        (
            ("gpc", "cartpole"),
            {"scaling": (1.0, 2.0)},
            r"scaling \(1.0, 2.0\): give a number above 0, or 4 of them",
        ),
        (("gpc", "cartpole"), {"scaling": math.nan}, "scaling nan: give a number above 0"),
        (("gpc", "cartpole"), {"scaling": [0, 1, 1, 1]}, r"scaling \[0, 1, 1, 1\]: give a number above 0"),
        (("gpc-ns", "cartpole"), {"human_scaling": -1.0}, "human_scaling -1.0: give a number above 0"),
        (("d-coach", "cartpole"), {"scaling": 0.0}, "scaling 0.0: give a number above 0"),
        (("gpc", "cartpole"), {"scaling": "wide"}, "scaling 'wide': give a number above 0"),
        (("coach",), OWN, "COACH needs its grid: lower, upper and counts"),
        (("coach",), OWN | GRID | {"counts": (3, 1)}, r"counts 1: give a whole number from 2"),
        (("coach",), OWN | GRID | {"counts": (3, 4, 5)}, r"counts \(3, 4, 5\): give 2 numbers of at least 2"),
        (
            ("coach",),
            OWN | GRID | {"lower": (-1, 2)},
            r"lower \[-1.0, 2.0\] must be below upper \[1.0, 2.0\]",
        ),
        (
            ("coach",),
            OWN | GRID | {"upper": (1, math.inf)},
            r"upper \(1, inf\): give a finite number, or 2 of them",
        ),
        (
            ("coach",),
            OWN | GRID | {"beta": (1.0, 2.0)},
            r"beta \(1.0, 2.0\): give a number above 0, or 1 of them",
        ),
        (("coach", "cartpole"), {"beta": 0.0}, "beta 0.0: give a number above 0"),
        (("coach", "cartpole"), {"magnitude": -1.0}, "magnitude -1.0: give a number above 0"),
        (("gpc", "cartpole"), {"sparsify": "no"}, "sparsify 'no': give true or false"),
        (("gpc", "cartpole"), {"sparsify": 1}, "sparsify 1: give true or false"),
        (("gpc", "cartpole"), {"static_rate": 0}, "static_rate 0: give a number above 0"),
        (
            ("gpc", "cartpole"),
            {"static_rate": 0.1, "constant_rate": 0.1},
            "constant_rate: beside static_rate",
        ),
        (("gpc", "cartpole"), {"policy": "x"}, "policy 'x': give values by name"),
        (("gpc", "cartpole"), {"human": {3: 0.1}}, "human {3: 0.1}: give values by name"),
        (
            ("gpc", "cartpole"),
            {"policy": {"nu": 0.5}, "policy_nu": 0.5},
            "policy_nu is given twice",
        ),
        (("gpc", "cartpole"), {"noise": True}, "noise True: give a number above 0"),
        (("gpc", "cartpole"), {"noise": 1j}, "noise 1j: give a number above 0"),
        (("gpc", "cartpole"), {"noise": b"1"}, "noise b'1': give a number above 0"),
        (("gpc", "cartpole"), {"noise": 10**400}, r"noise 1000+\.\.\.: give a number above 0"),
        (("gpc", "cartpole"), {"scaling": [True] * 4}, "scaling .*: give a number above 0, or 4 of them"),
        (("gpc", "cartpole"), {"scaling": b"abcd"}, "scaling b'abcd': give a number above 0"),
        (("gpc", "cartpole"), {"capacity": 8.0}, "policy_capacity 8.0: give a whole number from 1 to 16,384"),
        (("gpc", "cartpole"), {"capacity": 10**9}, "policy_capacity 1000000000: give a whole number"),
        (("coach",), OWN | GRID | {"counts": "34"}, "counts '34': give 2 numbers of at least 2"),
        (("coach",), OWN | GRID | {"counts": (10**5, 10**5)}, "10,000,000,000 features for each of 1 action"),
        (
            ("coach", "cartpole"),
            {"coach_constant": -1.0},
            "coach_constant -1.0: give a number of at least 0",
        ),
    ],
    ids=str,
)
def test_refusals_name_the_value_and_what_is_allowed(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        make_learner(*arguments, **options)


def test_numpys_numbers_are_numbers():
    """And the learner is the same to the bit."""
    numpys = make_learner(
        "gpc",
        "cartpole",
        capacity=np.int32(8),
        noise=np.float64(1e-6),
        sparsify=np.True_,
        scaling=np.array([1, 2, 3, 4]),
        static_rate=np.asarray(0.5),
    )
    plain = make_learner(
        "gpc", "cartpole", capacity=8, noise=1e-6, sparsify=True, scaling=[1, 2, 3, 4], static_rate=0.5
    )
    assert_same_bits(numpys, plain)
