import math
from dataclasses import fields

import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpcjax.envs.tasks import TASKS
from gpcjax.errors import UserError
from gpcjax.learners.descriptions import CREDIT, LEARNERS
from gpcjax.registry import find
from gpcjax.sweep.options import EXPERIMENT, OPTIONS, RUNNING, TUNING, VARIANTS, accept, parse
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import SweepSpec, as_dict, make_spec, read_toml, spec_of


def test_defaults():
    assert spec_of(env="cartpole") == SweepSpec(
        env="cartpole",
        algo=("gpc", "gpc-ns", "coach"),
        error=(0.0,),
        seeds=Seeds.of(100),
        episodes=30,
        oracle=("gpc",),
        delta=(0.05,),
        rate=(0.05,),
        rate_schedule=(),
        sparsify=True,
        on_full="error",
        max_capacity=1024,
        hyperparameters={},
    )
    assert spec_of(env="pendulum").episodes == 40
    lander = spec_of(env="lunarlander")
    assert (lander.episodes, lander.oracle, lander.max_capacity) == (200, ("heuristic",), 4096)


def test_the_table_and_the_specification_have_the_same_settings():
    names = {option.name for option in EXPERIMENT + VARIANTS}
    assert names == {field.name for field in fields(SweepSpec)} - {"hyperparameters", "points"}
    settings = {each.name for spec in (*LEARNERS, find("teacher", "oracle")) for each in spec.settings}
    settings |= {each.name for each in CREDIT}
    assert {option.name for option in TUNING} == settings
    assert set(OPTIONS) == names | settings | {option.name for option in RUNNING}


def test_defaults_are_allowed():
    for option in OPTIONS.values():
        if option.default is not None:
            assert accept(option, option.default, "") == option.default


def test_every_number_of_the_thesis_tables_can_be_varied():
    tables = [(spec.name, spec.defaults) for spec in LEARNERS]
    tables += [each for task in TASKS for each in task.presets.items()]
    for algo, table in tables:
        allowed = {setting.name: setting.allowed for setting in find("learner", algo).settings}
        for name, value in table.items():
            if name in ("scaling", "lower", "upper", "counts"):
                continue
            for number in np.atleast_1d(value):
                assert allowed[name].admits(number.item())


def test_lists_keep_their_order_and_lose_repeats():
    spec = spec_of(env="cartpole", algo="coach,gpc,coach", error=[0.2, 0, 0.2, -0.0], rate=0.1)
    assert (spec.algo, spec.error, spec.rate) == (("coach", "gpc"), (0.2, 0.0), (0.1,))
    assert math.copysign(1, spec.error[1]) == 1


def test_numpy_values_are_taken():
    spec = spec_of(env="cartpole", error=np.linspace(0, 0.2, 3), seeds=np.int64(3), delta=np.float64(0.1))
    assert spec == spec_of(env="cartpole", error=[0.0, 0.1, 0.2], seeds=3, delta=0.1)
    assert spec.seeds == Seeds(((0, 2),)) and as_dict(spec)["seeds"] == 3
    assert type(spec.error[1]) is float


def test_hyperparameters_are_those_given():
    spec = spec_of(env="cartpole", policy_length_scale=[0.1, 0.2], beta=10)
    assert dict(spec.hyperparameters) == {"policy_length_scale": (0.1, 0.2), "beta": (10.0,)}


def test_toml_gives_what_python_gives(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(
        """
        env = "cartpole"
        algo = "gpc,coach"
        error = [0, 0.1]
        seeds = 3
        policy-length-scale = 0.3
        max_capacity = 64
        sparsify = false
        on-full = "drop"
        out = "somewhere"
        jobs = 2
        """
    )
    settings = read_toml(path)
    assert (settings["out"].value, settings["jobs"].value) == ("somewhere", 2)
    assert make_spec(settings) == spec_of(
        env="cartpole",
        algo=["gpc", "coach"],
        error=(0.0, 0.1),
        seeds=3,
        policy_length_scale=0.3,
        max_capacity=64,
        sparsify=False,
        on_full="drop",
    )


def test_as_dict_is_json():
    table = as_dict(spec_of(env="cartpole", noise=1e-6))
    assert table["algo"] == ["gpc", "gpc-ns", "coach"], "the thesis' learners, whatever else is built in"
    assert table["hyperparameters"] == {"noise": [1e-6]}
    assert "teacher" not in table, "what every sweep of an earlier version had leaves its hash as it was"


REFUSED = [
    ({}, "no env: give cartpole, pendulum, lunarlander, mountaincar, module:NAME, gym:ID"),
    (
        {"env": "carpole"},
        "env 'carpole': give cartpole, pendulum, lunarlander, mountaincar, module:NAME",
    ),
    ({"env": ""}, "env '': an empty value"),
    ({"env": ["cartpole"]}, "env ['cartpole']: give cartpole"),
    (
        {"env": "cartpole", "algo": "gpc_ns"},
        "algo 'gpc_ns': give gpc, gpc-ns, coach, d-coach or module:NAME (did you mean gpc-ns?)",
    ),
    ({"env": "cartpole", "algo": []}, "algo []: the list is empty, give gpc"),
    ({"env": "cartpole", "algo": 3}, "algo 3: give gpc"),
    ({"env": "cartpole", "error": 1.5}, "error 1.5: give a number from 0 to 1"),
    ({"env": "cartpole", "error": -0.1}, "error -0.1: give a number from 0 to 1"),
    ({"env": "cartpole", "error": math.nan}, "error nan: give a number from 0 to 1"),
    ({"env": "cartpole", "error": math.inf}, "error inf: give a number from 0 to 1"),
    ({"env": "cartpole", "error": [0, "0.1"]}, "error '0.1': give a number from 0 to 1"),
    ({"env": "cartpole", "error": "0.1"}, "error '0.1': give a number from 0 to 1"),
    ({"env": "cartpole", "error": True}, "error True: give a number from 0 to 1"),
    ({"env": "cartpole", "error": [[0.1]]}, "error [0.1]: give a number from 0 to 1"),
    ({"env": "cartpole", "error": {"a": 0.1}}, "error {'a': 0.1}: give a number from 0 to 1"),
    ({"env": "cartpole", "error": []}, "error []: the list is empty"),
    ({"env": "cartpole", "seeds": 0}, "seeds 0: give a whole number from 1 to 1,000,000"),
    ({"env": "cartpole", "seeds": 2.0}, "seeds 2.0: give a whole number"),
    ({"env": "cartpole", "seeds": 10**30}, "seeds 1000000000000000000000000000000: give a whole number"),
    ({"env": "cartpole", "seeds": [3, -1]}, "seeds [3, -1]: give a whole number"),
    ({"env": "cartpole", "seeds": "9-3"}, "seeds '9-3': give a whole number"),
    ({"env": "cartpole", "episodes": -3}, "episodes -3: give a whole number"),
    ({"env": "cartpole", "delta": -1}, "delta -1: give a number of at least 0"),
    ({"env": "cartpole", "delta": 10**400}, "delta 1000000000"),
    ({"env": "cartpole", "rate": 2}, "rate 2: give a number from 0 to 1"),
    (
        {"env": "cartpole", "oracle": "lrq"},
        "oracle 'lrq': give gpc, gpc-2, gpc-3, lqr, network, mpc, the folder of",
    ),
    (
        {"env": "cartpole", "oracle": "energy"},
        "oracle 'energy': give gpc, gpc-2, gpc-3, lqr, network, mpc, the folder of",
    ),
    (
        {"env": "lunarlander", "oracle": "gpc"},
        "oracle 'gpc': give heuristic, the folder of a saved",
    ),
    ({"env": "cartpole", "rate_schedule": [0.1, 2]}, "rate_schedule 2: give a number from 0 to 1"),
    ({"env": "cartpole", "rate_schedule": []}, "rate_schedule []: the list is empty"),
    (
        {"env": "cartpole", "rate_schedule": [0.1], "rate": 0.2},
        "rate: beside rate_schedule it changes nothing, give one of the two",
    ),
    ({"env": "cartpole", "policy_length_scale": 0}, "policy_length_scale 0: give a number above 0"),
    ({"env": "cartpole", "noise": math.nan}, "noise nan: give a number above 0"),
    ({"env": "cartpole", "policy_nu": 1}, "policy_nu 1: give 0.5, 1.5 or 2.5"),
    ({"env": "cartpole", "sparsify": 1}, "sparsify 1: give true or false"),
    ({"env": "cartpole", "on_full": "stop"}, "on_full 'stop': give error, replace-nearest or drop"),
    ({"env": "cartpole", "max_capacity": 0}, "max_capacity 0: give a whole number from 1 to 16,384"),
    (
        {"env": "cartpole", "erorr": 0},
        "'erorr' is no setting (did you mean error?): give env, algo, teacher, error",
    ),
    (
        {"env": "cartpole", "algo": "gpc", "beta": 3},
        "beta: with gpc alone it changes nothing, give it with coach",
    ),
    (
        {"env": "cartpole", "algo": "coach", "sparsify": False},
        "sparsify: with coach alone it changes nothing",
    ),
    (
        {"env": "cartpole", "static_rate": 0.04, "constant_rate": 0.01},
        "constant_rate: beside static_rate it changes nothing",
    ),
]


@pytest.mark.parametrize(("settings", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_refused(settings, message):
    with pytest.raises(UserError) as refusal:
        spec_of(**settings)
    assert str(refusal.value).startswith(message)
    assert len(str(refusal.value)) < 700  # the longest names all settings


def test_a_key_written_twice_is_refused(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text("max_capacity = 3\nmax-capacity = 4\n")
    with pytest.raises(UserError, match="max-capacity is given twice"):
        read_toml(path)


@hypothesis.settings(max_examples=50)
@given(st.sampled_from(list(OPTIONS.values())), st.text(max_size=20))
def test_any_text_of_a_flag_is_taken_or_refused(option, text):
    try:
        value = parse(option, text, option.flag)
    except UserError as refusal:
        assert str(refusal).startswith(option.flag + " ")
    else:
        assert accept(option, value, option.flag) == value
