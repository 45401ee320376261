"""Figures of a search: how far it came, what each setting does, and the front of two objectives."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from gpcjax.report import words
from gpcjax.report.figures import style
from gpcjax.report.figures.style import Drawing
from gpcjax.tune.found import Found, Looked
from gpcjax.tune.objectives import Objective
from gpcjax.tune.space import Range
from gpcjax.tune.trials import Told

POINT: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 3.0, "markeredgewidth": 0}
STAR: dict[str, Any] = {
    "linestyle": "none",
    "marker": "*",
    "markersize": 10,
    "markeredgecolor": "white",
    "markeredgewidth": 0.5,
    "zorder": 5,
}
OF_POINTS, OF_TIED, OF_BEST = "#9aa0a6", "#0072B2", "#D55E00"


def drawn(found: Found, told: tuple[Told, ...]) -> Drawing:
    """A panel for the trials in their order, one for each setting, one for two objectives against each other.

    `told` are the trials of an adaptive search; none for a grid.
    """
    objective = found.objectives[0]
    names = list(found.space)
    several = len(found.objectives) > 1
    titles = [
        *(["trials in their order"] if told else []),
        *(name.replace("_", " ") for name in names),
        *(["the front"] if several else []),
    ]
    with style.publication():
        figure, axes = style.panels(titles, share=False)
        left = list(axes)
        if told:
            _history(left.pop(0), told, objective)
        for name in names:
            _slice(left.pop(0), found, name)
        if several:
            _front(left.pop(0), found)
        _same_heights(axes[: len(axes) - several], found)
        style.legend(figure, _legend(found, told))
    return Drawing(figure, "What the search found", _caption(found, told))


def _history(axis: Axes, told: tuple[Told, ...], objective: Objective) -> None:
    whole = [trial for trial in told if trial.whole and np.isfinite(trial.scores[0])]
    numbers, scores = [trial.number + 1 for trial in whole], [trial.scores[0] for trial in whole]
    axis.plot(numbers, scores, color=OF_POINTS, **POINT)
    if scores:
        best = np.maximum.accumulate(scores) if objective.larger else np.minimum.accumulate(scores)
        axis.plot(numbers, best, color=OF_BEST, drawstyle="steps-post")
    axis.set_xlabel("trial")
    axis.set_ylabel(_label(objective))


def _slice(axis: Axes, found: Found, name: str) -> None:
    domain = found.space[name]
    for points, colour in _kinds(found):
        axis.plot(
            [each.point[name] for each in points], [each.scores[0] for each in points], color=colour, **POINT
        )
    axis.plot(found.best.point[name], found.best.scores[0], color=OF_BEST, **STAR)
    ends = domain.ends
    if domain.log if isinstance(domain, Range) else min(ends) > 0 and max(ends) >= 5 * min(ends):
        _by_factors(axis, max(ends) / min(ends))
    axis.set_xlabel(words.math_symbol(name))
    axis.set_ylabel(_label(found.objectives[0]))


def _by_factors(axis: Axes, factor: float) -> None:
    """A logarithmic axis whose few ticks are plain numbers."""
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if factor <= 100 else (1.0,)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def _front(axis: Axes, found: Found) -> None:
    first, second = found.objectives[:2]
    dotted: dict[str, Any] = {**POINT, "linestyle": ":"}
    on, off = (
        [each for each in found.points if each.on_front == whether and np.isfinite(each.scores).all()]
        for whether in (True, False)
    )
    axis.plot([each.scores[1] for each in off], [each.scores[0] for each in off], color=OF_POINTS, **POINT)
    on.sort(key=lambda each: each.scores[1])
    axis.plot(
        [each.scores[1] for each in on],
        [each.scores[0] for each in on],
        color=OF_TIED,
        **dotted,
    )
    axis.plot(found.best.scores[1], found.best.scores[0], color=OF_BEST, **STAR)
    axis.set_xlabel(_label(second))
    axis.set_ylabel(_label(first))


def _kinds(found: Found) -> list[tuple[list[Looked], str]]:
    """Points that are worse, and those tied with the best."""
    known = [each for each in found.points if np.isfinite(each.scores[0])]
    return [
        ([each for each in known if each.tied == tied], OF_TIED if tied else OF_POINTS)
        for tied in (False, True)
    ]


def _same_heights(axes: list[Axes], found: Found) -> None:
    scores = [each.scores[0] for each in found.points if np.isfinite(each.scores[0])]
    low, high = min(scores), max(scores)
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    for axis in axes:
        axis.set_ylim(low - margin, high + margin)


def _legend(found: Found, told: tuple[Told, ...]) -> list[Line2D]:
    handles = [Line2D([], [], color=OF_BEST, label="best", **STAR)]
    if any(each.tied for each in found.points[1:]):
        handles.append(Line2D([], [], color=OF_TIED, label="tied with it", **POINT))
    handles.append(Line2D([], [], color=OF_POINTS, label="other points", **POINT))
    if told:
        handles.append(Line2D([], [], color=OF_BEST, label="best so far"))
    return handles


def _label(objective: Objective) -> str:
    return objective.name.replace("_", " ")


def _caption(found: Found, told: tuple[Told, ...]) -> str:
    first = found.objectives[0]
    sentences = [
        f"{len(found.points):,} points that were looked at on all seeds; {_label(first)}: {first.text}, "
        f"{'more' if first.larger else 'less'} is better.",
        "Points that are not significantly worse than the best on the same seeds are tied with it.",
    ]
    pruned = sum(not trial.whole for trial in told)
    if pruned:
        sentences.append(f"{pruned:,} more trials were given up on an earlier rung, and are not shown.")
    if len(found.objectives) > 1:
        sentences.append(
            "Of the points of the front no other one is better in one objective and nowhere worse."
        )
    return " ".join(sentences)
