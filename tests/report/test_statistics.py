import numpy as np
import pytest
from scipy.stats import bootstrap as scipy_bootstrap
from scipy.stats import ttest_1samp

from gpcjax.report import bootstrap
from gpcjax.report.statistics import (
    Scores,
    best_and_tied,
    first_crossing,
    holm,
    mean_band,
    mean_interval,
    median_interval,
    paired_difference,
    student_p,
    walking_mean,
)
from tests.report.coverage import RETURNS, covered


def scores(*values):
    return Scores(np.arange(len(values)), np.array(values, dtype=np.float64))


# Least coverage in percent at 5, 10, 20 and 100 runs: two standard errors of 600 samples below what was measured with
# 4,000. Of runs that are 0 but in one of ten, samples that are all equal cannot cover; all others have to.
LEAST = {
    "normal": (93.8, 94.0, 94.5, 93.5),
    "exponential": (87.0, 90.5, 93.0, 93.3),
    "0 or 2500, p = 0.1": (98.5, 98.5, 98.5, 94.5),
    "0 or 2500, p = 0.5": (98.5, 96.0, 95.5, 92.8),
    "0 or 2500, p = 0.9": (98.5, 98.5, 98.5, 95.5),
}


@pytest.mark.parametrize(
    "name",
    [
        name if name == "0 or 2500, p = 0.1" else pytest.param(name, marks=pytest.mark.slow)
        for name in RETURNS
    ],
)
def test_intervals_cover_the_mean_as_often_as_they_say(name):
    for runs, least in zip((5, 10, 20, 100), LEAST[name], strict=True):
        part, equal = covered(name, runs, samples=600)
        assert 100 * part >= least * (1 - equal), runs


def test_percentiles_and_bca_would_be_too_narrow():
    """At 20 skewed runs: what the intervals are measured against."""
    random = np.random.default_rng(5)
    samples = random.exponential(size=(300, 20))
    for method in ("percentile", "BCa"):
        found = scipy_bootstrap((samples,), np.mean, axis=1, n_resamples=999, method=method, rng=1, batch=100)
        inside = (found.confidence_interval.low <= 1) & (found.confidence_interval.high >= 1)
        assert inside.mean() < 0.935 < covered("exponential", 20, 600)[0]


def test_symmetric_runs_have_students_interval_or_a_little_more():
    values = np.linspace(-1, 1, 20)[:, None]
    known = scipy_bootstrap((values[:, 0],), np.mean, method="BCa", rng=1).confidence_interval
    interval = mean_interval(values)
    student = 2.093024 * values.std(ddof=1) / np.sqrt(20)
    assert student * (1 - 1e-6) <= interval.upper <= 1.08 * student
    assert -interval.lower == pytest.approx(interval.upper, rel=0.08)
    assert interval.lower < known.low and known.high < interval.upper


def test_the_long_tail_has_the_long_side():
    values = np.random.default_rng(3).exponential(size=(20, 1))
    interval = mean_interval(values)
    assert interval.upper - interval.estimate > 1.3 * (interval.estimate - interval.lower)
    mirrored = mean_interval(-values)
    assert mirrored == pytest.approx((-interval.estimate, -interval.upper, -interval.lower))


@pytest.mark.parametrize("scale", [1e-170, 1.0, 1e170])
def test_intervals_scale_and_shift_with_the_scores(scale):
    values = np.random.default_rng(8).normal(size=(12, 1))
    one, other = mean_interval(values), mean_interval(scale * values)
    assert np.array(other) / scale == pytest.approx(np.array(one))
    assert np.array(mean_interval(values + 1000)) - 1000 == pytest.approx(np.array(one))


@pytest.mark.parametrize("value", [0.0, 0.1, 2500.0, -1e300])
@pytest.mark.parametrize("runs", [2, 7, 30])
def test_equal_runs_have_an_interval_of_no_width(value, runs):
    interval = mean_interval(np.full((runs, 1), value))
    assert interval.lower == interval.upper == pytest.approx(interval.estimate)


@pytest.mark.parametrize("other", [0.0, 2500.0])
def test_one_run_of_many_that_differs_gives_a_finite_interval_with_both_sides(other):
    values = np.full((20, 1), 2500.0 - other)
    values[3] = other
    interval = mean_interval(values)
    assert np.isfinite(interval).all()
    # The exact interval (Clopper and Pearson) of 1 in 20 reaches to 0.249: not much less, nor a multiple.
    reach = abs((interval.upper if other else interval.lower) - values[0, 0]) / 2500
    assert 0.18 < reach < 0.5


def test_a_score_that_is_not_finite_has_no_bounds():
    assert np.isnan(mean_interval(np.array([[1.0], [np.nan], [2.0]]))).all()
    assert np.isnan(mean_interval(np.array([[1.0], [np.inf], [2.0]]))[1:]).all()


def test_each_task_is_resampled_for_itself_and_keeps_its_number_of_runs():
    counts = bootstrap._counts(12, 3, 0, 500)
    assert (counts.sum(axis=1) == 12).all()
    assert not (counts[:, :, 0] == counts[:, :, 1]).all()
    assert mean_interval(np.tile([0.0, 100.0], (5, 1))) == (50, 50, 50)  # tasks differ, runs do not


def test_same_scores_give_the_same_interval_in_blocks_too(monkeypatch):
    values = np.random.default_rng(2).normal(size=(20, 1))
    before = mean_interval(values)
    bootstrap._counts.cache_clear()
    assert mean_interval(values) == before
    monkeypatch.setattr(bootstrap, "_LARGEST_BLOCK", 20 * 700)
    in_blocks = mean_interval(values)
    assert in_blocks.estimate == before.estimate
    assert in_blocks[1:] == pytest.approx(before[1:], abs=0.05)


def test_few_runs_have_no_interval():
    one, none = mean_interval(np.array([[3.0]])), mean_interval(np.empty((0, 1)))
    assert one.estimate == 3
    assert not one.excludes_zero
    assert np.isnan([*one[1:], *none]).all()


def test_median_of_times_with_never():
    never = np.inf
    assert median_interval(np.array([4.0, 6, 9, never])).estimate == 7.5
    assert median_interval(np.array([4.0, 6, never, never])).estimate == never
    assert median_interval(np.array([4.0, never, never])) == (never, 4, never)
    assert median_interval(np.array([never] * 5)) == (never, never, never)
    assert np.isnan(median_interval(np.array([])).estimate)
    lower, upper = median_interval(np.arange(1.0, 102))[1:]
    assert 35 <= lower < 51 < upper <= 67


def test_first_crossing():
    curves = np.array([[0.0, 5, 9, 10], [10, 0, 0, 0], [0, 0, 0, 8.9]])
    np.testing.assert_array_equal(first_crossing(curves, 9), [3, 1, np.inf])
    assert np.isnan(first_crossing(curves, np.nan)).all()


def test_walking_mean():
    curves = np.array([[3.0, 6, 9, 0]])
    np.testing.assert_allclose(walking_mean(curves), [[4.5, 6, 5, 4.5]])
    np.testing.assert_allclose(walking_mean(curves[:, :1]), [[3]])
    np.testing.assert_allclose(walking_mean(curves, window=1), curves)


def test_band_counts_present_values_only():
    curves = np.array([[1.0, 2, np.nan], [3, np.nan, np.nan], [5, 4, np.nan]])
    band = mean_band(curves)
    np.testing.assert_allclose(band.mean, [3, 3, np.nan])
    assert (band.lower[:2] < 3).all() and (band.upper[:2] > 3).all() and np.isnan(band.lower[2])
    for point, values in enumerate((curves[:, :1], curves[::2, 1:2])):
        assert (band.lower[point], band.upper[point]) == pytest.approx(mean_interval(values)[1:])
    assert np.isnan(mean_band(curves[:1]).lower).all()


def test_a_long_band_is_that_of_each_of_its_points(monkeypatch):
    curves = np.random.default_rng(9).normal(size=(6, 30))
    whole = mean_band(curves)
    monkeypatch.setattr(bootstrap, "MOST_POINTS", 7)
    np.testing.assert_allclose(mean_band(curves), whole)


def test_paired_difference_uses_common_seeds():
    shared = np.random.default_rng(4).normal(0, 100, 30)
    first = Scores(np.arange(30), shared + 1)
    second = Scores(np.arange(5, 40), np.concatenate([shared[5:], np.zeros(10)]))
    interval, pairs = paired_difference(first, second)
    assert pairs == 25
    assert interval == pytest.approx((1, 1, 1))  # the spread between seeds cancels
    assert interval.excludes_zero
    apart, none = paired_difference(scores(1.0), Scores(np.array([7]), np.array([2.0])))
    assert none == 0 and np.isnan(apart.estimate) and not apart.excludes_zero


def test_best_and_tied():
    noise = np.random.default_rng(6).normal(size=(3, 20))
    points = [scores(*noise[0]), scores(*(5 + noise[1])), scores(*(4.95 + noise[2])), scores()]
    best, tied = best_and_tied(points)
    assert best == np.argmax([point.values.mean() for point in points[:3]])
    assert tied.tolist() == [False, True, True, False]


def test_best_of_points_at_the_ceiling_has_the_highest_mean():
    ceiling = [2500.0] * 9
    best, tied = best_and_tied([scores(100, *ceiling), scores(2400, *ceiling), scores(*ceiling, 2500)])
    assert best == 2
    assert tied.all()


def test_the_best_point_has_the_highest_mean_and_of_equal_ones_it_is_the_first():
    """Not the highest middle half, which says nothing of the runs that fail."""
    steady, brittle = scores(*[2000.0] * 20), scores(*[2500.0] * 14, *[0.0] * 6)
    assert best_and_tied([brittle, steady])[0] == 1
    assert best_and_tied([brittle, steady, steady])[0] == 1


def test_grid_without_runs_has_no_best():
    assert best_and_tied([])[0] is None
    best, tied = best_and_tied([scores(), scores()])
    assert best is None and not tied.any()


def test_holm_by_hand():
    """The example of Holm's step-down: factors 4, 3, 2, 1, never falling, at most 1."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


class TestStudentsP:
    @pytest.mark.parametrize("scale", [1e-170, 1.0, 1e170])
    def test_that_of_scipy_whatever_the_unit(self, scale):
        values = np.random.default_rng(4).normal(0.4, size=15)
        expected = ttest_1samp(values, 0).pvalue
        assert 0.01 < expected < 0.9
        assert student_p(scale * values) == student_p(-scale * values) == pytest.approx(expected)

    def test_equal_values_are_certain_or_say_nothing(self):
        assert student_p(np.full(5, 0.1)) == 0.0
        assert student_p(np.zeros(5)) == 1.0

    @pytest.mark.parametrize("values", [[], [1.0], [1.0, np.nan, 2.0], [1.0, np.inf]])
    def test_none_without_two_finite_values(self, values):
        assert np.isnan(student_p(np.array(values)))
