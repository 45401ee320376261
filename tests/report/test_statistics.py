import numpy as np
import pytest
from scipy.stats import trim_mean

from gpcjax.report import statistics
from gpcjax.report.statistics import (
    Scores,
    best_and_tied,
    first_crossing,
    interquartile_interval,
    interquartile_mean,
    mean_band,
    mean_interval,
    median_interval,
    paired_difference,
    walking_mean,
)


def scores(*values):
    return Scores(np.arange(len(values)), np.array(values, dtype=np.float64))


@pytest.mark.parametrize("shape", [(1, 1), (2, 1), (3, 1), (7, 1), (100, 1), (5, 3), (10, 26)])
def test_interquartile_mean_is_a_trimmed_mean(shape):
    values = np.random.default_rng(1).normal(size=shape)
    assert interquartile_mean(values) == pytest.approx(trim_mean(values, 0.25, axis=None), abs=1e-14)


# get_interval_estimates of rliable 1.2 with 20,000 resamples: interquartile mean, its interval, mean, its interval.
RLIABLE = {
    (30, 1): (377.87087009, 286.93454579, 483.28152644, 449.53984998, 331.84117365, 585.36267402),
    (12, 4): (407.68715179, 314.74447641, 541.14506355, 515.51140976, 408.46860002, 634.12149713),
    (101, 1): (419.45671345, 351.09429302, 489.59989158, 498.9789185, 424.44241274, 581.52805755),
}


def test_intervals_agree_with_rliable():
    random = np.random.default_rng(3)
    for shape, expected in RLIABLE.items():
        values = random.gamma(1.5, 300, size=shape)
        for interval, known in (
            (interquartile_interval(values), expected[:3]),
            (mean_interval(values), expected[3:]),
        ):
            width = known[2] - known[1]
            assert interval.estimate == pytest.approx(known[0])
            assert interval.lower == pytest.approx(known[1], abs=0.04 * width)
            assert interval.upper == pytest.approx(known[2], abs=0.04 * width)


def test_bootstrap_of_interquartile_mean_equals_sorting_each_resample():
    values = np.random.default_rng(5).normal(size=(9, 2)).round(1)  # with equal values
    counts = statistics._counts(9, 2, 0, statistics.RESAMPLES)
    resampled = [
        trim_mean(
            np.concatenate([np.repeat(values[:, task], count[:, task].astype(int)) for task in (0, 1)]), 0.25
        )
        for count in counts
    ]
    assert interquartile_interval(values)[1:] == pytest.approx(np.quantile(resampled, statistics._TAILS))


def test_intervals_cover_the_truth_as_often_as_they_say():
    random = np.random.default_rng(11)
    covered = [
        interval.lower <= 0 <= interval.upper
        for interval in (mean_interval(random.normal(size=(40, 1))) for _ in range(400))
    ]
    assert 0.90 <= np.mean(covered) <= 0.98


def test_each_task_is_resampled_for_itself_and_keeps_its_number_of_runs():
    counts = statistics._counts(12, 3, 0, 500)
    assert (counts.sum(axis=1) == 12).all()
    assert not (counts[:, :, 0] == counts[:, :, 1]).all()
    assert mean_interval(np.tile([0.0, 100.0], (5, 1))) == (50, 50, 50)  # tasks differ, runs do not


def test_same_scores_give_the_same_interval_in_blocks_too(monkeypatch):
    values = np.random.default_rng(2).normal(size=(20, 1))
    before = interquartile_interval(values)
    statistics._counts.cache_clear()
    assert interquartile_interval(values) == before
    monkeypatch.setattr(statistics, "_LARGEST_BLOCK", 20 * 700)
    in_blocks = interquartile_interval(values)
    assert in_blocks.estimate == before.estimate
    assert in_blocks[1:] == pytest.approx(before[1:], abs=0.05)


@pytest.mark.parametrize("interval", [interquartile_interval, mean_interval])
def test_few_runs_have_no_interval(interval):
    one, none = interval(np.array([[3.0]])), interval(np.empty((0, 1)))
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
    point = mean_interval(curves[:, :1])
    assert (band.lower[0], band.upper[0]) == pytest.approx(point[1:])
    assert np.isnan(mean_band(curves[:1]).lower).all()


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
    best, tied = best_and_tied(
        [scores(*noise[0]), scores(*(5 + noise[1])), scores(*(4.95 + noise[2])), scores()]
    )
    assert best == 1
    assert tied.tolist() == [False, True, True, False]


def test_best_of_points_at_the_ceiling_has_the_highest_mean():
    ceiling = [2500.0] * 9
    best, tied = best_and_tied([scores(100, *ceiling), scores(2400, *ceiling), scores(*ceiling, 2500)])
    assert best == 2
    assert tied.all()


def test_grid_without_runs_has_no_best():
    assert best_and_tied([])[0] is None
    best, tied = best_and_tied([scores(), scores()])
    assert best is None and not tied.any()
