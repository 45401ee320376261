"""Draws maps over the pendulum's state space from their records: policy, learning rate, uncertainties. Loads no jax."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from gpcjax.report.figures import style
from gpcjax.report.figures.style import Drawing
from gpcjax.reproduce.records import Plane

DIVERGING, SEQUENTIAL = "RdBu_r", "cividis"
"""Of a policy, white at 0; of uncertainties and rates, even in lightness."""

ADVICE: dict[str, Any] = {
    "linestyle": "none",
    "marker": "o",
    "markersize": 2.0,
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "markeredgewidth": 0.4,
}
"""A place where advice was given, on colours light and dark."""


def early_plane(record: Plane) -> Drawing:
    """Fig. 3.3: policy and learning rate of a young learner."""
    maps = [
        ("policy", record.policy, style.ACTION),
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
        ("policy", record.policy, style.ACTION),
        ("uncertainty of the policy", record.sigma_policy, r"$\sigma_p(s)$"),
        ("of the human model", record.sigma_human, r"$\sigma_h(s, P(s))$"),
    ]
    return Drawing(
        _plane(record, maps),
        "Fig. 5.3: state space",
        "Fig. 5.3: policy, its uncertainty and that of the human model over the pendulum's state space, after "
        f"{len(record.returns)} episodes without errors.",
    )


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
