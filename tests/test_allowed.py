"""What Python takes for numbers, or for several values in order, and is neither."""

import datetime
import itertools

import numpy as np
import pandas as pd
import pytest

from gpcjax.allowed import FINITE, STEPS, checked, checked_series, converted, entries, is_no_data
from gpcjax.envs.base import parameter
from gpcjax.envs.registry import make_env
from gpcjax.errors import UserError
from gpcjax.learners.factory import make_learner
from gpcjax.policies.base import vector
from gpcjax.policies.folder import write_folder
from gpcjax.sweep.spec import spec_of

MASKED = np.ma.masked_array([1.0, 2.0], mask=[False, True])
TIMES = [
    np.timedelta64(3),
    np.timedelta64(3, "ns"),
    np.timedelta64(3, "s"),
    np.array(3, "m8[ns]"),
    np.datetime64(3, "ns"),
    datetime.timedelta(3),
]
MASKS = [np.ma.masked, np.ma.masked_array(3.0, mask=True), MASKED[1]]


@pytest.mark.parametrize("value", [*TIMES, *MASKS], ids=repr)
def test_times_and_masked_entries_are_no_numbers(value):
    for kind in (int, float, bool, str):
        assert converted(kind, value) is None
    with pytest.raises(UserError, match=r"^noise .*: give a finite number"):
        checked("noise", value, float, FINITE)
    with pytest.raises(UserError, match=r"^lower .*: give a finite number, or 2 of them"):
        checked_series("lower", [value, 1.0], 2, FINITE)
    with pytest.raises(UserError, match="physical parameter"):
        parameter(value)
    with pytest.raises(UserError, match=r"^cartpole: max_steps"):
        make_env("cartpole", max_steps=value)
    with pytest.raises(UserError, match=r"^error "):
        spec_of(env="cartpole", error=[0.0, value])


@pytest.mark.parametrize(
    "value",
    [
        *([each, each] for each in (*TIMES, *MASKS)),
        np.array([1, 2], "m8[ns]"),
        np.array([1, 2], "M8[ns]"),
        pd.Series([1, 2], dtype="m8[ns]"),
        MASKED,
        {1.0, 2.0},
    ],
    ids=repr,
)
def test_nor_are_vectors_of_them_observations(value):
    with pytest.raises(UserError, match=r"^obs .*: this learner takes 2 real numbers"):
        vector("obs", value, 2, "this learner")


def test_what_lies_under_no_mask_is_data():
    whole = np.ma.masked_array([1.0, 2.0])
    for value in (whole, pd.Series([1.0, 2.0]), np.ma.masked_array([1.0, 2.0], mask=[False, False])):
        assert not is_no_data(value)
        assert vector("obs", value, 2, "this learner").tolist() == [1.0, 2.0]
        assert checked_series("lower", value, 2, FINITE) == (1.0, 2.0)
    assert converted(float, whole[0]) == 1.0


@pytest.mark.parametrize("value", [{1.0, 2.0}, frozenset((3, 4)), {"gpc", "coach"}])
def test_a_set_has_no_order(value):
    """The same set of words is in another order in each process: its sweep would have another name."""
    sizes = {"obs_size": 2, "action_size": 1, "lower": -1, "upper": 1}
    for call in (
        lambda: checked_series("lower", value, 2, FINITE),
        lambda: make_learner("coach", **sizes, counts=value),
        lambda: make_learner("gpc", obs_size=2, action_size=1, scaling=value),
        lambda: spec_of(env="cartpole", error=value),
        lambda: spec_of(env="cartpole", algo=value),
        lambda: spec_of(env="cartpole", rate_schedule=value),
    ):
        with pytest.raises(UserError, match=r": a set has no order, give a list$"):
            call()


def test_several_values_are_taken_in_their_order():
    assert entries("counts", (3, 1, 2), 9) == entries("counts", {3: 0, 1: 0, 2: 0}.keys(), 9) == [3, 1, 2]
    assert entries("counts", itertools.count(5), 3) == [5, 6, 7]
    assert entries("counts", np.array([[1, 2]]), 9)[0].tolist() == [1, 2]
    assert all(entries("counts", one, 9) is None for one in (3, "34", b"34", {3: 4}, np.array(3), None))
    with pytest.raises(UserError, match=r"^counts count.*: give 2 numbers of at least 2"):
        make_learner("coach", obs_size=2, action_size=1, lower=-1, upper=1, counts=itertools.count(2))
    assert checked("max_steps", np.ma.masked_array(3), int, STEPS) == 3


@pytest.mark.parametrize("value", [MASKED, np.timedelta64(3, "ns"), np.array([1], "m8[ns]")], ids=repr)
def test_nor_do_they_enter_a_card(tmp_path, value):
    with pytest.raises(TypeError, match="is no JSON value: give text, numbers, lists or tables"):
        write_folder(tmp_path / "new", {"kind": "x", "provenance": {"seen": value}}, {"a": np.ones(1)})
    assert not list(tmp_path.iterdir())
