"""Draws the illustrative figures from their records, with their captions. Loads no jax."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from gpcjax.report.figures import style
from gpcjax.report.figures.style import Drawing
from gpcjax.report.words import algorithm
from gpcjax.reproduce.records import Erroneous, Hyperparameters, Plane, Situations, Sparsification

BLUE, VERMILION, GREEN = style.ALGORITHM_COLOURS.values()
DIVERGING, SEQUENTIAL = "RdBu_r", "cividis"
"""Of a policy, white at 0; of uncertainties and rates, even in lightness."""

BAND = 1.96
"""Standard deviations on either side that hold 95 % of a normal distribution."""

SCALE_DASHES: tuple[Any, ...] = ("-", (0, (4, 2)))
"""Of a short and a long length-scale: where they lie upon each other, both can be seen."""

ACTION = "action [-1, 1]"
NUMBER = "advice number"
ADVICE: dict[str, Any] = {
    "linestyle": "none",
    "marker": "o",
    "markersize": 2.0,
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "markeredgewidth": 0.4,
}
"""A place where advice was given, on colours light and dark."""


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
        _same_height(above)
        _row(above, "state $x$", ACTION)
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


def early_plane(record: Plane) -> Drawing:
    """Fig. 3.3: policy and learning rate of a young learner."""
    maps = [
        ("policy", record.policy, ACTION),
        ("learning rate", record.rate, r"$r = \sigma_p + \sigma_h + c_r$"),
    ]
    return Drawing(
        _plane(record, maps),
        "Fig. 3.3: policy and learning rate",
        f"Fig. 3.3: policy and learning rate over the pendulum's state space after {len(record.returns)} episodes of "
        "advice.",
    )


def late_plane(record: Plane) -> Drawing:
    """Fig. 5.3: policy and both uncertainties of a taught learner."""
    maps = [
        ("policy", record.policy, ACTION),
        ("uncertainty of the policy", record.sigma_policy, r"$\sigma_p(s)$"),
        ("of the human model", record.sigma_human, r"$\sigma_h(s, P(s))$"),
    ]
    return Drawing(
        _plane(record, maps),
        "Fig. 5.3: state space",
        "Fig. 5.3: policy, its uncertainty and that of the human model over the pendulum's state space, after "
        f"{len(record.returns)} episodes without errors.",
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
        style.label(axes, 'advice "more" received', ACTION)
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
        _same_height(axes[0::3])
        _same_height(axes[1::3])
        _same_height(axes[2::3])
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
        "action is back, over length-scales, for three numbers of the wrong advice. A small cross low in the panel "
        "says that with such a length-scale the action is at its target before that advice: there is none to go "
        "wrong.",
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
    for axis, y in ((actions, ACTION), (rates, r"$r$, $\sigma_h$")):
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
            record.scanned_samples[i, :, k],
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
    axis.text(known, 1.25, " Table 5.2", fontsize=6.5)
    axis.set_xscale("log")
    ticks = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_xticks([], minor=True)
    axis.set_xlabel("length-scale $l_h$")
    axis.set_ylabel("samples to compensate")
    axis.set_ylim(0.0, 7.6)
    axis.legend(fontsize=6.5, handlelength=1.6, loc="upper right" if i == 0 else "upper left")


def _plane(record: Plane, maps: Sequence[tuple[str, Float[np.ndarray, "y x"], str]]) -> Figure:
    """Maps over angle and angular velocity, the first one of the policy and with the places of all corrections."""
    with style.publication():
        figure, axes = style.panels([title for title, _, _ in maps])
        figure.set_size_inches(7.2 if len(maps) == 3 else 5.4, 2.9)
        # Colours stand for the middle of their cells, of which the outermost are cut in half.
        half = (record.theta[1] - record.theta[0]) / 2, (record.theta_dot[1] - record.theta_dot[0]) / 2
        left, right = record.theta[0] - half[0], record.theta[-1] + half[0]
        low, high = record.theta_dot[0] - half[1], record.theta_dot[-1] + half[1]
        for axis, (title, values, label) in zip(axes, maps, strict=True):
            policy = title == "policy"
            shown = axis.imshow(
                values,
                origin="lower",
                extent=(left, right, low, high),
                aspect="auto",
                cmap=DIVERGING if policy else SEQUENTIAL,
                norm=Normalize(-1.0, 1.0) if policy else Normalize(0.0, values.max()),
            )
            bar = figure.colorbar(
                shown,
                ax=axis,
                location="bottom",
                aspect=25,
                pad=0.03,
                shrink=0.9,
                label=label,
                ticks=[-1.0, -0.5, 0.0, 0.5, 1.0] if policy else MaxNLocator(4),
            )
            bar.outline.set_visible(False)
            if policy:
                axis.plot(*record.advised.T, **ADVICE)
            axis.set_xlim(record.theta[0], record.theta[-1])
            axis.set_ylim(record.theta_dot[0], record.theta_dot[-1])
            axis.set_xticks([-np.pi, 0.0, np.pi], [r"$-\pi$", "0", r"$\pi$"])
        style.label(axes, r"angle $\theta$ from upright [rad]", r"angular velocity $\dot\theta$ [rad/s]")
        places = Line2D([], [], label="advice", **ADVICE)
        axes[0].legend(handles=[places], loc="lower right", bbox_to_anchor=(1.04, 0.97), handletextpad=0.0)
    return figure


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


def _same_height(axes: Sequence[Axes]) -> None:
    low, high = zip(*(axis.get_ylim() for axis in axes), strict=True)
    for axis in axes:
        axis.set_ylim(min(low), max(high))
