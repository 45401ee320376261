"""What a report says and costs with many runs and many points."""

import functools
import itertools
import json
import sys

import numpy as np
import pytest

from gpcjax.report import bootstrap, content, html, summary, tables
from gpcjax.report.figures import curves, grids, strips
from gpcjax.report.groups import Group, Limits, Point, Stop, gather
from gpcjax.report.statistics import (
    MANY_RUNS,
    mean_interval,
    mean_intervals,
    median_band,
    median_interval,
    median_intervals,
)
from gpcjax.report.summary import pairs_of, summarise
from gpcjax.sweep.coded import Coded
from gpcjax.sweep.counted import Episodes
from tests.report import golden, synthetic
from tests.report.coverage import covered

STUDIES = {name: (frame, manifest) for name, frame, manifest in golden.studies()}


@pytest.mark.parametrize("name", STUDIES)
def test_the_numbers_are_those_that_each_group_had_for_itself(name):
    """Counts and words exactly, numbers but for rounding: sums and products are others on another processor."""
    found = golden.numbers(summarise(gather(*STUDIES[name])))
    known = json.loads(golden.NUMBERS.read_text())[name]
    assert found["runs"] == known["runs"]
    for table in ("summary", "differences"):
        assert list(found[table]) == list(known[table])
        for column, values in known[table].items():
            if any(isinstance(value, float) for value in values):
                assert [value is None for value in values] == [
                    value is None for value in found[table][column]
                ]
                both = np.array([values, found[table][column]], np.float64)
                largest = np.abs(both[np.isfinite(both)]).max(initial=0)
                np.testing.assert_allclose(*both, rtol=1e-12, atol=1e-12 * largest)
            else:
                assert found[table][column] == values, column


def test_a_frame_in_any_order_and_its_arrays_give_the_same_study():
    frame, manifest = STUDIES["mixed"]
    one, other = (gather(rows, manifest) for rows in (frame, frame.sample(frac=1, random_state=3)))
    assert len(one.groups) == len(other.groups) == 8
    for mine, theirs in zip(one.groups, other.groups, strict=True):
        assert (mine.oracle, mine.error, mine.algo, mine.point) == (
            theirs.oracle, theirs.error, theirs.algo, theirs.point
        )  # fmt: skip
        assert (mine.stopped, mine.unfinished, mine.limits) == (
            theirs.stopped, theirs.unfinished, theirs.limits
        )  # fmt: skip
        for name in ("seeds", "returns", "corrections"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


def samples(random, runs, number):
    return [random.normal(size=count) for count in random.choice(runs, number)]


def test_means_of_many_samples_are_those_of_each():
    random = np.random.default_rng(5)
    several = [*samples(random, (0, 1, 2, 7, 30), 40), np.array([1.0, np.nan]), np.full(7, 0.1)]
    for found, sample in zip(mean_intervals(several), several, strict=True):
        np.testing.assert_allclose(found, mean_interval(sample[:, None]), rtol=1e-12, atol=1e-14)
        assert len(sample) < 2 or sample is several[-2] or found.lower <= found.estimate <= found.upper


@pytest.mark.parametrize("runs", [2, 5, 12, 31])
def test_medians_are_those_of_each_resample_to_the_bit(runs, monkeypatch):
    """A sum over the sorted runs of each resample, sample by sample."""
    random = np.random.default_rng(runs)
    times = [random.integers(1, most, runs).astype(float) for most in (2, 4, 9, 40)]
    times += [np.where(random.random(runs) < part, np.inf, 3.0) for part in (0.2, 0.5, 1.0)]
    counts = bootstrap._counts(runs, 1, 0, bootstrap.RESAMPLES)[:, :, 0]
    monkeypatch.setattr(bootstrap, "MOST_POINTS", 5)
    for sample, found in zip(times, median_intervals(times), strict=True):
        order, middle = np.argsort(sample, kind="stable"), np.array([(runs - 1) // 2, runs // 2])
        taken = counts[:, order].cumsum(axis=1)
        medians = np.sort(sample)[(taken[:, :, None] > middle).argmax(axis=1)].mean(axis=1)
        bounds = np.quantile(medians, bootstrap.TAILS, method="inverted_cdf")
        assert found == (np.median(sample), *bounds)


@pytest.mark.parametrize(
    "name",
    [
        "0 or 2500, p = 0.1",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("normal", "exponential", "0 or 2500, p = 0.5")
        ),
    ],
)
def test_intervals_cover_as_often_as_they_say_where_nothing_is_resampled(name):
    """Of 2,000 samples, whose part has a standard error of 0.5%."""
    part, equal = covered(name, MANY_RUNS, samples=2000)
    assert equal == 0 and 0.94 <= part <= 0.96


def test_nothing_is_resampled_from_many_runs_on(monkeypatch):
    random = np.random.default_rng(1)
    many = random.exponential(size=MANY_RUNS)
    few = many[:-1]
    resampled, student = mean_interval(few[:, None]), mean_interval(many[:, None])
    assert np.allclose(resampled[1:], student[1:], rtol=0.003)
    monkeypatch.setattr(bootstrap, "_bootstrap", None)
    assert mean_interval(many[:, None]) == student
    half = 1.960439 * many.std(ddof=1) / np.sqrt(MANY_RUNS)  # Student's t of 4,999 degrees of freedom
    assert student[1:] == pytest.approx((many.mean() - half, many.mean() + half), rel=1e-7)
    times = np.where(random.random(MANY_RUNS) < 0.45, np.inf, random.integers(1, 31, MANY_RUNS))
    band = median_band(times[:, None])
    assert median_interval(times) == (band.mean[0], band.lower[0], band.upper[0])
    assert median_interval(np.full(MANY_RUNS, np.inf)) == (np.inf,) * 3
    assert np.isnan(median_interval(np.full(MANY_RUNS, np.nan))).all()


def made(**sizes):
    """A study of so many points, runs and so on."""
    return gather(*held(**sizes))


def held(points=1, seeds=4, algos=("gpc",), episodes=2, errors=1, names=("delta",)):
    """What a store of these sizes holds, as arrays, and its manifest."""
    each = np.array(list(np.ndindex(len(algos), errors, points, seeds)))
    algo, error, point, seed = each.T
    cells = len(each)
    returns = np.random.default_rng(0).uniform(0, 2500, cells * episodes)
    ones = np.ones(cells, np.int64)
    counted = Episodes(
        "cartpole",
        {
            "algo": Coded(algo, algos),
            "oracle": Coded(0 * algo, ("lqr",)),
            "error": Coded(error, tuple(i / errors / 2 for i in range(errors))),
            **{name: Coded(point, tuple(0.1 + i for i in range(points))) for name in names if points > 1},
        },
        seed,
        {name: ones for name in ("length", "clipped", "full")},
        np.repeat(np.arange(cells, dtype=np.int32), episodes),
        np.tile(np.arange(1, episodes + 1, dtype=np.int32), cells),
        returns,
        np.ones(cells * episodes, np.int32),
        Coded(np.zeros(cells * episodes, np.int16), ("ok",)),
    )
    manifest = {
        "specification": {"env": "cartpole", "algo": list(algos), "episodes": episodes, "seeds": seeds},
        "varying": names,
        "cells": cells,
        "baselines": {
            "idle": {"mean": 0.0, "std": 1.0, "n": 5},
            "oracles": {"lqr": {"mean": 2500.0, "std": 0.0, "n": 5}},
        },
    }
    return counted, manifest


def calls(function):
    """How many functions of Python are called meanwhile."""
    count = 0

    def counted(frame, event, argument):
        nonlocal count
        count += event == "call"

    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count


def said(store):
    """All that a report says but its figures, which look each group up as the tables do."""
    study = gather(*store)
    found = summarise(study)
    found.table(), found.difference_table(), found.leading
    for group in study.groups:
        found.of(group), study.select(group.oracle, group.error, group.algo)
    tables.warnings(found), tables.point_sheets(found), content.document(found, [])


def test_what_is_called_grows_with_the_points_and_not_with_the_runs():
    small, large, few, many = (
        calls(functools.partial(said, held(**sizes)))
        for sizes in (
            {"points": 60, "algos": ("gpc", "coach")},
            {"points": 240, "algos": ("gpc", "coach")},
            {"seeds": MANY_RUNS},
            {"seeds": 4 * MANY_RUNS},
        )
    )
    assert large < 4.4 * small and many < 1.02 * few


def group(algo, seeds=(0, 1), stopped=(), **values):
    nothing = np.zeros((len(seeds), 1))
    point, limits = Point(tuple(values.items())), Limits(0, 0, 0)
    return Group("lqr", 0.0, algo, point, np.array(seeds), nothing, nothing, stopped, (), limits)


@pytest.mark.parametrize(
    ("mine", "theirs"),
    [
        (["delta", "rate"], ["delta", "rate"]),
        (["delta", "rate"], ["rate", "other"]),
        (["delta"], ["rate"]),
        (["delta"], []),
    ],
)
def test_points_meet_those_that_agree(mine, theirs):
    random = np.random.default_rng(2)

    def points(algo, names):
        """Of some a setting is not known."""
        return [
            group(algo, **{name: float(random.integers(3)) for name in names if random.random() < 0.8})
            for _ in range(30)
        ]

    firsts, seconds = points("gpc", mine), points("coach", theirs)
    every = [(a, b) for a, b in itertools.product(firsts, seconds) if a.point.agrees(b.point)]
    assert pairs_of(firsts, seconds, set()) == (every, 0) and every


def test_too_many_pairs_are_those_with_a_best_point(monkeypatch):
    monkeypatch.setattr(summary, "MOST_PAIRS", 50)
    firsts, seconds = (
        [group(algo, **{name: i}) for i in range(10)] for algo, name in (("gpc", "a"), ("coach", "b"))
    )
    best = {firsts[3], seconds[7]}
    pairs, left_out = pairs_of(firsts, seconds, best)
    assert len(pairs) == 19 and left_out == 81
    assert all(first in best or second in best for first, second in pairs)


def test_a_study_says_that_pairs_are_left_out(monkeypatch):
    monkeypatch.setattr(summary, "MOST_PAIRS", 8)
    points = {"gpc": [{"delta": i / 10} for i in (1, 2, 3)], "coach": [{"rate": i / 10} for i in (1, 2, 3)]}
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0,), seeds=2, length=3, points=points)
    found = summarise(gather(frame, synthetic.manifest(frame, ["delta", "rate"])))
    assert (len(found.differences), found.unpaired) == (5, 4)
    assert "Of 9 pairs of points these are the 5 with a best point." in tables.reading_differences(found)


def test_a_run_of_many_that_is_not_counted_is_found():
    some = group("gpc", (0, 3), tuple(Stop(seed, 1, "full") for seed in (1, 3, 5)))
    assert [stop.seed for stop in some.uncounted] == [1, 5]
    assert some.broke_down.tolist() == [False, True]


def test_many_points_are_a_range_and_a_page_without_their_table(monkeypatch):
    monkeypatch.setattr(curves, "MOST_LINES", 20)
    monkeypatch.setattr(grids, "MOST_MARKS", 20)
    found = summarise(made(points=30))
    figure, _, caption = curves.learning_curves(found)
    (axis,) = figure.axes
    thin = [line for line in axis.lines if line.get_linewidth() == 0.5]
    assert len(thin) == 2 and "of more than 20 other points the thin lines hold the middle 90%" in caption
    others = np.array([g.returns.mean(axis=0).mean() for g in found.study.groups if not found.of(g).best])
    low, high = (line.get_ydata()[0] for line in thin)  # a walking mean of two episodes is their mean
    assert 0.85 < np.mean((low <= others) & (others <= high)) < 0.95
    assert "middle 90%" not in curves.learning_curves(summarise(made(points=20))).caption


def test_a_large_heatmap_has_its_star_and_few_ticks(monkeypatch):
    monkeypatch.setattr(grids, "MOST_MARKS", 20)
    points = synthetic.length_scale_grid(np.linspace(0.1, 1, 15).tolist(), (0.1, 0.2))
    frame = synthetic.episodes(
        algos=("gpc",), errors=(0.0,), seeds=2, length=2, points={"gpc": points["gpc"]}
    )
    found = summarise(gather(frame, synthetic.manifest(frame, list(points["gpc"][0]))))
    figure, _, caption = grids.final_returns(found)
    axis, _ = figure.axes
    (star,) = axis.lines
    (best,) = [row.group.point for row in found.rows if row.best]
    place = int(star.get_ydata()[0]), int(star.get_xdata()[0])
    assert axis.images[0].get_array()[place] == np.max(axis.images[0].get_array())
    assert best.get("human_length_scale") == (0.1, 0.2)[place[0]]
    assert (
        not axis.texts and len(axis.get_xticks()) <= 6 and "those that are tied are in summary.csv" in caption
    )
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["best"]


def test_a_long_line_marks_its_best_point_and_those_tied(monkeypatch):
    monkeypatch.setattr(grids, "MOST_POINTS", 20)
    found = summarise(made(points=30))
    (axis,) = grids.final_returns(found).figure.axes
    stars = [line for line in axis.lines if line.get_marker() == "*"]
    (tied,) = [line for line in axis.lines if line.get_marker() == "."]
    assert len(stars) == 1 and len(axis.lines) == 3
    assert len(tied.get_xdata()) == sum(row.tied for row in found.rows)


def test_many_runs_are_a_histogram(monkeypatch):
    monkeypatch.setattr(strips, "MOST_DOTS", 50)
    found = summarise(made(seeds=60))
    figure, _, caption = curves.learning_curves(found)
    (axis,) = figure.axes
    assert "More than 50 runs are a histogram." in caption
    assert not [line for line in axis.lines if line.get_linestyle() == "None"]
    final = found.study.groups[0].final.values
    (bars,) = axis.containers
    longest = max(bar.get_width() for bar in bars)
    counts = [bar.get_width() / longest for bar in bars]
    expected, _ = np.histogram(final, bins=strips.ROWS, range=axis.get_ylim())
    np.testing.assert_allclose(counts, expected / expected.max(), atol=1e-9)


def test_rates_of_many_runs_are_those_of_the_first(monkeypatch):
    monkeypatch.setattr(curves, "MOST_RATED", 5)
    found = summarise(made(seeds=8))
    rows = synthetic.corrections(algos=("gpc",), errors=(0.0,), seeds=8, oracles=("lqr",))
    (chosen,) = curves.shown_rates(found)
    assert chosen.seeds.tolist() == [0, 1, 2, 3, 4]
    few, every = (curves.learning_rates(found, frame) for frame in (rows[rows["seed"] < 5], rows))
    assert "Of more than 5 runs those with the lowest seeds." in every.caption
    np.testing.assert_array_equal(*(each.figure.axes[0].lines[0].get_ydata() for each in (few, every)))


def test_many_panels_are_the_first(monkeypatch):
    monkeypatch.setattr(curves, "MOST_PANELS", 3)
    found = summarise(made(errors=5))
    figure, _, caption = curves.learning_curves(found)
    assert len(figure.axes) == 3 and "the first 3 of 5 panels" in caption
    monkeypatch.setattr(tables, "MOST_LEADING", 4)
    (sheet,) = tables.result_sheets(found)
    assert len(
        sheet.rows
    ) == 4 + 2 and "A table has 4 rows at most. All are in summary.csv." in tables.reading(found)


def test_pages_and_terminals_leave_long_tables_to_the_files(monkeypatch):
    monkeypatch.setattr(content, "MOST_ROWS", 25)
    monkeypatch.setattr(content, "MOST_VALUES", 10)
    found = summarise(made(points=30))
    found.study.manifest["specification"]["delta"] = [0.1 + i for i in range(30)]
    page = html.render(content.document(found, []))
    assert "Every point of the grid: more than 25 rows, see summary.csv" in page
    assert "0.1, 1.1, 2.1, ..., 29.1 (30 values)" in page and page.count("<tr") < 15


def test_stopped_runs_of_many_groups_are_listed_in_part(monkeypatch):
    monkeypatch.setattr(tables, "MOST_STOPPED", 2)
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0, 0.1, 0.2, 0.3), seeds=2, length=4)
    frame.loc[frame["episode"] == 4, "status"] = "full"
    lines = tables.warnings(summarise(gather(frame, synthetic.manifest(frame))))
    assert len(lines) == 4 and lines[-1] == "  and runs of 2 more rows, see summary.csv"


@pytest.mark.parametrize(
    ("seeds", "kind"), [((4,), "bootstrap over seeds)"), ((9,), "Student's t)"), ((4, 9), "from 6 runs on)")]
)
def test_a_report_says_of_which_kind_its_intervals_are(monkeypatch, seeds, kind):
    for module in (tables, content):
        monkeypatch.setattr(module, "MANY_RUNS", 6)
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0, 0.1), seeds=max(seeds), length=3)
    frame = frame[(frame["error"] == 0) | (frame["seed"] < min(seeds))]
    found = summarise(gather(frame, synthetic.manifest(frame)))
    assert kind in tables.reading(found)[0]
    assert ("From 6 runs on nothing is resampled" in str(content.document(found, []))) == (max(seeds) > 6)
