"""The map of a policy: which number is where, and that it always is one."""

import base64
import json

import numpy as np
import pytest

from gpcjax.teach.chart import MOST_PLACES, SIDE, chart

BOUNDS = np.array([[-1.0, 1.0], [-8.0, 8.0], [2.0, 4.0]])


def _values(drawn):
    return np.frombuffer(base64.b64decode(drawn["values"]), np.int8).reshape(
        drawn["size"][1], drawn["size"][0]
    )


def test_a_row_is_y_from_low_to_high_and_a_column_x():
    drawn = chart(lambda obs: np.stack([obs[0], obs[1] / 8]), (0, 1), 0, BOUNDS, [])
    line = np.round(127 * np.linspace(-1, 1, SIDE)).astype(np.int8)
    np.testing.assert_array_equal(_values(drawn), np.tile(line, (SIDE, 1)))
    other = chart(lambda obs: np.stack([obs[0], obs[1] / 8]), (0, 1), 1, BOUNDS, [])
    np.testing.assert_array_equal(_values(other), np.tile(line[:, None], (1, SIDE)))
    assert (drawn["low"], drawn["high"], drawn["size"]) == ([-1.0, -8.0], [1.0, 8.0], [SIDE, SIDE])


def test_the_axes_may_be_any_two():
    drawn = chart(lambda obs: (obs[2] - 3)[None], (2, 0), 0, BOUNDS, [])
    assert (
        _values(drawn)[0, 0] == -127 and _values(drawn)[0, -1] == 127 and (drawn["x"], drawn["y"]) == (2, 0)
    )
    assert (drawn["low"], drawn["high"]) == ([2.0, -1.0], [4.0, 1.0])


@pytest.mark.parametrize(("places", "there"), [([], 3.0), ([[0, 0, 2], [0, 0, 2.5], [0, 0, 4]], 2.5)])
def test_other_numbers_are_where_advice_was_given(places, there):
    asked = []
    chart(lambda obs: (asked.append(obs), np.zeros((1, obs.shape[1])))[1], (0, 1), 0, BOUNDS, places)
    assert asked[0].shape == (3, SIDE * SIDE) and (asked[0][2] == there).all()


def test_the_latest_places_are_shown():
    places = [[i, 2 * i, 3] for i in range(MOST_PLACES + 5)]
    shown = chart(lambda obs: np.zeros((1, obs.shape[1])), (1, 0), 0, BOUNDS, places)["points"]
    assert (
        len(shown) == MOST_PLACES
        and shown[-1] == [2 * (MOST_PLACES + 4), MOST_PLACES + 4]
        and shown[0] == [10, 5]
    )


@pytest.mark.parametrize(
    ("value", "shown"), [(np.nan, 0), (np.inf, 127), (-np.inf, -127), (1.5, 127), (-9, -127)]
)
def test_an_action_beyond_its_bounds_is_drawn_at_the_bound(value, shown):
    drawn = chart(lambda obs: np.full((1, obs.shape[1]), value), (0, 1), 0, BOUNDS, [])
    assert (_values(drawn) == shown).all()
    json.dumps(drawn, allow_nan=False)
