"""Learning curves (as Figs. 5.1 and 5.4 of the thesis) and learning rates (as Fig. 5.2)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from gpcjax.report import style, words
from gpcjax.report.groups import FINAL_EPISODES, Baseline, Group, Study, unique
from gpcjax.report.statistics import Band, mean_band, median_band, walking_mean
from gpcjax.report.style import Drawing
from gpcjax.report.summary import Summary
from gpcjax.sweep.counted import Chosen

FIRST_CORRECTIONS = 150
MOST_RATED = 10_000
"""Runs of a line of learning rates: of more those with the lowest seeds."""

WINDOW = 3
"""Episodes of the walking mean."""

STRIP = 0.08
"""Width of the column of an algorithm's final returns, in parts of that of the curves."""

CUT = "Wide intervals are cut at the edge of a panel."

ORACLE_LINE: dict[str, Any] = {
    "color": style.ORACLE_COLOUR,
    "linewidth": 0.9,
    "linestyle": (0, (5, 2)),
    "zorder": 1,
}
ORACLE_BAND: dict[str, Any] = {"color": style.ORACLE_COLOUR, "linewidth": 0, "alpha": 0.1, "zorder": 1}
IDLE_LINE: dict[str, Any] = {
    "color": style.IDLE_COLOUR,
    "linewidth": 0.9,
    "linestyle": (0, (1, 1.5)),
    "zorder": 1,
}


def learning_curves(summary: Summary) -> Drawing:
    """Return against episode, a panel for each oracle and error rate.

    Of each algorithm: the mean over runs (faint), its walking mean and that one's 95% interval; beside the panel the
    final return of each run. Of a grid the best point, the other points as thin lines. Behind them the oracle (mean
    and one standard deviation) and the idle policy.
    """
    study, looks = summary.study, style.looks(summary.study.algorithms)
    with style.publication():
        figure, axes = style.panels(_titles(study), _columns(study))
        reach: list[float] = []
        leading: dict[Axes, list[Group]] = {}
        for (oracle, error), axis in zip(study.panels, axes, strict=True):
            reach += _baselines(axis, study.oracle(oracle), study.idle)
            groups = [group for group in study.select(oracle, error) if group.runs]
            for group in groups:
                _curve(axis, group, looks[group.algo], leading=summary.of(group).best)
            style.count_ticks(axis, study.episodes)
            axis.yaxis.set_major_locator(MaxNLocator(nbins=6))
            leading[axis] = [group for group in groups if summary.of(group).best]
            reach += [value for group in leading[axis] for value in group.final.values]
        cut = style.follow_lines(axes, reach)
        for axis, groups in leading.items():
            _strip(axis, groups, study)
        style.label(axes, "episode", words.return_label(study))
        style.legend(figure, _algorithms(study) + _baseline_handles(study))
    return Drawing(figure, "Learning curves", _curves_caption(summary, cut))


def _curves_caption(summary: Summary, cut: bool) -> str:
    study = summary.study
    sentences = [
        f"Learning curves in {study.env} ({words.runs(study)} a line). Strong lines: walking mean of {WINDOW} episodes "
        "of the mean over runs, with its 95% interval; faint lines: the mean itself. Right of each panel the final "
        f"return of every run (mean of its last {FINAL_EPISODES} episodes), with a bar at their mean.",
    ]
    if study.varying:
        sentences.append(
            "Of a grid the point with the highest mean final return; thin lines are the other points."
        )
    if any(group.broke_down.any() for group in study.groups):
        sentences.append(
            "Runs that stopped (crosses) have the idle policy's mean return from the episode on in which they stopped."
        )
    return " ".join([*sentences, *([CUT] if cut else [])])


def learning_rates(summary: Summary, corrections: pd.DataFrame) -> Drawing | None:
    """Median learning rate of each of the first corrections, with 95% interval.

    A panel for each oracle, error rate and action dimension: a dimension is corrected by itself. The median, as
    COACH's rate is unbounded: off its grid a single run may take steps a hundred times the usual. A line ends where
    fewer than half of the runs have so many corrections. Of a grid the best point. None if no run that is counted has
    a correction.
    """
    study, looks = summary.study, style.looks(summary.study.algorithms)
    if corrections.empty:
        return None
    rates = _rates(summary, corrections)
    dimensions = unique(dimension for _, dimension in rates)
    longest = max((rate.shape[1] for rate in rates.values()), default=0)
    if not longest:
        return None
    several = len(dimensions) > 1
    panels = [(*panel, d) for d in dimensions for panel in study.panels]
    titles = [
        title + (f", {words.action(study.env, d)}" if several else "")
        for d in dimensions
        for title in _titles(study)
    ]
    with style.publication():
        figure, axes = style.panels(titles, len(study.errors) if several else _columns(study))
        for (oracle, error, dimension), axis in zip(panels, axes, strict=True):
            for group in study.select(oracle, error):
                band = rates.get((group, dimension))
                if band is not None and band.size:
                    line(axis, np.arange(1, band.shape[1] + 1), median_band(band), looks[group.algo])
            style.count_ticks(axis, longest)
        cut = style.follow_lines(axes, bottom=0.0)
        style.label(axes, "correction", "learning rate, median of runs")
        style.legend(figure, _algorithms(study))
    sentences = [
        f"Learning rate of the first {FIRST_CORRECTIONS} corrections{' of each action dimension' if several else ''}: "
        "median over runs with its 95% interval. A line ends where fewer than half of the runs have so many "
        "corrections."
    ]
    sentences += ["Of a grid the point with the highest mean final return."] if study.varying else []
    if any(group.runs > MOST_RATED for group, _ in rates):
        sentences.append(f"Of more than {MOST_RATED:,} runs those with the lowest seeds.")
    return Drawing(figure, "Learning rates", " ".join([*sentences, *([CUT] if cut else [])]))


def shown_rates(summary: Summary) -> list[Chosen]:
    """The runs whose learning rates are drawn: of the best point of each algorithm in each panel."""
    return [
        Chosen(
            group.algo, group.oracle, group.error, dict(group.point.values), group.seeds[:MOST_RATED]
        )
        for group in (row.group for row in summary.leading if row.best)
    ]


def _rates(summary: Summary, corrections: pd.DataFrame) -> dict[tuple[Group, int], np.ndarray]:
    """The first learning rates of what `shown_rates` chooses, for each action dimension."""
    dimensions = sorted(corrections["action_dim"].unique().tolist())
    panels = dict(list(corrections.groupby(["oracle", "error", "algo"], sort=False)))
    rates = {}
    for group in (row.group for row in summary.leading if row.best):
        rows = panels.get((group.oracle, group.error, group.algo))
        if rows is not None:
            some = slice(MOST_RATED)
            few = replace(
                group,
                seeds=group.seeds[some],
                returns=group.returns[some],
                corrections=group.corrections[some],
            )
            rates |= {(group, dimension): common_rates(few, rows, dimension) for dimension in dimensions}
    return rates


def _titles(study: Study) -> list[str]:
    several = len({oracle for oracle, _ in study.panels}) > 1
    return [
        (f"oracle {oracle}, " if several else "") + f"{words.percent(error)} error"
        for oracle, error in study.panels
    ]


def _columns(study: Study) -> int | None:
    """A row for each oracle, if there are several."""
    return len(study.errors) if len({oracle for oracle, _ in study.panels}) > 1 else None


def _curve(axis: Axes, group: Group, look: style.Look, leading: bool) -> None:
    colour, episode = look.colour, np.arange(1, group.returns.shape[1] + 1)
    smooth = walking_mean(group.returns, WINDOW)
    if not leading:
        axis.plot(episode, smooth.mean(axis=0), color=colour, linewidth=0.5, alpha=0.35, zorder=2)
        return
    axis.plot(episode, group.returns.mean(axis=0), color=colour, linewidth=0.8, alpha=0.35, zorder=3)
    line(axis, episode, mean_band(smooth), look)


def line(axis: Axes, x: np.ndarray, band: Band, look: style.Look) -> None:
    """A curve over its interval."""
    options = {"marker": "o" if len(x) == 1 else None, "markersize": 3} | look.line(len(x))
    axis.fill_between(x, band.lower, band.upper, color=look.colour, alpha=0.2, linewidth=0, zorder=3)
    axis.plot(x, band.mean, zorder=4, **options)


def _strip(axis: Axes, groups: Sequence[Group], study: Study) -> None:
    """Right of the last episode, on the panel's scale: a dot for the final return of each run, by algorithm.

    Outcomes are often of two kinds, which no mean tells. Dots that would cover each other lie side by side.
    """
    (first, last), (low, high) = (1, max(study.episodes, 2)), axis.get_ylim()
    column = STRIP * (last - first)
    begin = last + 0.6 * column
    axis.set_xlim(first, begin + column * len(study.algorithms))
    axis.spines["bottom"].set_bounds(first, last)
    looks = style.looks(study.algorithms)
    for group in groups:
        look, values = looks[group.algo], group.final.values
        middle = begin + column * (study.algorithms.index(group.algo) + 0.5)
        x = middle + column * _side_by_side((values - low) / (high - low))
        for chosen, marker in ((~group.broke_down, look.marker or "."), (group.broke_down, "x")):
            axis.plot(
                x[chosen],
                values[chosen],
                linestyle="none",
                marker=marker,
                markersize=4.0 if marker == "." else 3.0,
                markeredgewidth=0.6 if marker == "x" else 0.0,
                color=look.colour,
                alpha=0.6,
            )
        bar = [middle - 0.45 * column, middle + 0.45 * column]
        axis.plot(bar, [values.mean()] * 2, color=style.INK, linewidth=1.0, solid_capstyle="butt")
    if axis.xaxis.get_tick_params()["labelbottom"]:
        middle = begin + column * len(study.algorithms) / 2
        axis.text(
            middle, -0.03, "final", transform=axis.get_xaxis_transform(), fontsize=7.0, ha="center", va="top"
        )


def _side_by_side(heights: Float[np.ndarray, "runs"]) -> Float[np.ndarray, "runs"]:
    """Shifts, in [-0.4, 0.4], of dots at these parts of the height of their axis: dots of one fortieth share a row."""
    shift = np.zeros(len(heights))
    rows = np.floor(40 * heights)
    for row in np.unique(rows):
        members = np.flatnonzero(rows == row)
        width = min(0.8, 0.14 * (len(members) - 1))
        shift[members] = np.linspace(-width / 2, width / 2, len(members)) if len(members) > 1 else 0.0
    return shift


def _baselines(axis: Axes, oracle: Baseline, idle: Baseline) -> list[float]:
    """Draws them, and says how far they reach."""
    reach = []
    if oracle.n:
        reach = [oracle.mean - oracle.std, oracle.mean + oracle.std]
        axis.axhspan(*reach, **ORACLE_BAND)
        axis.axhline(oracle.mean, **ORACLE_LINE)
    if idle.n:
        axis.axhline(idle.mean, **IDLE_LINE)
    return reach


def _algorithms(study: Study) -> list[Artist]:
    return [
        Line2D([], [], label=words.drawn_algorithm(algo), **look.line())
        for algo, look in style.looks(study.algorithms).items()
    ]


def _baseline_handles(study: Study) -> list[Artist]:
    oracles = [study.oracle(oracle) for oracle, _ in study.panels]
    handles: list[Artist] = []
    if any(oracle.n for oracle in oracles):
        handles.append(Line2D([], [], label="oracle", **ORACLE_LINE))
    if any(oracle.std > 0 for oracle in oracles):
        handles.append(Patch(label="oracle ± 1 s.d.", **ORACLE_BAND))
    if study.idle.n:
        handles.append(Line2D([], [], label="idle (a = 0)", **IDLE_LINE))
    return handles


def first_rates(
    group: Group, corrections: pd.DataFrame, dimension: int | None = None
) -> Float[np.ndarray, "runs corrections"]:
    """The first learning rates of the group's runs (as `group.seeds`) in their order, nan after a run's last one.

    Those of one action dimension, or of all in one row: by step, then dimension. A rate that is not finite is nan.
    """
    chosen = _belongs(group, corrections)
    # What was refused, for want of room or of a number, is in the store with a rate of 0, and was no correction.
    chosen &= corrections["rate"].to_numpy(np.float64) != 0.0
    if dimension is not None:
        chosen &= corrections["action_dim"].to_numpy() == dimension
    seed, episode, step, action, rate = (
        corrections[name].to_numpy(np.float64)[chosen]
        for name in ("seed", "episode", "step", "action_dim", "rate")
    )
    order = np.lexsort((action, step, episode, seed))
    seeds, start, run = np.unique(seed[order], return_index=True, return_inverse=True)
    index = np.arange(len(order)) - start[run]
    early = index < FIRST_CORRECTIONS
    rates = np.full((group.runs, FIRST_CORRECTIONS), np.nan)
    rates[np.searchsorted(group.seeds, seeds)[run[early]], index[early]] = rate[order][early]
    return np.where(np.isfinite(rates), rates, np.nan)


def common_rates(
    group: Group, corrections: pd.DataFrame, dimension: int | None = None
) -> Float[np.ndarray, "runs corrections"]:
    """The same, as far as half of the runs have so many."""
    rates = first_rates(group, corrections, dimension)
    enough = 2 * (~np.isnan(rates)).sum(axis=0) >= group.runs
    return rates[:, : len(enough) if enough.all() else enough.argmin()]


def _belongs(group: Group, corrections: pd.DataFrame) -> Bool[np.ndarray, "rows"]:
    chosen = np.isin(corrections["seed"].to_numpy(np.int64), group.seeds)
    for name in ("algo", "oracle", "error"):
        chosen &= np.asarray(corrections[name] == getattr(group, name))
    for name, value in group.point.values:
        column = "advice_rate" if name == "rate" else name  # a correction's `rate` is the learning rate
        if column in corrections:
            chosen &= np.asarray(corrections[column] == value)
    return chosen
