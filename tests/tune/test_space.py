"""Where a search looks, on how much, and what it calls better: pure."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpcjax.errors import UserError
from gpcjax.sweep.seeds import Seeds
from gpcjax.tune.halving import Rung, first, go_on, rungs_of
from gpcjax.tune.names import names_of
from gpcjax.tune.ranking import front, ranked
from gpcjax.tune.space import Range, Values, at_edge, corners, grid_of, of_table, of_words


def test_ranges_and_values():
    words = [
        "policy-length-scale=0.1:10",
        "constant_rate=0:0.1",
        "noise=1e-7:1e-3:linear",
        "policy_nu=0.5,1.5,0.5",
    ]
    assert of_words(words) == {
        "policy_length_scale": Range(0.1, 10.0, log=True),
        "constant_rate": Range(0.0, 0.1, log=False),
        "noise": Range(1e-7, 1e-3, log=False),
        "policy_nu": Values((0.5, 1.5)),
    }
    table = {
        "policy-length-scale": "0.1:10",
        "policy_nu": [0.5, 1.5],
        "constant_rate": "0:0.1",
        "noise": "1e-7:1e-3:linear",
    }
    assert of_table(table, "") == of_words(words)


@pytest.mark.parametrize(
    "word",
    [
        "x",
        "=1:2",
        "x=",
        "x=1:",
        "x=2:1",
        "x=1:1",
        "x=0:1:log",
        "x=1:2:3",
        "x=1:2:log:log",
        "x=nan:1",
        "x=a,b",
        "x=1,,2",
    ],
)
def test_no_range_and_no_list(word):
    with pytest.raises(UserError, match=r"^--search "):
        of_words([word])


def test_a_setting_twice():
    with pytest.raises(UserError, match="policy_nu is given twice"):
        of_words(["policy-nu=0.5,1.5", "policy_nu=1.5"])
    with pytest.raises(UserError, match="given twice, with a dash and with an underscore"):
        of_table({"policy-nu": [0.5], "policy_nu": [1.5]}, "")
    with pytest.raises(UserError, match='give "LOW:HIGH" in quotes, or a list'):
        of_table({"policy_nu": 0.5}, "")


def test_corners_have_every_end():
    space = {"a": Range(1, 2, True), "b": Values((3.0, 4.0, 5.0))}
    assert corners(space) == [{"a": 1, "b": 3}, {"a": 2, "b": 4}, {"a": 2, "b": 5}]
    with pytest.raises(UserError, match="a grid needs values"):
        grid_of(space)
    assert at_edge(space, {"a": 1.999, "b": 3.0}) == ["a"]
    assert at_edge(space, {"a": 1.5, "b": 3.0}) == []


def test_rungs_end_with_all():
    seeds = Seeds.of(16)
    assert rungs_of(None, seeds, 30, "--rungs") == (Rung(16, 30),)
    assert rungs_of("4x10,8", seeds, 30, "--rungs") == (Rung(4, 10), Rung(8, 30), Rung(16, 30))
    assert rungs_of("16x10", seeds, 30, "--rungs") == (Rung(16, 10), Rung(16, 30))
    assert first(Seeds.of("3,7,100-199"), 4) == Seeds.of("3,7,100,101")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "4x",
        "0",
        "17",
        "4x31",
        "8,4",
        "4x20,8x10",
        "4,4",
        "4x10x2",
        "-4",
        "1.5",
        "\u00b2x3",
        "4x\u00b2",
        "9" * 5000,
        "\u0664",
    ],
)
def test_no_rungs(text):
    with pytest.raises(UserError, match=r"^--rungs"):
        rungs_of(text, Seeds.of(16), 30, "--rungs")


def test_one_in_eta_goes_on_and_one_at_least():
    assert go_on([4, 2, 0, 1, 3], 2.0) == [4, 2, 0]
    assert go_on([4, 2, 0, 1, 3], 100.0) == [4]


def test_one_objective_is_sorted_by_it_and_nan_is_worst():
    assert ranked([[1.0], [np.nan], [3.0], [2.0]], [True]) == [2, 3, 0, 1]
    assert ranked([[1.0], [np.inf], [3.0], [2.0]], [False]) == [0, 3, 2, 1]


@given(st.lists(st.tuples(*[st.integers(0, 5)] * 2), min_size=1, max_size=12))
def test_the_front_is_what_nobody_dominates(points):
    scores = [(float(a), float(b)) for a, b in points]  # a to be large, b small

    def dominated(place):
        a, b = scores[place]
        return any(x >= a and y <= b and (x, y) != (a, b) for x, y in scores)

    alone = [place for place in range(len(scores)) if not dominated(place)]
    assert front(scores, [True, False]) == alone
    order = ranked(scores, [True, False])
    assert sorted(order) == list(range(len(scores))) and set(order[: len(alone)]) == set(alone)


def test_thousands_of_points_are_ranked():
    """Looking at all pairs of all fronts, a grid of thousands would take hours."""
    values = [place // 3 for place in range(2002)]  # three are alike
    shuffled = [values[place * 1237 % 2002] for place in range(2002)]
    order = ranked([[float(value)] for value in shuffled], [True])
    assert [shuffled[place] for place in order] == values[::-1]
    ties = [place for place in order if shuffled[place] == 7]
    assert ties == sorted(ties) and len(ties) == 3
    assert front([[float(value), 0.0] for value in shuffled], [True, False]) == sorted(order[:1])


def test_objectives_by_name():
    assert names_of("area, corrections-to-90", "--objective") == ("area", "corrections_to_90")
    with pytest.raises(UserError, match=r"--objective 'erea': .* \(did you mean area\?\)"):
        names_of("erea", "--objective")
    with pytest.raises(UserError, match="given twice"):
        names_of("area,area", "--objective")
