"""Learning curves (as Figs. 5.1 and 5.4 of the thesis) and learning rates (as Fig. 5.2)."""

from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from gpcjax.report import style, words
from gpcjax.report.groups import Baseline, Group, Study
from gpcjax.report.statistics import Band, mean_band, median_band, walking_mean
from gpcjax.report.summary import Summary

FIRST_CORRECTIONS = 150
WINDOW = 3
"""Episodes of the walking mean."""

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


def learning_curves(summary: Summary) -> Figure:
    """Return against episode, a panel for each oracle and error rate.

    Of each algorithm: the mean over runs (faint), its walking mean and that one's 95% interval. Of a grid the best
    point, the other points as thin lines. Behind them the oracle (mean and one standard deviation) and the idle policy.
    """
    study = summary.study
    with style.publication():
        figure, axes = _figure(study)
        for (oracle, error), axis in zip(study.panels, axes, strict=True):
            _baselines(axis, study.oracle(oracle), study.idle)
            for group in study.select(oracle, error):
                if group.runs:
                    _curve(axis, group, leading=summary.of(group).best)
            style.count_ticks(axis, study.episodes)
            axis.yaxis.set_major_locator(MaxNLocator(nbins=6))
            axis.margins(y=0.04)
        style.label(axes, "episode", words.return_label(study))
        style.legend(figure, _algorithms(study) + _baseline_handles(study))
    return figure


def learning_rates(summary: Summary, corrections: pd.DataFrame) -> Figure | None:
    """Median learning rate of each of the first corrections, with 95% interval, a panel for each oracle and error.

    The median, as COACH's rate is unbounded: off its grid a single run may take steps a hundred times the usual.
    A line ends where fewer than half of the runs have so many corrections. Of a grid the best point. None if no
    run that can be compared has a correction.
    """
    study = summary.study
    if corrections.empty:
        return None
    rates = {
        group: common_rates(group, corrections)
        for group in study.groups
        if group.runs and summary.of(group).best
    }
    longest = max((rate.shape[1] for rate in rates.values()), default=0)
    if not longest:
        return None
    with style.publication():
        figure, axes = _figure(study)
        for (oracle, error), axis in zip(study.panels, axes, strict=True):
            for group in study.select(oracle, error):
                if group in rates and rates[group].size:
                    index = np.arange(1, rates[group].shape[1] + 1)
                    line(axis, index, median_band(rates[group]), style.colour(group.algo))
            style.count_ticks(axis, longest)
        axes[0].set_ylim(bottom=0)  # for all panels, once all lines are there
        style.label(axes, "correction", "learning rate, median of runs")
        style.legend(figure, _algorithms(study))
    return figure


def _figure(study: Study) -> tuple[Figure, list[Axes]]:
    several = len({oracle for oracle, _ in study.panels}) > 1
    titles = [
        (f"oracle {oracle}, " if several else "") + f"{words.percent(error)} error"
        for oracle, error in study.panels
    ]
    return style.panels(titles, columns=len(study.errors) if several else None)


def _curve(axis: Axes, group: Group, leading: bool) -> None:
    colour, episode = style.colour(group.algo), np.arange(1, group.returns.shape[1] + 1)
    smooth = walking_mean(group.returns, WINDOW)
    if not leading:
        axis.plot(episode, smooth.mean(axis=0), color=colour, linewidth=0.5, alpha=0.35, zorder=2)
        return
    axis.plot(episode, group.returns.mean(axis=0), color=colour, linewidth=0.8, alpha=0.35, zorder=3)
    line(axis, episode, mean_band(smooth), colour)


def line(axis: Axes, x: np.ndarray, band: Band, colour: str) -> None:
    """A curve over its interval."""
    marker = "o" if len(x) == 1 else None
    axis.fill_between(x, band.lower, band.upper, color=colour, alpha=0.2, linewidth=0, zorder=3)
    axis.plot(x, band.mean, color=colour, marker=marker, markersize=3, zorder=4)


def _baselines(axis: Axes, oracle: Baseline, idle: Baseline) -> None:
    if oracle.n:
        axis.axhspan(oracle.mean - oracle.std, oracle.mean + oracle.std, **ORACLE_BAND)
        axis.axhline(oracle.mean, **ORACLE_LINE)
    if idle.n:
        axis.axhline(idle.mean, **IDLE_LINE)


def _algorithms(study: Study) -> list[Artist]:
    return [
        Line2D([], [], color=style.colour(algo), label=words.algorithm(algo)) for algo in study.algorithms
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


def first_rates(group: Group, corrections: pd.DataFrame) -> Float[np.ndarray, "runs corrections"]:
    """The first learning rates of the group's runs (as `group.seeds`) in their order, nan after a run's last one."""
    chosen = _belongs(group, corrections)
    seed, episode, step, dimension, rate = (
        corrections[name].to_numpy(np.float64)[chosen]
        for name in ("seed", "episode", "step", "action_dim", "rate")
    )
    order = np.lexsort((dimension, step, episode, seed))
    seeds, start, run = np.unique(seed[order], return_index=True, return_inverse=True)
    index = np.arange(len(order)) - start[run]
    early = index < FIRST_CORRECTIONS
    rates = np.full((group.runs, FIRST_CORRECTIONS), np.nan)
    rates[np.searchsorted(group.seeds, seeds)[run[early]], index[early]] = rate[order][early]
    return rates


def common_rates(group: Group, corrections: pd.DataFrame) -> Float[np.ndarray, "runs corrections"]:
    """The same, as far as half of the runs have so many."""
    rates = first_rates(group, corrections)
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
