"""The figures of a reproduction that are drawn from stored runs, with their captions. Loads no jax."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from gpcjax.report import words
from gpcjax.report.figures import style
from gpcjax.report.figures.curves import FIRST_CORRECTIONS, WINDOW, common_rates, learning_curves, line
from gpcjax.report.figures.style import Drawing
from gpcjax.report.groups import unique
from gpcjax.report.statistics import mean_band, paired_difference, walking_mean
from gpcjax.reproduce.parts import CIRCLE, ROWS, Ablation, taught_by_gpc
from gpcjax.reproduce.results import Experiment

ROW_COLOURS = dict(zip(ROWS, ("#0072B2", "#E69F00", "#009E73", "#555555"), strict=True))
"""Of Okabe and Ito's, apart from those of the algorithms where it matters: the rows are all GPC."""

ROW_DASHES: dict[str, Any] = {"i": "-", "ii": "-", "iii": (0, (3, 1.5)), "iv": (0, (3, 1.5))}
"""iii is offered advice as often as i, and iv as ii: where they lie upon each other, both can be seen."""

ERROR_COLOURS = ("#0072B2", "#E69F00", "#D55E00")

WALKED = f"walking mean of {WINDOW} of the mean over runs, with its 95 % interval"


def returns(experiment: Experiment, number: str) -> Drawing:
    """Figs. 5.1, 5.4 and 5.5: return against episode at each error rate, with the oracle's band."""
    drawing = learning_curves(experiment.summary)
    return Drawing(
        drawing.figure,
        f"Fig. {number}: learning curves",
        f"Fig. {number}: {drawing.caption} Oracle: {oracles_of(experiment)}.",
    )


def runs_of(experiment: Experiment) -> str:
    """How many runs of which learner: "100 runs of GPC and COACH, 20 of GPC-NS"."""
    by_algorithm = {
        algo: sorted({group.runs for group in experiment.study.groups if group.algo == algo})
        for algo in experiment.study.algorithms
    }
    numbers = sorted({tuple(runs) for runs in by_algorithm.values()}, reverse=True)
    parts = []
    for runs in numbers:
        names = [words.algorithm(algo) for algo, own in by_algorithm.items() if tuple(own) == runs]
        told = str(runs[0]) if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
        who = " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
        parts.append(f"{told}{'' if parts else ' runs'} of {who if len(numbers) > 1 else 'each'}")
    return ", ".join(parts)


def oracles_of(experiment: Experiment) -> str:
    """Who taught, and whether that was taught by GPC: "gpc (taught by GPC itself: a circle), lqr"."""
    return ", ".join(
        f"{name} (taught by GPC itself: {CIRCLE})" if taught_by_gpc(name) else name
        for name in experiment.study.oracles
    )


def rates(experiment: Experiment) -> Drawing:
    """Fig. 5.2, and normalised as in the paper's Fig. 6: the learning rate of the first corrections.

    Below, each curve is divided by its largest value.
    """
    study = experiment.study
    titles = [f"{words.percent(error)} error" for error in study.errors]
    titles += [f"{title}, normalised" for title in titles]
    looks = style.looks(study.algorithms)
    with style.publication():
        figure, axes = style.panels(titles, columns=len(study.errors), share=False)
        for error, above, below in zip(
            study.errors, axes[: len(study.errors)], axes[len(study.errors) :], strict=True
        ):
            for algo in study.algorithms:
                curves = common_rates(experiment.group(algo, error), experiment.corrections)
                if not curves.size:
                    continue
                x, colour = np.arange(1, curves.shape[1] + 1), looks[algo].colour
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
            [Line2D([], [], color=looks[a].colour, label=words.algorithm(a)) for a in study.algorithms],
        )
    return Drawing(
        figure,
        "Fig. 5.2: learning rates",
        f"Fig. 5.2: learning rate of the first {FIRST_CORRECTIONS} corrections ({runs_of(experiment)}): {WALKED}, in "
        "corrections, over the mean itself; below, normalised as in the paper's Fig. 6, each by its largest value. A "
        "line ends where fewer than half of the runs have so many corrections. "
        f"Oracle: {oracles_of(experiment)}.",
    )


def ablation(rows: Mapping[str, Experiment], variant: Ablation) -> Drawing:
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
                _walked(axis, x, values, colour, ROW_DASHES[name])
            line(axes[2], x, mean_band(experiment.rows(group, "chance")), style.Look(colour))
            axes[2].lines[-1].set_linestyle(ROW_DASHES[name])
        for axis in axes:
            style.count_ticks(axis, episodes)
            axis.set_xlabel("episode")
        axes[0].set_ylabel("return (steps upright)")
        axes[1].set_ylabel("corrections a step")
        axes[2].set_ylabel("chance of advice at a step")
        for axis in axes[1:]:
            axis.set_ylim(bottom=0)
        style.legend(figure, _row_handles(rows))
    return Drawing(
        figure,
        f"Fig. 5.7: active learning and the adaptive rate, {variant.name}",
        f"Fig. 5.7: {_table(rows, variant)}. AL: active learning; ALR: adaptive learning rate. Return and feedback of "
        f"each episode, each {WALKED}, over the mean itself; and the chance of advice that the teacher offered, mean "
        "over runs with its interval. iii is offered the mean chance of i, and iv that of ii: their dashed lines lie "
        "upon those.",
    )


def ablation_rates(rows: Mapping[str, Experiment], variant: Ablation) -> Drawing:
    """Fig. 5.8: the learning rate of each correction, for the rows of Table 5.4."""
    with style.publication():
        figure, (axis,) = style.panels(("",))
        longest = 1
        for name, experiment in rows.items():
            curves = common_rates(experiment.only, experiment.corrections)
            if not curves.size:
                continue
            if name in ("i", "iii"):
                x = np.arange(1, curves.shape[1] + 1)
                _walked(axis, x, curves, ROW_COLOURS[name], ROW_DASHES[name])
            longest = max(longest, curves.shape[1])
        static = {"color": ROW_COLOURS["iv"], "linestyle": ":", "linewidth": 1.4}
        axis.axhline(variant.static_rate, **static)
        style.count_ticks(axis, longest)
        axis.set_ylim(bottom=0)
        axis.set_xlabel("correction")
        axis.set_ylabel("learning rate (action)")
        handles = [
            handle for name, handle in zip(rows, _row_handles(rows), strict=True) if name in ("i", "iii")
        ]
        style.legend(figure, [*handles, Line2D([], [], label="ii and iv: static", **static)])
    return Drawing(
        figure,
        f"Fig. 5.8: learning rates, {variant.name}",
        f"Fig. 5.8: learning rate of each correction, {_table(rows, variant)}. AL: active learning; ALR: adaptive "
        f"learning rate. Each {WALKED}, over the mean itself; a line ends where fewer than half of the runs have so "
        "many corrections. ii and iv take one rate at all corrections, the dotted line.",
    )


def _table(rows: Mapping[str, Experiment], variant: Ablation) -> str:
    runs = sorted({experiment.only.runs for experiment in rows.values()})
    told = str(runs[0]) if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    return (
        f"the rows of Table 5.4 with {variant.setting}, {variant.origin}; cart-pole, 10 % error, {told} runs of each; "
        f"oracle {oracles_of(rows['i'])}"
    )


def dependence(experiment: Experiment, task: str) -> Drawing:
    """Which conclusions depend on the oracle and on delta: differences in area, a row for each oracle."""
    study = experiment.study
    deltas = unique(group.point.get("delta") for group in study.groups)
    pairs = (("gpc", "coach"), ("gpc-ns", "coach"), ("gpc", "gpc-ns"))
    shown = [(oracle, pair) for oracle in study.oracles for pair in pairs]
    titles = [
        f"{words.algorithm(first)} − {words.algorithm(second)}, {oracle}{'*' if taught_by_gpc(oracle) else ''}"  # noqa: RUF001
        for oracle, (first, second) in shown
    ]
    with style.publication():
        figure, axes = style.panels(titles, columns=len(pairs))
        figure.set_figheight(0.6 + 1.5 * len(study.oracles))
        for axis, (oracle, pair) in zip(axes, shown, strict=True):
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
    runs = sorted({group.runs for group in study.groups})
    told = str(runs[0]) if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    return Drawing(
        figure,
        f"Dependence on oracle and delta: {task}",
        f"{task[0].upper()}{task[1:]}: differences in area on the same seeds, mean over runs with its 95 % interval "
        f"({told} runs of each), for each oracle and each distance delta within which it is silent. An asterisk marks "
        f"oracles that GPC itself taught, {CIRCLE}; the others owe nothing to GPC.",
    )


def _walked(
    axis: Axes, x: np.ndarray, values: Float[np.ndarray, "runs points"], colour: str, dashes: Any = "-"
) -> None:
    """The mean over runs, faint, and its walking mean with a 95 % interval; nan is where a run has no value."""
    axis.plot(x, np.nanmean(values, axis=0), color=colour, linewidth=0.8, alpha=0.35)
    window = np.stack([np.roll(values, shift, axis=1) for shift in range(-(WINDOW // 2), WINDOW // 2 + 1)])
    for shift, shifted in zip(range(-(WINDOW // 2), WINDOW // 2 + 1), window, strict=True):
        if shift:
            shifted[:, slice(0, shift) if shift > 0 else slice(shift, None)] = np.nan
    with np.errstate(invalid="ignore"):
        known = ~np.isnan(window)
        walked = np.where(known, window, 0.0).sum(0) / np.maximum(known.sum(0), 1)
    line(axis, x, mean_band(np.where(np.isnan(values), np.nan, walked)), style.Look(colour))
    axis.lines[-1].set_linestyle(dashes)


def _row_handles(rows: Mapping[str, Any]) -> list[Line2D]:
    return [
        Line2D([], [], color=ROW_COLOURS[name], linestyle=ROW_DASHES[name], label=ROWS[name]) for name in rows
    ]


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
