"""The final returns of single runs, beside their learning curves."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from gpcjax.report.figures import style
from gpcjax.report.groups import Group, Study

STRIP = 0.08
"""Width of the column of an algorithm's final returns, in parts of that of the curves."""

MOST_DOTS = 1000
"""Runs of a column that have a dot each."""

ROWS = 40
"""Of dots side by side, or bars of a histogram, on the height of a panel."""


def draw(axis: Axes, groups: Sequence[Group], study: Study) -> None:
    """Right of the last episode, on the panel's scale: a dot for the final return of each run, by algorithm.

    Outcomes are often of two kinds, which no mean tells. Dots that would cover each other lie side by side; of more
    than `MOST_DOTS` runs there is a histogram.
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
        if group.runs > MOST_DOTS:
            _histogram(axis, values, middle, column, look.colour)
        else:
            _dots(axis, group, middle + column * _side_by_side((values - low) / (high - low)), look)
        bar = [middle - 0.45 * column, middle + 0.45 * column]
        axis.plot(bar, [values.mean()] * 2, color=style.INK, linewidth=1.0, solid_capstyle="butt")
    if axis.xaxis.get_tick_params()["labelbottom"]:
        middle = begin + column * len(study.algorithms) / 2
        axis.text(
            middle, -0.03, "final", transform=axis.get_xaxis_transform(), fontsize=7.0, ha="center", va="top"
        )


def _side_by_side(heights: Float[np.ndarray, "runs"]) -> Float[np.ndarray, "runs"]:
    """Shifts, in [-0.4, 0.4], of dots at these parts of the height of their axis: dots of one of `ROWS` share a row."""
    shift = np.zeros(len(heights))
    rows = np.floor(ROWS * heights)
    for row in np.unique(rows):
        members = np.flatnonzero(rows == row)
        width = min(0.8, 0.14 * (len(members) - 1))
        shift[members] = np.linspace(-width / 2, width / 2, len(members)) if len(members) > 1 else 0.0
    return shift


def _dots(axis: Axes, group: Group, x: Float[np.ndarray, "runs"], look: style.Look) -> None:
    """Crosses are runs that stopped."""
    values = group.final.values
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


def _histogram(
    axis: Axes, values: Float[np.ndarray, "runs"], middle: float, column: float, colour: str
) -> None:
    """Bars on both sides of the middle of their column, the longest as wide as that."""
    counts, edges = np.histogram(values, bins=ROWS, range=axis.get_ylim())
    widths = 0.8 * column * counts / counts.max(initial=1)
    heights = np.diff(edges)
    axis.barh(edges[:-1], widths, heights, middle - widths / 2, align="edge", color=colour, alpha=0.6)
