"""How far a sweep is, in a Jupyter notebook: the table that grows and the bar of a terminal, in one output."""

import io
import sys
import time
from collections.abc import Callable, Sequence
from html import escape
from types import TracebackType
from typing import Any

from rich.console import Console

from gpcjax.sweep.progress import Bar
from gpcjax.sweep.telling import State, Told, Watcher
from gpcjax.sweep.works import Work

APART = 0.5
"""Seconds between two pictures at least: each goes to the browser."""

WIDTH, LINES, BAR = 110, 24, 40
"""Characters, groups of the table, and characters of the bar."""
FULL, EMPTY = "\u2588", "\u2591"


def in_notebook() -> bool:
    """Whether this program is the kernel of a notebook: what it shows goes into a page, not to a terminal."""
    shell = sys.modules.get("IPython")
    running = None if shell is None else shell.get_ipython()
    return getattr(running, "kernel", None) is not None


def usual_watcher() -> Callable[..., Watcher]:
    """Who shows how far a sweep is, where nobody says."""
    return Notebook if in_notebook() else Bar


class Notebook:
    """Shows how far a sweep is, from `with` to its end, in the output of a cell. Arguments as of `Bar`."""

    def __init__(self, name: str, cells: int, jobs: int, works: Sequence[Work] = ()):
        self._told, self._shown = Told(name, cells, jobs, works), 0.0
        self._display: Any = None

    def __enter__(self) -> "Notebook":
        from IPython.display import display

        self._told.begin()
        self._display = display(_Lines(self._told.first), display_id=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._display.update(_Lines(self._told.last))

    def show(self, state: State) -> None:
        """Show this, now or soon."""
        self._told.state = state
        if time.monotonic() - self._shown > APART:
            self._shown = time.monotonic()
            self._display.update(_Lines(self._picture()))

    def _picture(self) -> str:
        filled = round(BAR * self._told.share)
        bar = FULL * filled + EMPTY * (BAR - filled) + "  " + self._told.line
        sofar = self._told.sofar(LINES, "utf-8")
        if sofar is None:
            return bar
        page = Console(file=io.StringIO(), width=WIDTH, color_system=None, force_jupyter=False)
        with page.capture() as captured:
            page.print(sofar)
        return f"{captured.get().rstrip()}\n\n{bar}"


class _Lines:
    """Text as it is, in letters of one width."""

    def __init__(self, text: str):
        self._text = text

    def _repr_html_(self) -> str:
        return f'<pre style="line-height: 1.2">{escape(self._text)}</pre>'

    def __repr__(self) -> str:
        return self._text
