"""What is shown while a sweep runs: a bar in a terminal, a line a minute elsewhere. Loads no jax."""

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType
from typing import Any, TextIO, cast

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from gpcjax.sweep.telling import State, Told
from gpcjax.sweep.works import Work

LINE_SECONDS = 60.0
"""Between two lines of a log file."""

ROOM = 7
"""Lines of a terminal that are not for groups: head and foot of the table, the bar, and the command above."""


class Bar:
    """Shows how far a sweep is, from `with` to its end. What the terminal cannot take is left out: the sweep goes on.

    Args:
        name: of what is taught.
        cells: to do.
        jobs: workers.
        stream: where to; stderr by default. What is no terminal gets a line at the beginning, one a minute, and one
            at the end.
        works: all programs, before anything is done.
    """

    def __init__(
        self,
        name: str,
        cells: int,
        jobs: int,
        stream: Any = None,
        clock: Callable[[], float] = time.monotonic,
        works: Sequence[Work] = (),
    ):
        self._told, self._stream, self._line = Told(name, cells, jobs, works, clock), stream, 0.0
        self._bar: Progress | None = None
        self._live: Live | None = None

    def __enter__(self) -> "Bar":
        self._stream = stream = self._stream or sys.stderr
        self._told.begin()
        self._line = self._told.began
        if stream.isatty():
            console = Console(file=cast(TextIO, _Patient(stream)))
            self._bar = bar_in(console)
            self._task = self._bar.add_task(self._told.name, total=1.0, **_fields(self._told))
            self._live = Live(console=console, get_renderable=self._shown, refresh_per_second=4)
            self._live.start()
        else:
            self._print(self._told.first)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            # What is left on the screen is the bar: the report has a table of its own.
            self._told.state.sofar = None
            self._live.stop()
        else:
            self._print(self._told.last)

    def show(self, state: State) -> None:
        """Show this, now or with the next line."""
        told = self._told
        told.state = state
        if self._bar is not None:
            self._bar.update(self._task, completed=told.share, **_fields(told))
        elif told.clock() - self._line >= LINE_SECONDS:
            self._line = told.clock()
            self._print(told.line)

    def _shown(self) -> RenderableType:
        """The table so far above the bar, as tall as the terminal allows."""
        assert self._bar is not None
        console = self._bar.console
        sofar = self._told.sofar(console.height - ROOM, console.encoding)
        return self._bar if sofar is None else Group(sofar, self._bar)

    def _print(self, line: str) -> None:
        with suppress(OSError, ValueError):
            print(line, file=self._stream, flush=True)


def bar_in(console: Console) -> Progress:
    """The bar, with what stands beside it."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[cells]} cells"),
        TextColumn("{task.fields[speed]}"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        console=console,
    )


def _fields(told: Told) -> dict[str, Any]:
    return {"cells": told.finished, "speed": told.speed, "left": told.left}


class _Patient:
    """A terminal that may be gone, as after the end of a connection: what cannot be written is dropped."""

    def __init__(self, stream: Any):
        self._stream = stream
        self.encoding = stream.encoding

    def write(self, text: str) -> int:
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError, ValueError):
            self._stream.flush()

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._stream.fileno()
