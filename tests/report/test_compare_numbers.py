"""Chances and profiles against rliable's, kept in rliable.json (`tests.report.rliable_values`), and by hand."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from gpcjax.report.compare_numbers import better, better_paired, differences, profile
from gpcjax.report.groups import Group, Limits, Point
from gpcjax.report.statistics import holm

RLIABLE = {
    name: {key: np.array(value) for key, value in each.items()}
    for name, each in json.loads((Path(__file__).parent / "rliable.json").read_text()).items()
}


@pytest.mark.parametrize("name", RLIABLE)
def test_the_chance_of_being_better_is_rliables(name):
    known = RLIABLE[name]
    found = better(known["first"], known["second"])
    assert found.estimate == pytest.approx(known["better"], abs=1e-12)
    if name != "apart":  # where its percentiles have no width
        # It knows of no pairs: on average over ways to shift the seeds, neither does ours.
        shifts = range(1, len(known["first"]), 4)
        shifted = [better(known["first"], np.roll(known["second"], shift))[1:] for shift in shifts]
        assert np.mean(shifted, axis=0) == pytest.approx(known["better_bounds"], abs=0.06)


@pytest.mark.parametrize("name", RLIABLE)
def test_profiles_are_rliables_with_bands_no_narrower(name):
    known = RLIABLE[name]
    found = profile(known["values"], known["first"])
    assert found.mean == pytest.approx(known["above"], abs=1e-12)
    lower, upper = known["above_bounds"]
    inside = (known["above"] > 0) & (known["above"] < 1)
    assert inside.any() and not inside.all()
    assert (found.lower <= lower + 0.03).all() and (found.upper >= upper - 0.03).all()
    assert (found.upper - found.lower < upper - lower + 0.12)[inside].all()
    assert (found.upper - found.lower > 0.1)[~inside].all()  # what no run had may still happen


def test_a_value_itself_is_not_above():
    assert profile(np.array([0.0, 1.0, 1.5, 2.0]), np.array([1.0, 1.0, 2.0, 2.0])).mean.tolist() == [
        1,
        0.5,
        0.5,
        0,
    ]


def test_intervals_cover_the_chance_and_use_the_pairs():
    """Normal runs half a standard deviation apart, with and without what a seed has in common."""
    random = np.random.default_rng(7)
    truth, widths = norm.cdf(0.5 / np.sqrt(2)), {}
    for shared in (0.0, 0.9):
        inside = []
        for _ in range(150):
            own, common = random.normal(size=(2, 20)), random.normal(size=20)
            first, second = np.sqrt(1 - shared) * own + np.sqrt(shared) * common
            found = better(first + 0.5, second)
            inside.append(found.lower <= truth <= found.upper)
            widths.setdefault(shared, []).append(found.upper - found.lower)
        assert np.mean(inside) >= 0.92
    assert np.mean(widths[0.9]) < 0.6 * np.mean(widths[0.0])


def test_the_other_way_round_is_one_minus():
    first, second = RLIABLE["smooth"]["first"], RLIABLE["smooth"]["second"]
    for chance in (better, better_paired):
        estimate, lower, upper = chance(first, second)
        assert chance(second, first) == pytest.approx((1 - estimate, 1 - upper, 1 - lower))


def test_a_small_advantage_on_every_seed_is_seen_in_pairs_alone():
    second = np.random.default_rng(1).normal(size=30)
    first = second + 0.01
    assert better(first, second).upper < 0.6
    paired = better_paired(first, second)
    assert paired.estimate == paired.upper == 1.0
    assert paired.lower == pytest.approx(0.025 ** (1 / 30))


def test_quite_apart_is_no_certainty():
    """The bound at which so many pairs come out alike in one of forty samples."""
    apart = better(np.arange(10.0) + 100, np.arange(10.0))
    assert apart == (1.0, pytest.approx(0.025**0.1), 1.0)
    nearly = better(np.array([*np.arange(19.0) + 100, 17.5]), np.arange(20.0))
    assert nearly.estimate < 1 and nearly.lower <= 0.025**0.05 + 1e-12


def test_equal_runs_count_half():
    assert better(np.ones(6), np.ones(6)).estimate == better_paired(np.ones(6), np.ones(6)).estimate == 0.5
    assert better_paired(np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 1.0, 4.0, 3.0])).estimate == 0.625


@pytest.mark.parametrize("chance", [better, better_paired])
def test_without_runs_there_is_nothing_and_one_has_no_bounds(chance):
    assert np.isnan(chance(np.zeros(0), np.zeros(0))).all()
    estimate, *bounds = chance(np.array([2.0]), np.array([1.0]))
    assert estimate == 1.0 and np.isnan(bounds).all()


def group(returns, seeds=None):
    returns = np.asarray(returns, np.float64)
    seeds = np.arange(len(returns)) if seeds is None else np.asarray(seeds)
    return Group("gpc", 0.0, "gpc", Point(), seeds, returns, 0 * returns, (), (), Limits(1, 0, 0))


def pair(one, other):
    folder = SimpleNamespace()
    return SimpleNamespace(first=folder, second=folder, one=one, other=other)


class TestDifferences:
    def test_runs_are_paired_by_their_seed(self):
        one = group([[1.0, 3.0], [10.0, 10.0], [5.0, 5.0]], seeds=[0, 4, 7])
        other = group([[9.0, 9.0], [5.0, 5.0], [0.0, 0.0]], seeds=[4, 7, 9])
        area, final = differences([pair(one, other)])
        assert (area.statistic, final.statistic) == ("area", "final_return")
        assert (area.pairs, area.equal, area.difference.estimate) == (2, 1, 0.5)
        assert area.better_paired.estimate == 0.75

    def test_holms_family_is_all_of_them_that_can_be_tested(self):
        random = np.random.default_rng(2)
        runs = [random.normal(shift, 1.0, (12, 8)) for shift in (0.0, 0.4, 3.0)]
        without = group(runs[0], seeds=np.arange(100, 112))
        made = differences(pair(group(each), group(runs[0][:, ::-1])) for each in runs[1:])
        more = differences([*(each.pair for each in made[::2]), pair(without, group(runs[0]))])
        assert [each.p_holm for each in made] == pytest.approx(holm([each.p for each in made]))
        assert [each.p_holm for each in more[:4]] == [each.p_holm for each in made]
        assert (
            more[-1].pairs == 0
            and np.isnan([more[-1].p, more[-1].p_holm, more[-1].difference.estimate]).all()
        )
        assert not more[-1].survives and made[-1].survives

    def test_what_holm_does_not_leave_does_not_survive(self):
        noise = np.random.default_rng(3).normal(size=40)
        weak = (noise - noise.mean() + 0.4 * noise.std(ddof=1))[:, None]
        alone = differences([pair(group(weak), group(0 * weak))])
        many = differences([pair(group(weak), group(0 * weak)) for _ in range(20)])
        assert alone[0].survives and alone[0].difference.excludes_zero
        assert many[0].difference.excludes_zero and not many[0].survives
