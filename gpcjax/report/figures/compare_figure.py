"""The figure of a comparison: differences with their intervals (a forest plot), and performance profiles below."""

import string
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from gpcjax.report import words
from gpcjax.report.compare_match import Folder
from gpcjax.report.compare_numbers import STATISTICS, Difference, Profile
from gpcjax.report.compare_page import ALWAYS, setting_shown, settings_shown
from gpcjax.report.figures import style
from gpcjax.report.figures.curves import line
from gpcjax.report.figures.style import Drawing
from gpcjax.report.groups import unique

if TYPE_CHECKING:
    from gpcjax.report.compare import Comparison

MOST_ROWS = 60
"""Pairs of groups in the forest plot; more are left to comparison.csv."""

MOST_PANELS = 12
"""Of profiles; more are left to profiles.csv."""

WIDTH = 3 * style.PANEL_WIDTH
ROW = 0.19
"""Inches of a row of the forest plot."""

MARK: dict[str, Any] = {
    "marker": "o",
    "markersize": 4.0,
    "color": style.INK,
    "linewidth": 1.1,
    "markeredgewidth": 0.9,
}
"""Of a difference: full or hollow."""

ACROSS = 3
"""Panels in a row."""

LONGEST_NAME, SHORTER_NAME = 40, 18
"""Letters of a folder's name where it stands alone, and of each of two."""

WRAP = 40
"""Letters of a line above a panel."""


def drawn(comparison: "Comparison") -> Drawing:
    """Each difference in area and final return with its interval; below, the part of the runs above a final return."""
    areas = [each for each in comparison.differences if each.statistic == "area"][:MOST_ROWS]
    pairs = [each.pair for each in areas]
    blocks = unique((pair.first, pair.second) for pair in pairs)
    finals = [family for family in comparison.families if family[0].statistic == "final_return"]
    panels = finals[:MOST_PANELS]
    rows = len(areas) + (len(blocks) if len(blocks) > 1 else 0)
    down = -(-len(panels) // ACROSS)
    heights = [ROW * rows + 1.15, style.PANEL_HEIGHT * down + 0.45 if panels else 0.01]
    with style.publication():
        figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
        top, bottom = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=heights)))
        _forest(top, comparison, areas, blocks)
        if panels:
            _profiles(bottom, comparison, panels, len(panels) < 2)
    return Drawing(figure, "Differences and profiles", _caption(comparison, len(areas), len(finals)))


def _caption(comparison: "Comparison", rows: int, panels: int) -> str:
    every = sum(each.statistic == "area" for each in comparison.differences)
    sentences = [
        "Above: difference of each pair of groups, first folder minus second, mean over the seeds that both have, with "
        "its 95% interval; a full mark is a difference that is beyond zero after Holm's correction, too."
    ]
    if rows < every:
        sentences.append(f"The first {rows} of {every} pairs of groups; all are in comparison.csv.")
    if panels:
        sentences.append(
            "Below: part of the runs whose final return is above a value, with its pointwise 95% interval; over the "
            "seeds that all lines of a panel have."
        )
    if panels > MOST_PANELS:
        sentences.append(f"The first {MOST_PANELS} of {panels}; all are in profiles.csv.")
    return " ".join(sentences)


def _forest(
    figure: SubFigure,
    comparison: "Comparison",
    areas: Sequence[Difference],
    blocks: Sequence[tuple[Folder, Folder]],
) -> None:
    """A panel for each statistic, a row for each pair of groups; several pairs of folders have their names above."""
    by_pair = {(id(each.pair), each.statistic): each for each in comparison.differences}
    told = _told(comparison.differences)
    axes = list(figure.subplots(1, len(STATISTICS), sharey=True))
    labels, headings, place = [], [], {}
    for block in blocks:
        if len(blocks) > 1:
            headings.append(len(labels))
            labels.append(_direction(*block))
        for each in areas:
            if (each.pair.first, each.pair.second) == block:
                place[id(each.pair)] = len(labels)
                labels.append(_label(each, told))
    for axis, statistic, letter in zip(axes, STATISTICS, string.ascii_lowercase, strict=False):
        axis.axvline(0.0, color=style.INK, linewidth=0.6, zorder=1)
        for pair, row in place.items():
            _mark(axis, by_pair[pair, statistic], row)
        axis.set_title(f"({letter}) difference in {STATISTICS[statistic]}")
        axis.xaxis.set_major_locator(MaxNLocator(nbins=5))
        axis.set_xlabel(
            f"{_direction(*blocks[0]) if len(blocks) == 1 else 'first - second'}\n(above 0 the first is better)"
        )
        axis.tick_params(axis="y", length=0)
        axis.spines["left"].set_visible(False)
    axes[0].set_yticks(range(len(labels)), labels)
    axes[0].set_ylim(len(labels) - 0.4, -0.6)
    handles: list[Artist] = [
        Line2D([], [], label=label, **MARK, markerfacecolor=colour)
        for label, colour in (("beyond zero after Holm's correction", style.INK), ("not so", "white"))
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=2, handlelength=1.8)
    for row in headings:
        axes[0].get_yticklabels()[row].set_fontweight("bold")


def _mark(axis: Axes, difference: Difference, row: int) -> None:
    """A mean with its interval; hollow if Holm's correction does not leave it."""
    estimate, lower, upper = difference.difference
    if np.isfinite([lower, upper]).all():
        axis.plot([lower, upper], [row, row], color=style.INK, linewidth=1.1, zorder=2)
    colour = style.INK if difference.survives else "white"
    axis.plot([estimate], [row], **MARK, markerfacecolor=colour, zorder=3)


def _profiles(
    figure: SubFigure, comparison: "Comparison", families: Sequence[Sequence[Profile]], alone: bool
) -> None:
    """A panel for each family of groups, a line for each of its members; one colour a folder."""
    looks = _looks(comparison.folders)
    down = -(-len(families) // ACROSS)
    across = 2 if alone else min(ACROSS, len(families))
    axes = list(figure.subplots(down, across, sharey=True, squeeze=False).flat)
    for unused in axes[len(families) :]:
        unused.remove()
    told = _told(comparison.differences)
    sides = [(each.pair.first, each.pair.one, each) for each in comparison.differences]
    sides += [(each.pair.second, each.pair.other, each) for each in comparison.differences]
    titles = {(id(folder), _key(group)): _label(each, told) for folder, group, each in reversed(sides)}
    letters = string.ascii_lowercase[len(STATISTICS) :]
    for place, (axis, family) in enumerate(zip(axes, families, strict=False)):
        for each in family:
            look = style.Look(*looks[id(each.member.folder)][:2])
            line(axis, each.values, each.above, look)
        member = family[0].member
        key = id(member.folder), _key(member.group)
        axis.set_title("\n".join(textwrap.wrap(f"({letters[place]}) {titles[key]}", WRAP)), fontsize=7.0)
        axis.set_ylim(-0.03, 1.03)
        axis.xaxis.set_major_locator(MaxNLocator(nbins=4))
        if place + across >= len(families):
            axis.set_xlabel(f"final {words.return_label(comparison.folders[0].study)}")
        if place % across == 0:
            axis.set_ylabel("part of runs above")
    handles: list[Artist] = [
        Line2D(
            [],
            [],
            label=_short(folder.name),
            color=looks[id(folder)].colour,
            linestyle=looks[id(folder)].dash,
        )
        for folder in comparison.folders
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=min(3, len(handles)), handlelength=1.8)


def _looks(folders: Sequence[Folder]) -> dict[int, style.Look]:
    """A colour for each folder: none is one of the thesis' learners', before those are all taken."""
    names = [f"folder {place}" for place in range(len(folders))]
    looks = style.looks(names)
    return {id(folder): looks[name] for folder, name in zip(folders, names, strict=True)}


def _key(group: object) -> tuple[object, ...]:
    return tuple(getattr(group, name) for name in ("oracle", "error", "algo", "point"))


def _told(differences: Sequence[Difference]) -> list[str]:
    """Settings that tell rows apart; one that is `0.1 / 0.2` in all of them is in the tables."""
    pairs = [each.pair for each in differences]
    names = [name for name in settings_shown(pairs) if name not in ALWAYS]
    return [name for name in names if len({setting_shown(pair, name) for pair in pairs}) > 1]


def _label(difference: Difference, told: Sequence[str]) -> str:
    """`GPC, 10% error, l_p 0.1`."""
    pair = difference.pair
    algorithm, error = (setting_shown(pair, name).replace("$", "\\$") for name in ("algo", "error"))
    more = [f"{words.math_symbol(name)} {setting_shown(pair, name)}" for name in told]
    return ", ".join([algorithm, f"{error} error", *more])


def _direction(first: Folder, second: Folder) -> str:
    return f"{_short(first.name, SHORTER_NAME)} - {_short(second.name, SHORTER_NAME)}"


def _short(name: str, longest: int = LONGEST_NAME) -> str:
    """A folder's name without its middle, if it is long; a dollar would begin a formula."""
    half = longest // 2
    short = name if len(name) <= longest else f"{name[:half]}...{name[-half:]}"
    return short.replace("$", "\\$")
