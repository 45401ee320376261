"""Draws the illustrative figures of one state dimension from their records, with their captions. Loads no jax."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from gpcjax.report.figures import style
from gpcjax.report.figures.style import Drawing
from gpcjax.reproduce.records import Hyperparameters, Situations, Sparsification

BLUE, VERMILION, GREEN = style.ALGORITHM_COLOURS.values()

BAND = 1.96
"""Standard deviations on either side that hold 95 % of a normal distribution."""


def hyperparameters(record: Hyperparameters) -> Drawing:
    """Fig. 2.2: mean and 95 % band with poor and with fitted hyperparameters."""
    titles = [
        f"{name}: $l$ = {length:.2f}, $\\log\\,p(y|X)$ = {_minus(value)}"
        for name, length, value in zip(
            ("guessed", "fitted"), record.length_scale, record.log_likelihood, strict=True
        )
    ]
    with style.publication():
        figure, axes = style.panels(titles)
        figure.set_figwidth(6.2)
        for axis, mean, deviation in zip(axes, record.mean, record.deviation, strict=True):
            axis.fill_between(
                record.x,
                mean - BAND * deviation,
                mean + BAND * deviation,
                color=BLUE,
                alpha=0.2,
                linewidth=0,
            )
            axis.plot(record.x, record.truth, color=style.IDLE_COLOUR, linestyle="--", linewidth=1.0)
            axis.plot(record.x, mean, color=BLUE)
            axis.plot(record.points, record.targets, "o", color=style.INK, markersize=3.0)
            axis.set_xlim(record.x[0], record.x[-1])
        style.label(axes, "input $x$", "output $y$")
        style.legend(
            figure,
            [
                Line2D([], [], color=style.INK, marker="o", markersize=3, linestyle="none", label="data"),
                Line2D([], [], color=style.IDLE_COLOUR, linestyle="--", linewidth=1.0, label="true function"),
                Line2D([], [], color=BLUE, label="mean"),
                Patch(color=BLUE, alpha=0.2, linewidth=0, label="95 % band"),
            ],
        )
    return Drawing(
        figure,
        "Fig. 2.2: hyperparameters",
        "Fig. 2.2: the same points with guessed hyperparameters and with those of largest marginal likelihood.",
    )


def situations(record: Situations) -> Drawing:
    """Fig. 3.2: above the policy with its uncertainty over the state, below that of the human model over the action."""
    words = {1.0: '"more"', 0.0: "no advice", -1.0: '"less"'}
    titles = [f"$t_{i + 1}$: {words[float(advice)]}" for i, advice in enumerate(record.advice)]
    with style.publication():
        figure, axes = style.panels([*titles, *[f"$t_{i + 1}$" for i in range(4)]], columns=4, share=False)
        figure.set_size_inches(7.2, 3.9)
        above, below = axes[:4], axes[4:]
        for i, axis in enumerate(above):
            spread = BAND * record.sigma_policy[i]
            axis.fill_between(
                record.x,
                record.policy[i] - spread,
                record.policy[i] + spread,
                color=BLUE,
                alpha=0.2,
                linewidth=0,
            )
            axis.plot(record.x, record.policy[i], color=BLUE)
            axis.plot(0.0, record.action[i], "o", color=style.INK, markersize=3.5)
            if record.rate[i] > 0:
                _arrow(axis, 0.0, record.action[i], record.action[i] + record.rate[i] * record.advice[i])
            axis.set_xlim(record.x[0], record.x[-1])
        for i, axis in enumerate(below):
            axis.plot(record.actions, record.sigma_human[i], color=GREEN)
            axis.axvline(record.action[i], color=style.INK, linewidth=0.6, linestyle=":")
            axis.plot(record.action[i], record.sigma_human_there[i], "o", color=style.INK, markersize=3.5)
            axis.set_xlim(record.actions[0], record.actions[-1])
            axis.set_ylim(0.0, 1.1 * record.sigma_human.max())
        style.same_height(above)
        _row(above, "state $x$", style.ACTION)
        _row(below, "action $a$ at $x = 0$", r"$\sigma_h(0, a)$")
        style.legend(
            figure,
            [
                Line2D([], [], color=BLUE, label="policy"),
                Patch(color=BLUE, alpha=0.2, linewidth=0, label=r"$\pm 1.96\,\sigma_p$"),
                Line2D([], [], color=GREEN, label=r"$\sigma_h$"),
                Line2D(
                    [], [], color=style.INK, marker="o", markersize=3.5, linestyle="none", label="executed"
                ),
                Line2D([], [], color=VERMILION, marker="^", markersize=4, label="learning rate"),
            ],
        )
    return Drawing(
        figure,
        "Fig. 3.2: three corrections",
        "Fig. 3.2: a policy over one state dimension and the uncertainty of its human model, through two corrections "
        "at x = 0 and steps without any.",
    )


def sparsification(record: Sparsification) -> Drawing:
    """Fig. 3.4: the action after each advice, and the target that each one set."""
    with style.publication():
        figure, axes = style.panels(["appending", "SPARS"])
        figure.set_figwidth(6.2)
        places = np.arange(record.action.shape[1] + 1.0)
        for i, axis in enumerate(axes):
            actions = np.append(record.action[i], record.after[i, -1])
            axis.plot(places, actions, color=style.IDLE_COLOUR, linewidth=0.8)
            for place, action, target in zip(places, actions, record.target[i], strict=False):
                _arrow(axis, place, action, target)
            axis.plot(places, actions, "o", color=style.INK, markersize=3.0)
            axis.plot(places[:-1], record.target[i], "_", color=VERMILION, markersize=6)
            axis.set_xlim(-0.5, places[-1] + 0.5)
            axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        style.label(axes, 'advice "more" received', style.ACTION)
        style.legend(
            figure,
            [
                Line2D(
                    [],
                    [],
                    color=style.IDLE_COLOUR,
                    linewidth=0.8,
                    marker="o",
                    markersize=3,
                    markerfacecolor=style.INK,
                    markeredgecolor=style.INK,
                    label="action",
                ),
                Line2D(
                    [],
                    [],
                    color=VERMILION,
                    marker="^",
                    markersize=4,
                    label="learning rate, to the target $a_n$",
                ),
            ],
        )
    return Drawing(
        figure,
        "Fig. 3.4: sparsification",
        "Fig. 3.4: the action at one state under repeated advice, with plain appending, which averages all targets, "
        "and with SPARS, which follows them.",
    )


def _arrow(axis: Axes, x: float, start: float, end: float) -> None:
    axis.annotate(
        "",
        (x, end),
        (x, start),
        arrowprops={
            "arrowstyle": "-|>,head_length=0.25,head_width=0.12",
            "color": VERMILION,
            "linewidth": 1.0,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )


def _minus(value: float) -> str:
    return f"{value:.1f}".replace("-", "\N{MINUS SIGN}")


def _row(axes: Sequence[Axes], x: str, y: str) -> None:
    """One label of y for panels side by side that share their height."""
    for i, axis in enumerate(axes):
        axis.set_xlabel(x)
        axis.set_ylabel(y if i == 0 else "")
        axis.tick_params(labelleft=i == 0)
