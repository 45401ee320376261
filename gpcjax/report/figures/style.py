"""The look of every figure: sizes, colours, panels in rows, and how a figure becomes bytes."""

import io
import string
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gpcjax.report.document import Picture

# Blue, vermilion and green of Okabe and Ito (2008): told apart with any colour vision. Of the thesis' learners.
ALGORITHM_COLOURS = {"gpc": "#0072B2", "gpc-ns": "#D55E00", "coach": "#009E73"}

ORACLE_COLOUR = "#333333"
IDLE_COLOUR = "#777777"
INK = "#222222"

ACTION = "action [-1, 1]"
"""The label of an action's axis."""

ONE_PANEL = 3.5
PANEL_WIDTH, PANEL_HEIGHT = 2.4, 2.05
"""Inches; one panel fits a journal's column, three its page."""

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same figure everywhere
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "gpcjax",
    "mathtext.default": "it",
}


_BACKENDS = {"png": "agg", "pdf": "pdf", "svg": "svg"}
"""Named, as a program may have registered another one for these formats."""

_SETTING = threading.RLock()


class Drawing(NamedTuple):
    """A figure, what it shows in a few words, and the caption that says what was drawn."""

    figure: Figure
    alternative: str
    caption: str


@contextmanager
def publication() -> Iterator[None]:
    """Figures made or saved inside look like ours, whatever the user's settings are; nothing stays set.

    It starts from matplotlib's own defaults, not from a matplotlibrc, a style or a notebook's. matplotlib's settings
    belong to the process: our threads take turns here, as two contexts that overlap would restore each other's, and a
    thread of the user's that makes a figure in this moment makes it with ours.
    """
    with _SETTING, matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_SETTINGS)
        yield


class Look(NamedTuple):
    """How the lines of a learner are drawn; no marker is a plain line, whose runs are dots."""

    colour: str
    dash: Any = "-"
    marker: str = ""

    def line(self, points: int = 0) -> dict[str, Any]:
        """Keywords of a line of so many points: markers are few, at the same places for all."""
        options: dict[str, Any] = {"color": self.colour, "linestyle": self.dash}
        if self.marker:
            options |= {"marker": self.marker, "markersize": 3.5, "markevery": max(1, points // 6)}
        return options


_FIXED = {name: Look(colour) for name, colour in ALGORITHM_COLOURS.items()} | {
    "d-coach": Look("#CC79A7", marker="D")
}
"""Of learners that are the same in every figure."""

_COLOURS = ("#E69F00", "#56B4E9")
"""Orange and sky blue of the same eight colours: of learners that have none of their own."""

_DASHES = ("-", (0, (4, 1.2)), (0, (6, 1.2, 1.2, 1.2)), (0, (2, 1)))
_MARKERS = "s^vPXph8<>"


def looks(algorithms: Sequence[str]) -> dict[str, Look]:
    """A look for each of the learners that a figure shows, by their order: no two of the first twenty are the same.

    The thesis' learners and D-COACH look the same in every figure. Others take the colours that are left, then all
    colours again with other dashes; each of the first ten has a marker of its own.
    """
    taken = {_FIXED[name].colour for name in algorithms if name in _FIXED}
    every = [*_COLOURS, *(look.colour for look in _FIXED.values())]
    free = [Look(colour) for colour in every if colour not in taken]
    free += [Look(colour, dash) for dash in _DASHES[1:] for colour in every]
    others = [name for name in algorithms if name not in _FIXED]
    own = {
        name: free[place % len(free)]._replace(marker=_MARKERS[place % len(_MARKERS)])
        for place, name in enumerate(others)
    }
    return {name: _FIXED.get(name) or own[name] for name in algorithms}


def panels(
    titles: Sequence[str], columns: int | None = None, share: bool = True
) -> tuple[Figure, list[Axes]]:
    """A figure with a lettered panel for each title, in rows.

    `columns` asks for rows of that length (one row an oracle, say), which is done where a page is wide enough. With
    `share` the panels have the same axes, with numbers at the outer edge only.
    """
    number = len(titles)
    across = columns if columns and 1 < columns <= 4 else _across(number)
    down = -(-number // across)
    width, height = (ONE_PANEL, 2.4) if number == 1 else (max(ONE_PANEL, PANEL_WIDTH * across), PANEL_HEIGHT)
    figure = Figure(figsize=(width, height * down + 0.35), layout="constrained")
    axes = list(figure.subplots(down, across, sharex=share, sharey=share, squeeze=False).flat)
    for unused in axes[number:]:
        unused.remove()
    for position, (title, axis) in enumerate(zip(titles, axes, strict=False)):
        letter = f"({string.ascii_lowercase[position]}) " if 1 < number <= 26 else ""
        axis.set_title(letter + title)
        if share:
            axis.tick_params(labelbottom=position + across >= number, labelleft=position % across == 0)
    return figure, axes[:number]


def label(axes: Sequence[Axes], x: str, y: str) -> None:
    """Label x under the lowest panel of each column, y beside the first of each row."""
    for axis in axes:
        axis.set_xlabel(x if axis.xaxis.get_tick_params()["labelbottom"] else "")
        axis.set_ylabel(y if axis.yaxis.get_tick_params()["labelleft"] else "")


def count_ticks(axis: Axes, last: int) -> None:
    """Ticks for things counted from 1 to `last`: 1 and round numbers."""
    round_numbers = MaxNLocator(nbins=5, integer=True, steps=[1, 2, 5, 10]).tick_values(0, last)
    axis.set_xlim(1, max(last, 2))
    axis.set_xticks([1, *(int(number) for number in round_numbers if 1 < number <= last)])


MOST_OF_A_BAND = 0.25
"""How far an axis goes beyond its lines to show their bands whole, in parts of the range of the lines."""


def follow_lines(axes: Sequence[Axes], also: Sequence[float] = (), bottom: float | None = None) -> bool:
    """Gives all of them the same range of y: that of their lines and what is `also` drawn.

    Bands are shown as far as they go no further beyond that than `MOST_OF_A_BAND`: one wide interval would press all
    lines onto the axis.

    Args:
        axes: lines and bands are drawn.
        also: other values that have to be inside.
        bottom: the lower end, if it is given.

    Returns:
        Whether a band is cut.
    """
    drawn = [np.asarray(line.get_ydata(), np.float64) for axis in axes for line in axis.lines]
    values = np.concatenate([*drawn, np.asarray(also, np.float64)])
    values = values[np.isfinite(values)]
    if not values.size:
        return False
    low, high = values.min(), values.max()
    reach = MOST_OF_A_BAND * (high - low)
    paths = [path.vertices for axis in axes for band in axis.collections for path in band.get_paths()]
    band = np.concatenate([np.asarray(path)[:, 1] for path in paths] or [values])
    shown_low, shown_high = np.clip([band.min(), band.max()], low - reach, high + reach)
    low, high = min(low, shown_low), max(high, shown_high)
    margin = 0.04 * (high - low) or 0.05 * abs(high) or 1.0
    for axis in axes:
        axis.set_ylim(low - margin if bottom is None else bottom, high + margin)
    return bool(band.max() > high or band.min() < (low if bottom is None else min(low, bottom)))


def same_height(axes: Sequence[Axes]) -> None:
    """Gives all of them one range of y, which holds that of each."""
    low, high = zip(*(axis.get_ylim() for axis in axes), strict=True)
    for axis in axes:
        axis.set_ylim(min(low), max(high))


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """One legend above the panels, where it covers no data; in two rows or more where one is too long.

    To the left: a phone shows the beginning of a wide figure.
    """
    inches = [0.47 + 0.058 * len(str(handle.get_label())) for handle in handles]
    rows = -(-sum(inches) // figure.get_figwidth())
    columns = int(-(-len(handles) // max(rows, 1)))
    # A column is as wide as its longest label.
    while columns > 1 and sum(map(max, np.array_split(inches, columns))) > figure.get_figwidth():
        columns -= 1
    if handles:
        figure.legend(
            handles=list(handles),
            loc="outside upper left",
            ncols=columns,
            handlelength=1.8,
            columnspacing=1.6,
        )


def image(figure: Figure, kind: str, dpi: int = 200) -> bytes:
    """`figure` as "png", "pdf" or "svg"; the same figure gives the same bytes, whatever it was made into before."""
    undated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(kind, {})
    stream = io.BytesIO()
    with publication():
        _lay_out(figure)
        figure.savefig(stream, format=kind, backend=_BACKENDS[kind], dpi=dpi, metadata=undated)
    return stream.getvalue()


def _lay_out(figure: Figure) -> None:
    """Finds the places of all parts, once: with each format anew it takes longer than the drawing itself."""
    engine = figure.get_layout_engine()
    if engine is not None:
        FigureCanvasAgg(figure)  # it measures texts, whoever else is registered for a format
        engine.execute(figure)
        figure.set_layout_engine(None)


def load_formats() -> None:
    """Has matplotlib load what it otherwise loads with the first figure of each format: half a second of fonts."""
    figure, (axis,) = panels(["$x$"])
    axis.set_title("y")
    for kind in _BACKENDS:
        image(figure, kind)


def pictured(drawing: Drawing, file: str = "", svg: bytes | None = None) -> Picture:
    """A drawing for a document; `file` is where it lies beside it, `svg` the figure, if it has been painted before."""
    figure, alternative, caption = drawing
    svg = image(figure, "svg") if svg is None else svg
    return Picture(svg, figure.get_figwidth(), alternative, caption, file)


def _across(number: int) -> int:
    if number <= 3:
        return number
    return 2 if number == 4 else 3 if number <= 9 else 4
