"""Final return over the settings that a grid varies: heatmaps for two of them, lines for one."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gpcjax.report import words
from gpcjax.report.figures import style
from gpcjax.report.figures.curves import CUT, MOST_PANELS, left_out
from gpcjax.report.figures.style import Drawing
from gpcjax.report.groups import Group, unique
from gpcjax.report.summary import Row, Summary

COLOURS = "cividis"
"""Even in lightness, and the same with any colour vision."""

MOST_NUMBERS = 100
"""A panel with more points shows colours and marks only."""

MOST_MARKS = 1000
"""A heatmap with more points shows the best one alone: dots on those that are tied with it would cover the colours."""

MOST_TICKS = 12
"""Values of an axis that are written: of more every second, third and so on."""

MOST_POINTS = 100
"""Of a line with a marker each; of more the best one has one, and those that are tied with it small dots."""

BEST, TIED = "\N{BLACK STAR}", "\N{BULLET}"


@dataclass(frozen=True)
class _Panel:
    """One oracle and error rate: a heatmap of one algorithm (two axes), or lines of several (one axis)."""

    title: str
    axes: tuple[str, ...]
    groups: tuple[Group, ...]


class _Fields(NamedTuple):
    """What a heatmap shows, rows along y: nan where no run can be compared."""

    x: list[float]
    y: list[float]
    final: Float[np.ndarray, "y x"]
    best: Bool[np.ndarray, "y x"]
    tied: Bool[np.ndarray, "y x"]

    @property
    def is_scattered(self) -> bool:
        """Whether few of its fields have runs, as where a search chose its points: they are no grid."""
        return bool(np.isnan(self.final).mean() > 0.6)


def final_returns(summary: Summary) -> Drawing | None:
    """Mean over runs of the final return over the grid, a panel for each algorithm, oracle and error rate.

    The first two settings with several values span a heatmap; where more vary, a field shows the best over the
    others. With one setting the algorithms share a panel of lines with their 95% intervals. A star marks the best
    point, a dot the points tied with it. None if nothing varies or no run can be compared.
    """
    every, study = _panels(summary), summary.study
    panels = every[:MOST_PANELS]
    if not any(group.runs for panel in panels for group in panel.groups):
        return None
    with style.publication():
        columns = len(study.panels) if len(study.panels) <= 4 else None
        figure, axes = style.panels([panel.title for panel in panels], columns, share=False)
        drawn = list(zip(panels, axes, strict=True))
        label = "final " + words.return_label(study)
        lines = [(panel, axis) for panel, axis in drawn if len(panel.axes) == 1]
        cut = _draw_lines(lines, summary, label)
        _draw_heatmaps(
            figure, [(panel, axis) for panel, axis in drawn if len(panel.axes) == 2], summary, label
        )
        style.legend(figure, _legend(panels, summary))
    sentences = [
        f"Final return over {words.listed([words.meaning(name) for name in study.varying])}: mean over runs"
        f"{', of lines with its 95% interval' if lines else ''}. The star is the best point; points that are not "
        "significantly worse on the same seeds are tied with it."
    ]
    if any(_fields_of(panel) > MOST_MARKS for panel in panels):
        sentences.append(
            f"Where there are more than {MOST_MARKS:,} points those that are tied are in summary.csv alone."
        )
    sentences += left_out(every)
    if len(study.varying) > 2:
        sentences.append("A field shows the best over the settings that are not on its axes.")
    return Drawing(figure, "Final return over the grid", " ".join([*sentences, *([CUT] if cut else [])]))


def _panels(summary: Summary) -> list[_Panel]:
    """Heatmaps by algorithm first, then lines by setting; in each the oracles and error rates."""
    study = summary.study
    several = len({oracle for oracle, _ in study.panels}) > 1
    axes = {algo: study.axes(algo)[:2] for algo in study.algorithms}
    shares = [(algo,) for algo in study.algorithms if len(axes[algo]) == 2]
    lines = unique(axes[algo] for algo in study.algorithms if len(axes[algo]) == 1)
    shares += [tuple(algo for algo in study.algorithms if axes[algo] == names) for names in lines]
    panels = []
    for algorithms in shares:
        names = axes[algorithms[0]]
        for oracle, error in study.panels:
            groups = tuple(group for group in study.select(oracle, error) if group.algo in algorithms)
            title = f"{words.algorithm(algorithms[0])}, " if len(names) == 2 else ""
            title += f"oracle {oracle}, " if several else ""
            panels.append(_Panel(f"{title}{words.percent(error)} error", names, groups))
    return panels


def _draw_heatmaps(
    figure: Figure, drawn: Sequence[tuple[_Panel, Axes]], summary: Summary, label: str
) -> None:
    """All heatmaps with one scale of colours and its bar."""
    fields = [_fields(panel, summary) for panel, _ in drawn]
    known = [value for field in fields for value in field.final[~np.isnan(field.final)]]
    if not known:
        return
    scale = Normalize(min(known), max(known))
    for (panel, axis), field in zip(drawn, fields, strict=True):
        draw = _scatter if field.is_scattered else _heatmap
        draw(axis, panel.axes, field, scale)
    bar = figure.colorbar(
        ScalarMappable(scale, COLOURS),
        ax=[axis for _, axis in drawn],
        shrink=0.9,
        aspect=25,
        pad=0.02,
        label=label,
    )
    bar.ax.spines[:].set_visible(False)


def _fields(panel: _Panel, summary: Summary) -> _Fields:
    across, up = panel.axes
    x, y = _values(panel.groups, across), _values(panel.groups, up)
    column, line = ({value: place for place, value in enumerate(values)} for values in (x, y))
    final = np.full((len(y), len(x)), np.nan)
    best, tied = np.zeros(final.shape, bool), np.zeros(final.shape, bool)
    for group in panel.groups:
        if group.runs:
            values, row = dict(group.point.values), summary.of(group)
            place = line[values[up]], column[values[across]]
            final[place] = np.fmax(final[place], row.final.estimate)
            best[place] |= row.best
            tied[place] |= row.tied
    return _Fields(x, y, final, best, tied)


def _heatmap(axis: Axes, names: Sequence[str], field: _Fields, scale: Normalize) -> None:
    axis.set_facecolor("#e4e4e4")  # a point without a run
    axis.imshow(field.final, origin="lower", aspect="auto", cmap=COLOURS, norm=scale)
    for values, ticks, room in ((field.x, axis.set_xticks, 6), (field.y, axis.set_yticks, MOST_TICKS)):
        thinned = len(values) > MOST_TICKS
        labelled = range(0, len(values), -(-len(values) // room) if thinned else 1)
        ticks(labelled, [f"{values[place]:.{3 if thinned else 6}g}" for place in labelled])
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)
    axis.set_xlabel(words.math_symbol(names[0]))
    axis.set_ylabel(words.math_symbol(names[1]))
    if field.final.size > MOST_MARKS:
        up, across = np.nonzero(field.best)
        axis.plot(across, up, "*", color="white", markeredgecolor=style.INK, markersize=9, clip_on=False)
        return
    decimals = words.places(field.final.ravel().tolist())
    size = 6.5 if field.final.size <= 30 else 5.0
    for place, value in np.ndenumerate(field.final):
        mark = BEST if field.best[place] else TIED if field.tied[place] else ""
        number = words.number(value, decimals) if field.final.size <= MOST_NUMBERS else ""
        text = "\n".join(filter(None, [mark, number]))
        if text and not np.isnan(value):
            axis.text(
                place[1], place[0], text, color=_ink(scale(value)), fontsize=size, ha="center", va="center"
            )


def _scatter(axis: Axes, names: Sequence[str], field: _Fields, scale: Normalize) -> None:
    """Points where their settings lie, by factors where these are large."""
    up, across = np.nonzero(~np.isnan(field.final))
    x, y = np.asarray(field.x)[across], np.asarray(field.y)[up]
    shown = field.final[up, across]
    axis.scatter(x, y, c=shown, s=16, cmap=COLOURS, norm=scale, linewidths=0.3, edgecolors=style.INK)
    for mark, size, which in (("o", 1.2, field.tied & ~field.best), ("*", 9, field.best)):
        line, column = np.nonzero(which)
        colour = "white" if mark == "*" else _ink(1.0)
        places = np.asarray(field.x)[column], np.asarray(field.y)[line]
        axis.plot(
            *places, mark, color=colour, markeredgecolor=style.INK, markeredgewidth=0.5, markersize=size
        )
    for values, set_scale in ((field.x, axis.set_xscale), (field.y, axis.set_yscale)):
        if values[0] > 0 and values[-1] >= 5 * values[0]:
            set_scale("log")
    axis.set_xlabel(words.math_symbol(names[0]))
    axis.set_ylabel(words.math_symbol(names[1]))


def _draw_lines(drawn: Sequence[tuple[_Panel, Axes]], summary: Summary, label: str) -> bool:
    """All panels of lines with the same height; whether an interval is cut."""
    for panel, axis in drawn:
        _lines(axis, panel, summary)
        axis.set_ylabel(label)
    return style.follow_lines([axis for _, axis in drawn]) if drawn else False


def _lines(axis: Axes, panel: _Panel, summary: Summary) -> None:
    (name,) = panel.axes
    looks = style.looks(summary.study.algorithms)
    for algo in unique(group.algo for group in panel.groups):
        groups = [group for group in panel.groups if group.algo == algo and group.runs]
        x = np.array([group.point.get(name) for group in groups], dtype=np.float64)
        estimates = np.array([summary.of(group).final for group in groups])
        colour, dash = looks[algo].colour, looks[algo].dash
        axis.fill_between(x, estimates[:, 1], estimates[:, 2], color=colour, alpha=0.2, linewidth=0)
        axis.plot(x, estimates[:, 0], color=colour, linestyle=dash)
        many = len(groups) > MOST_POINTS
        for group, value, (estimate, _, _) in zip(groups, x, estimates, strict=True):
            row = summary.of(group)
            if row.best or not many:
                axis.plot(value, estimate, zorder=4, **_marker(colour, row))
        if many:
            tied = np.array([summary.of(group).tied for group in groups])
            axis.plot(x[tied], estimates[tied, 0], ".", color=colour, markersize=2)
    values = _values(panel.groups, name)
    if values[0] > 0 and values[-1] >= 5 * values[0]:
        axis.set_xscale("log")
    if len(values) <= MOST_TICKS:
        axis.set_xticks(values, [f"{value:g}" for value in values], minor=False)
        axis.set_xticks([], minor=True)
    axis.set_xlabel(words.math_symbol(name))


def _marker(colour: str, row: Row) -> dict[str, Any]:
    if row.best:
        return {
            "marker": "*",
            "markersize": 10,
            "color": colour,
            "markeredgecolor": "white",
            "markeredgewidth": 0.5,
            "clip_on": False,
        }
    return {
        "marker": "o",
        "markersize": 4,
        "color": colour,
        "markerfacecolor": colour if row.tied else "white",
    }


def _legend(panels: Sequence[_Panel], summary: Summary) -> list[Artist]:
    lines = [panel for panel in panels if len(panel.axes) == 1]
    looks = style.looks(summary.study.algorithms)
    handles: list[Artist] = [
        Line2D(
            [], [], color=looks[algo].colour, linestyle=looks[algo].dash, label=words.drawn_algorithm(algo)
        )
        for algo in unique(group.algo for panel in lines for group in panel.groups)
    ]
    plain: dict[str, Any] = {"linestyle": "none", "color": style.INK}
    handles.append(Line2D([], [], marker="*", markersize=8, markeredgewidth=0, label="best", **plain))
    if lines or any(_fields_of(panel) <= MOST_MARKS for panel in panels):
        handles.append(Line2D([], [], marker="o", markersize=4, label="tied with it", **plain))
    counts = [Counter(group.algo for group in panel.groups).values() for panel in lines]
    if any(min(each) <= MOST_POINTS for each in counts):
        worse = Line2D(
            [], [], marker="o", markersize=4, markerfacecolor="white", label="significantly worse", **plain
        )
        handles.append(worse)
    return handles


def _fields_of(panel: _Panel) -> int:
    """How many fields a heatmap has; 0 for lines."""
    return math.prod(len(_values(panel.groups, name)) for name in panel.axes) if len(panel.axes) == 2 else 0


def _values(groups: Sequence[Group], name: str) -> list[float]:
    return sorted({value for group in groups if (value := group.point.get(name)) is not None})


def _ink(shade: float) -> str:
    """Dark on the bright half of the colours."""
    return style.INK if shade > 0.5 else "white"
