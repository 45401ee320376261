"""How late advice is, in steps: against scipy's distributions, and what is refused."""

import re

import numpy as np
import pytest
from scipy import stats

from gpcjax.engine.history import Credit
from gpcjax.errors import UserError
from gpcjax.lateness import CREDIT, DELAY, MOST, check, lateness


def mean(chances):
    return float(np.dot(np.arange(len(chances)), chances))


def test_no_delay():
    assert lateness(DELAY, None, None, None, 0.02) == (1.0,)
    assert lateness(DELAY, 0.0, None, None, 0.02) == (1.0,)
    assert Credit.of(None, None, None, 0.02) is None
    assert Credit.of(0.0, None, None, 0.02) is None


@pytest.mark.parametrize(
    ("seconds", "steps"), [(0.009, 0), (0.01, 1), (0.02, 1), (0.029, 1), (0.03, 2), (0.2, 10), (20.48, MOST)]
)
def test_fixed(seconds, steps):
    """The nearest number of steps, halves up."""
    assert lateness(DELAY, seconds, None, None, 0.02) == (0.0,) * steps + (1.0,)


@pytest.mark.parametrize(
    ("shortest", "longest", "first", "last"), [(0.0, 0.1, 0, 5), (0.2, 0.6, 10, 30), (0.2, 0.2, 10, 10)]
)
def test_uniform(shortest, longest, first, last):
    """All numbers of steps between the two, both among them, are as likely."""
    chances = lateness(DELAY, shortest, longest, None, 0.02)
    np.testing.assert_allclose(chances, stats.randint.pmf(np.arange(last + 1), first, last + 1), rtol=1e-14)
    assert mean(chances) == pytest.approx((first + last) / 2)


@pytest.mark.parametrize(
    ("seconds", "shape"), [(0.3, 3.0), (0.3, 0.4), (0.3, 400.0), (0.05, 2.0), (5.0, 3.0), (0.001, 2.0)]
)
def test_gamma(seconds, shape):
    """What of the distribution rounds to each number of steps, without the last thousandth of its tail."""
    step = 0.02
    chances = lateness(DELAY, seconds, None, shape, step)
    assert sum(chances) == pytest.approx(1.0, abs=1e-12)
    assert min(chances) >= 0.0 and chances[-1] > 0.0
    given = stats.gamma(shape, scale=seconds / shape)
    edges = np.maximum(np.arange(len(chances) + 1) - 0.5, 0.0) * step
    covered = given.cdf(edges[-1])
    assert covered > 0.999 - 1e-9 and (len(chances) == 1 or given.cdf(edges[-2]) < 0.9995)
    np.testing.assert_allclose(np.array(chances) * covered, np.diff(given.cdf(edges)), rtol=1e-9, atol=1e-15)
    # The tail that is left out lies far: it is a thousandth of the chances, and more of the mean.
    rounded = np.floor(given.ppf((np.arange(20_000) + 0.5) / 20_000) / step + 0.5).mean()
    assert mean(chances) == pytest.approx(rounded, rel=0.02, abs=1e-3)


@pytest.mark.parametrize("shape", [1e-300, 1e-6, 1e12, 1e300])
def test_shapes_beyond_reason_are_distributions_or_refused(shape):
    try:
        chances = lateness(DELAY, 0.3, None, shape, 0.02)
    except UserError as error:
        assert str(error).startswith("delay_shape") and "\n" not in str(error)
    else:
        assert sum(chances) == pytest.approx(1.0) and chances[-1] > 0.0


@pytest.mark.parametrize(("seconds", "shape"), [(1e300, 1e-300), (1e-300, 1e300), (1e300, 1e-9)])
def test_delays_that_are_no_numbers_are_refused(seconds, shape):
    told = re.escape(f"credit_shape {shape:g}: with credit {seconds:g} there are no such delays")
    with pytest.raises(UserError, match=told):
        lateness(CREDIT, seconds, None, shape, 0.02)


def test_a_gamma_distribution_becomes_a_fixed_delay():
    """As its shape grows its spread vanishes."""
    chances = lateness(DELAY, 0.3, None, 1e6, 0.02)
    assert chances[15] == pytest.approx(1.0)


def test_credit():
    """The weights are those chances, from the latest moment that has any."""
    credit = Credit.of(0.2, 0.6, None, 0.02)
    assert (credit.first, credit.moments, credit.reach) == (10, 21, 30)
    np.testing.assert_allclose(credit.weights, 1 / 21)
    fixed = Credit.of(0.1, None, None, 0.02)
    assert (fixed.first, fixed.moments, fixed.reach) == (5, 1, 5)
    gamma = Credit.of(0.3, None, 3.0, 0.02)
    chances = lateness(CREDIT, 0.3, None, 3.0, 0.02)
    np.testing.assert_array_equal(gamma.weights, chances[gamma.first :])
    assert gamma.reach == len(chances) - 1
    assert not any(chances[: gamma.first]) and chances[gamma.first] > 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0.1, 0.3, 2.0), "late_longest: beside late_shape it changes nothing, give one of the two"),
        ((None, 0.3, None), "late_longest: without late it changes nothing, give both"),
        ((None, None, 2.0), "late_shape: without late it changes nothing, give both"),
        ((0.0, None, 2.0), "late_shape: without late it changes nothing, give both"),
        ((0.3, 0.1, None), "late_longest 0.1: give at least late, 0.3"),
        ((20.5, None, None), "late: 1,025 steps of 0.02 s, 1,024 are kept at most: give fewer seconds"),
        ((0.1, 1e300, None), "late_longest: 1,000,000,000 steps of 0.02 s, 1,024 are kept at most: give fewer seconds"),
        ((10.0, None, 0.5), "late: 5,414 steps of 0.02 s, 1,024 are kept at most: give fewer seconds"),
    ],
)  # fmt: skip
def test_refused(given, message):
    with pytest.raises(UserError) as refused:
        lateness(("late", "late_longest", "late_shape"), *given, 0.02)
    assert str(refused.value) == message


def test_every_combination_of_a_sweep_is_checked():
    """And refused by the name that it was given by."""
    values = {"delay": (0.0, 0.1, 0.2), "delay_longest": (0.2, 0.4)}
    check(DELAY, values, {}, 0.02)
    check(CREDIT, values, {}, 0.02)
    places = {"delay_longest": "--delay-longest"}
    for name, worse in (("delay_longest", (0.2, 0.1)), ("delay", (0.3, 0.1))):
        with pytest.raises(UserError, match=r"^--delay-longest 0.[12]: give at least delay, 0.[23]$"):
            check(DELAY, values | {name: worse}, places, 0.02)
    with pytest.raises(UserError, match=r"^--delay-longest: beside delay_shape it changes nothing"):
        check(DELAY, values | {"delay_shape": (3.0,)}, places, 0.02)
