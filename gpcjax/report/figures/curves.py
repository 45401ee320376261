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

from gpcjax.report import words
from gpcjax.report.figures import strips, style
from gpcjax.report.figures.style import Drawing
from gpcjax.report.groups import FINAL_EPISODES, Baseline, Group, Study, unique
from gpcjax.report.statistics import Band, mean_band, median_band, walking_mean
from gpcjax.report.summary import Summary
from gpcjax.sweep.chosen import Chosen

FIRST_CORRECTIONS = 150
MOST_RATED = 10_000
"""Runs of a line of learning rates: of more those with the lowest seeds."""

WINDOW = 3
"""Episodes of the walking mean."""

MOST_LINES = 500
"""Points of a grid whose curves are drawn one by one; of more the range of their middle 90%."""

MOST_PANELS = 48
"""Of a figure: more are left to summary.csv."""

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
    panels = study.panels[:MOST_PANELS]
    with style.publication():
        figure, axes = style.panels(_titles(study, panels), _columns(study))
        reach: list[float] = []
        leading: dict[Axes, list[Group]] = {axis: [] for axis in axes}
        for (oracle, error), axis in zip(panels, axes, strict=True):
            reach += _baselines(axis, study.oracle(oracle), study.idle)
            for algo in study.algorithms:
                groups = [group for group in study.select(oracle, error, algo) if group.runs]
                best = [group for group in groups if summary.of(group).best]
                _others(axis, [group for group in groups if not summary.of(group).best], looks[algo])
                for group in best:
                    _curve(axis, group, looks[algo])
                    reach += [group.final.values.min(), group.final.values.max()]
                leading[axis] += best
            style.count_ticks(axis, study.episodes)
            axis.yaxis.set_major_locator(MaxNLocator(nbins=6))
        cut = style.follow_lines(axes, reach)
        for axis, groups in leading.items():
            strips.draw(axis, groups, study)
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
    if any(row.group.runs > strips.MOST_DOTS for row in summary.leading):
        sentences.append(f"More than {strips.MOST_DOTS:,} runs are a histogram.")
    if study.varying:
        points = max(len(study.select(*panel, algo)) for panel in study.panels for algo in study.algorithms)
        others = "thin lines are the other points"
        if points > MOST_LINES + 1:
            others = f"of more than {MOST_LINES} other points the thin lines hold the middle 90%"
        sentences.append(f"Of a grid the point with the highest mean final return; {others}.")
    if any(group.stopped and group.broke_down.any() for group in study.groups):
        sentences.append(
            "Runs that stopped (crosses) have the idle policy's mean return from the episode on in which they stopped."
        )
    return " ".join([*sentences, *left_out(study.panels), *([CUT] if cut else [])])


def left_out(panels: Sequence[Any]) -> list[str]:
    """What a caption says of panels that are not drawn."""
    some = f"These are the first {MOST_PANELS} of {len(panels)} panels; all numbers are in summary.csv."
    return [some] if len(panels) > MOST_PANELS else []


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
    panels = [(*panel, d) for d in dimensions for panel in study.panels][:MOST_PANELS]
    titles = [
        title + (f", {words.action(study.env, d)}" if several else "")
        for title, (*_, d) in zip(_titles(study, [(o, e) for o, e, _ in panels]), panels, strict=True)
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
    sentences += left_out([(*panel, d) for d in dimensions for panel in study.panels])
    return Drawing(figure, "Learning rates", " ".join([*sentences, *([CUT] if cut else [])]))


def shown_rates(summary: Summary) -> list[Chosen]:
    """The runs whose learning rates are drawn: of the best point of each algorithm in each panel."""
    return [
        Chosen(group.algo, group.oracle, group.error, dict(group.point.values), group.seeds[:MOST_RATED])
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


def _titles(study: Study, panels: Sequence[tuple[str, float]]) -> list[str]:
    several = len({oracle for oracle, _ in study.panels}) > 1
    return [
        (f"oracle {oracle}, " if several else "") + f"{words.percent(error)} error"
        for oracle, error in panels
    ]


def _columns(study: Study) -> int | None:
    """A row for each oracle, if there are several."""
    return len(study.errors) if len({oracle for oracle, _ in study.panels}) > 1 else None


def _curve(axis: Axes, group: Group, look: style.Look) -> None:
    episode = np.arange(1, group.returns.shape[1] + 1)
    axis.plot(episode, group.returns.mean(axis=0), color=look.colour, linewidth=0.8, alpha=0.35, zorder=3)
    line(axis, episode, mean_band(walking_mean(group.returns, WINDOW)), look)


def _others(axis: Axes, groups: Sequence[Group], look: style.Look) -> None:
    """The points of a grid that are not the best: a thin line each, or the range of most of them."""
    smooth = [walking_mean(group.returns, WINDOW).mean(axis=0) for group in groups]
    thin: dict[str, Any] = {"color": look.colour, "linewidth": 0.5, "alpha": 0.35, "zorder": 2}
    if len(smooth) > MOST_LINES:
        smooth = list(np.quantile(smooth, (0.05, 0.95), axis=0))
        axis.fill_between(
            np.arange(1, len(smooth[0]) + 1), *smooth, color=look.colour, alpha=0.1, linewidth=0, zorder=2
        )
    for curve in smooth:
        axis.plot(np.arange(1, len(curve) + 1), curve, **thin)


def line(axis: Axes, x: np.ndarray, band: Band, look: style.Look) -> None:
    """A curve over its interval."""
    options = {"marker": "o" if len(x) == 1 else None, "markersize": 3} | look.line(len(x))
    axis.fill_between(x, band.lower, band.upper, color=look.colour, alpha=0.2, linewidth=0, zorder=3)
    axis.plot(x, band.mean, zorder=4, **options)


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
