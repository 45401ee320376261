"""The figures of a reproduction that are drawn from stored runs. Loads no jax."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gpcjax.report import style, words
from gpcjax.report.curves import WINDOW, common_rates, learning_curves, line
from gpcjax.report.groups import unique
from gpcjax.report.statistics import mean_band, paired_difference, walking_mean
from gpcjax.reproduce.parts import ROWS
from gpcjax.reproduce.results import Experiment

ROW_COLOURS = dict(zip(ROWS, ("#0072B2", "#E69F00", "#009E73", "#555555"), strict=True))
"""Of Okabe and Ito's, apart from those of the algorithms where it matters: the rows are all GPC."""

ERROR_COLOURS = ("#0072B2", "#E69F00", "#D55E00")


def returns(experiment: Experiment) -> Figure:
    """Figs. 5.1, 5.4 and 5.5: return against episode at each error rate, with the oracle's band."""
    return learning_curves(experiment.summary).figure


def rates(experiment: Experiment) -> Figure:
    """Fig. 5.2, and normalised as in the paper's Fig. 6: the learning rate of the first corrections.

    Below, each curve is divided by its largest value.
    """
    study = experiment.study
    titles = [f"{words.percent(error)} error" for error in study.errors]
    titles += [f"{title}, normalised" for title in titles]
    with style.publication():
        figure, axes = style.panels(titles, columns=len(study.errors), share=False)
        for error, above, below in zip(
            study.errors, axes[: len(study.errors)], axes[len(study.errors) :], strict=True
        ):
            for algo in study.algorithms:
                curves = common_rates(experiment.group(algo, error), experiment.corrections)
                if not curves.size:
                    continue
                x, colour = np.arange(1, curves.shape[1] + 1), style.colour(algo)
                _walked(above, x, curves, colour)
                mean = walking_mean(np.nanmean(curves, axis=0)[None], WINDOW)[0]
                below.plot(x, mean / mean.max(), color=colour)
        for axis in axes:
            style.count_ticks(axis, 150)
            axis.set_ylim(bottom=0)
        _same_top(axes[: len(study.errors)])
        _label(
            axes, len(study.errors), "correction", ("learning rate (action)", "learning rate / its largest")
        )
        style.legend(
            figure,
            [Line2D([], [], color=style.colour(a), label=words.algorithm(a)) for a in study.algorithms],
        )
    return figure


def ablation(rows: Mapping[str, Experiment]) -> Figure:
    """Fig. 5.7: return and feedback rate of each episode, for the rows of Table 5.4."""
    with style.publication():
        figure, axes = style.panels(("return", "feedback received", "chance offered"), share=False)
        episodes = 1
        for name, experiment in rows.items():
            group, colour = experiment.only, ROW_COLOURS[name]
            x = np.arange(1, group.returns.shape[1] + 1)
            episodes = len(x)
            feedback = group.corrections / experiment.rows(group, "length")
            for axis, values in zip(axes, (group.returns, feedback), strict=False):
                _walked(axis, x, values, colour)
            line(axes[2], x, mean_band(experiment.rows(group, "chance")), colour)
        for axis in axes:
            style.count_ticks(axis, episodes)
            axis.set_xlabel("episode")
        axes[0].set_ylabel("return (steps upright)")
        axes[1].set_ylabel("corrections a step")
        axes[2].set_ylabel("chance of advice at a step")
        for axis in axes[1:]:
            axis.set_ylim(bottom=0)
        style.legend(figure, _row_handles(rows))
    return figure


def ablation_rates(rows: Mapping[str, Experiment]) -> Figure:
    """Fig. 5.8: the learning rate of each correction, for the rows of Table 5.4."""
    with style.publication():
        figure, (axis,) = style.panels(("",))
        longest = 1
        for name, experiment in rows.items():
            curves = common_rates(experiment.only, experiment.corrections)
            if not curves.size:
                continue
            if name in ("i", "iii"):
                _walked(axis, np.arange(1, curves.shape[1] + 1), curves, ROW_COLOURS[name])
            longest = max(longest, curves.shape[1])
        static = np.nanmax(rows["iv"].rates(rows["iv"].only))
        axis.axhline(static, color=ROW_COLOURS["iv"], linestyle="--", linewidth=1.2)
        style.count_ticks(axis, longest)
        axis.set_ylim(bottom=0)
        axis.set_xlabel("correction")
        axis.set_ylabel("learning rate (action)")
        handles = [
            handle for name, handle in zip(rows, _row_handles(rows), strict=True) if name in ("i", "iii")
        ]
        static = Line2D(
            [], [], color=ROW_COLOURS["iv"], linestyle="--", linewidth=1.2, label="ii and iv: static"
        )
        style.legend(figure, [*handles, static])
    return figure


def dependence(experiment: Experiment) -> Figure:
    """Which of the cart-pole's conclusions depend on the oracle and on delta: differences in area with intervals."""
    study = experiment.study
    deltas = unique(group.point.get("delta") for group in study.groups)
    pairs = (("gpc", "coach"), ("gpc-ns", "coach"), ("gpc", "gpc-ns"))
    oracles = tuple(study.oracles)
    titles = [
        f"{words.algorithm(first)} − {words.algorithm(second)}, {oracle}"  # noqa: RUF001
        for first, second in pairs
        for oracle in oracles
    ]
    with style.publication():
        figure, axes = style.panels(titles, columns=len(oracles))
        for axis, (pair, oracle) in zip(
            axes, ((pair, oracle) for pair in pairs for oracle in oracles), strict=True
        ):
            axis.axhline(0.0, color=style.INK, linewidth=0.6)
            for place, error in enumerate(study.errors):
                shift = 0.16 * (place - (len(study.errors) - 1) / 2)
                for x, delta in enumerate(deltas):
                    first, second = (experiment.group(algo, error, oracle, delta).area for algo in pair)
                    value, _ = paired_difference(first, second)
                    bars = np.array([[value.estimate - value.lower], [value.upper - value.estimate]])
                    axis.errorbar(
                        x + shift,
                        value.estimate,
                        yerr=bars,
                        fmt="o",
                        markersize=3,
                        linewidth=1.1,
                        color=ERROR_COLOURS[place],
                    )
            axis.set_xticks(
                range(len(deltas)), ["0.05" if delta is None else f"{delta:g}" for delta in deltas]
            )
            axis.set_xlim(-0.5, len(deltas) - 0.5)
        style.label(axes, "delta (action)", "difference in area")
        style.legend(
            figure,
            [
                Line2D([], [], color=colour, marker="o", markersize=3, label=f"{words.percent(error)} error")
                for error, colour in zip(study.errors, ERROR_COLOURS, strict=False)
            ],
        )
    return figure


def _walked(axis: Axes, x: np.ndarray, values: Float[np.ndarray, "runs points"], colour: str) -> None:
    """The mean over runs, faint, and its walking mean with a 95 % interval; nan is where a run has no value."""
    axis.plot(x, np.nanmean(values, axis=0), color=colour, linewidth=0.8, alpha=0.35)
    window = np.stack([np.roll(values, shift, axis=1) for shift in range(-(WINDOW // 2), WINDOW // 2 + 1)])
    for shift, shifted in zip(range(-(WINDOW // 2), WINDOW // 2 + 1), window, strict=True):
        if shift:
            shifted[:, slice(0, shift) if shift > 0 else slice(shift, None)] = np.nan
    with np.errstate(invalid="ignore"):
        known = ~np.isnan(window)
        walked = np.where(known, window, 0.0).sum(0) / np.maximum(known.sum(0), 1)
    line(axis, x, mean_band(np.where(np.isnan(values), np.nan, walked)), colour)


def _row_handles(rows: Mapping[str, Any]) -> list[Line2D]:
    return [Line2D([], [], color=ROW_COLOURS[name], label=ROWS[name]) for name in rows]


def _same_top(axes: Sequence[Axes]) -> None:
    top = max(axis.get_ylim()[1] for axis in axes)
    for axis in axes:
        axis.set_ylim(0, top)


def _label(axes: Sequence[Axes], columns: int, x: str, rows: Sequence[str]) -> None:
    """`x` under the lowest row, a label of its own beside each row; numbers at the outer edge only."""
    for position, axis in enumerate(axes):
        row, column = divmod(position, columns)
        axis.tick_params(labelbottom=row == len(rows) - 1, labelleft=column == 0)
        if row == len(rows) - 1:
            axis.set_xlabel(x)
        if column == 0:
            axis.set_ylabel(rows[row])
