"""Arithmetic on numbers of seeds."""

import numpy as np
import pytest
from scipy.stats import linregress, spearmanr

from gpcjax.reproduce.measures import Measure, average, known, rank_correlations, ratio_of_means, slopes


def of(seeds, values):
    return Measure(np.array(seeds), np.array(values, float))


def test_two_meet_on_the_seeds_that_both_have():
    first, second = of([0, 2, 5, 7], [1, 2, 3, 4]), of([2, 3, 7], [10, 20, 30])
    for result, values in (
        (first - second, [-8, -26]),
        (first + second, [12, 34]),
        (second * first, [20, 120]),
        (second / first, [5, 7.5]),
        (average([first, second]), [6, 17]),
    ):
        assert result.seeds.tolist() == [2, 7] and result.values.tolist() == values
    assert (2 * (first - 1.0)).values.tolist() == [0, 2, 4, 6] and (first / 2).mean == 1.25


def test_what_has_no_value_has_no_run():
    found = known(np.array([3, 4, 9]), np.array([1.0, np.nan, np.inf]))
    assert found.seeds.tolist() == [3] and found.runs == 1
    assert of([0, 1, 2], [10.0, 0.0, -1.0]).log10().seeds.tolist() == [0]
    assert np.isnan(known(np.array([1]), np.array([np.nan])).mean)


def test_a_ratio_of_means_and_its_spread():
    """The pseudo-values' mean is the ratio of totals; their spread is what resampling whole runs shows."""
    random = np.random.default_rng(0)
    counts = random.uniform(1, 50, 200)
    top = of(range(200), counts * random.normal(0.04, 0.01, 200))
    bottom = of(range(200), counts)
    pseudo = ratio_of_means(top, bottom)
    assert pseudo.mean == pytest.approx(top.values.sum() / bottom.values.sum(), rel=1e-3)
    taken = random.integers(200, size=(2000, 200))
    resampled = top.values[taken].sum(1) / bottom.values[taken].sum(1)
    assert pseudo.values.std(ddof=1) / np.sqrt(200) == pytest.approx(resampled.std(), rel=0.1)
    assert ratio_of_means(of([1], [1]), of([1], [4])).values.tolist() == [0.25]
    assert ratio_of_means(of([1, 2], [1, 1]), of([1, 2], [0, 0])).runs == 0


def test_slopes_are_those_of_least_squares():
    curves = np.random.default_rng(0).normal(size=(5, 10))
    expected = [linregress(np.arange(10), curve).slope for curve in curves]
    np.testing.assert_allclose(slopes(curves), expected, rtol=1e-10)
    assert np.isnan(slopes(np.ones((3, 1)))).all()


def test_rank_correlations_are_scipys_where_both_are_known():
    random = np.random.default_rng(0)
    first, second = random.integers(0, 5, (2, 6, 12)).astype(float)
    first[0, 3:7] = np.nan
    second[1] = 1.0
    first[2, 2:] = np.nan
    found = rank_correlations(first, second)
    assert np.isnan(found[1:3]).all()
    for run in (0, 3, 4, 5):
        there = np.isfinite(first[run])
        expected = spearmanr(first[run, there], second[run, there]).statistic
        assert found[run] == pytest.approx(expected, abs=1e-12)
