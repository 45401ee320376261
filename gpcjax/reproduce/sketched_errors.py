"""Draws what one erroneous advice does, and how many right ones mend it, from their record. Loads no jax."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from gpcjax.report.figures import style
from gpcjax.report.figures.style import Drawing
from gpcjax.report.words import algorithm
from gpcjax.reproduce.records import Erroneous

BLUE, VERMILION, GREEN = style.ALGORITHM_COLOURS.values()

SCALE_DASHES: tuple[Any, ...] = ("-", (0, (4, 2)))
"""Of a short and a long length-scale: where they lie upon each other, both can be seen."""

NUMBER = "advice number"

APART = 0.13
"""Between lines of whole numbers that would lie upon each other."""


def erroneous(record: Erroneous) -> Drawing:
    """Fig. 5.9: action, rate and compensation around one erroneous advice, a row for each algorithm."""
    with style.publication():
        titles = [
            f"{algorithm(str(algo))}: {what}"
            for algo in record.algorithms
            for what in ("action", "rate", "compensation")
        ]
        figure, axes = style.panels(titles, columns=3, share=False)
        for i in range(len(record.algorithms)):
            _runs(axes[3 * i], axes[3 * i + 1], record, i)
            _scan(axes[3 * i + 2], record, i)
        style.same_height(axes[0::3])
        style.same_height(axes[1::3])
        style.same_height(axes[2::3])
        style.legend(
            figure,
            [
                *(
                    Line2D([], [], color=colour, linestyle=dashes, label=f"$l_h$ = {scale:g}")
                    for colour, dashes, scale in zip(
                        (BLUE, VERMILION), SCALE_DASHES, record.length_scales, strict=True
                    )
                ),
                Line2D(
                    [], [], color=style.INK, marker="X", markersize=5, linestyle="none", label="wrong advice"
                ),
                Line2D([], [], color=style.INK, label="$r$"),
                Line2D([], [], color=style.INK, linestyle=":", label=r"$\sigma_h$"),
            ],
        )
    return Drawing(
        figure,
        "Fig. 5.9: erroneous advice",
        "Fig. 5.9: one wrong advice among right ones at one state, with a short and a long length-scale of the human "
        "model. The cross is the action that it left (its rate, beside). Right: how many right ones it takes until the "
        "action is back, over length-scales, for three numbers of the wrong advice: whole numbers, drawn a little "
        "apart. A small cross low in the panel says that with such a length-scale the action is at its target before "
        "that advice: there is none to go wrong.",
    )


def _runs(actions: Axes, rates: Axes, record: Erroneous, i: int) -> None:
    wrong = int(record.wrong)
    for j, (colour, dashes) in enumerate(zip((BLUE, VERMILION), SCALE_DASHES, strict=True)):
        number = np.arange(record.action.shape[-1])
        drawn: dict[str, Any] = {"color": colour, "linestyle": dashes, "marker": "o", "markersize": 2.5}
        actions.plot(number, record.action[i, j], linewidth=1.1, **drawn)
        actions.plot(
            wrong,
            record.action[i, j, wrong],
            "X",
            color=colour,
            markersize=6,
            markeredgecolor=style.INK,
            zorder=4,
        )
        rates.plot(number[1:], record.rate[i, j], linewidth=1.1, **drawn)
        rates.plot(number[1:], record.sigma_human[i, j], color=colour, linestyle=":", linewidth=1.2)
        rates.plot(
            wrong,
            record.rate[i, j, wrong - 1],
            "X",
            color=colour,
            markersize=6,
            markeredgecolor=style.INK,
            zorder=4,
        )
    rates.set_yscale("log")
    for axis, y in ((actions, style.ACTION), (rates, r"$r$, $\sigma_h$")):
        axis.set_xlim(-0.5, record.rate.shape[-1] + 0.5)
        axis.set_xlabel(NUMBER)
        axis.set_ylabel(y)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _scan(axis: Axes, record: Erroneous, i: int) -> None:
    for k, (wrong, marker, shade) in enumerate(
        zip(record.scanned_wrong, "osD", (style.INK, "#777777", "#AAAAAA"), strict=True)
    ):
        axis.plot(
            record.scanned_length_scales,
            record.scanned_samples[i, :, k] + APART * (1 - k),
            color=shade,
            marker=marker,
            markersize=3.0,
            linewidth=0.9,
            label=f"advice {wrong} wrong",
        )
        silent = record.scanned_length_scales[np.isnan(record.scanned_samples[i, :, k])]
        axis.plot(silent, np.full(len(silent), 0.25 + 0.35 * k), "x", color=shade, markersize=3.5)
    known = float(record.thesis_length_scales[i])
    axis.axvline(known, color=style.INK, linewidth=0.6, linestyle=":", zorder=0)
    axis.text(known, 0.2, " Table 5.2", fontsize=6.5)
    axis.set_xscale("log")
    ticks = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_xticks([], minor=True)
    axis.set_xlabel("length-scale $l_h$")
    axis.set_ylabel("samples to compensate")
    most = record.scanned_samples[np.isfinite(record.scanned_samples)].max(initial=1.0)
    axis.set_ylim(0.0, 1.27 * most)  # the legend is above
    axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    axis.legend(fontsize=6.5, handlelength=1.6, loc="upper right" if i == 0 else "upper left")
