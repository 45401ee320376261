"""What is shown while a sweep runs: a bar in a terminal, a line a minute elsewhere, JSON for programs. Loads no jax."""

import json
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, TextIO, cast

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from gpcjax.sweep.estimate import Work, is_seen, seconds_left
from gpcjax.sweep.growing import table
from gpcjax.sweep.sofar import SoFar

LINE_SECONDS = 60.0
"""Between two lines of a log file."""

ROOM = 7
"""Lines of a terminal that are not for groups: head and foot of the table, the bar, and the command above."""


@dataclass
class State:
    """What there is to show."""

    finished: int = 0
    """Cells."""
    steps: int = 0
    works: Sequence[Work] = ()
    compiling: bool = False
    """Whether a worker has been compiling for a while."""
    sofar: SoFar | None = None
    """What the runs that are finished have come to."""


class Watcher(Protocol):
    """Shows how far a sweep is, from `with` to its end. Made of its name, cells, workers and `Work` of all programs."""

    def __enter__(self) -> Any: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...

    def show(self, state: State) -> None:
        """Show this, now or later."""
        ...


@dataclass
class JsonLines:
    """Tells programs how far a sweep is: a line of JSON on stdout at its beginning, each second, and at its end.

    | Key            | What                                                                     |
    |----------------|--------------------------------------------------------------------------|
    | `event`        | "begin", "progress" or "end"                                             |
    | `sweep`        | the task                                                                 |
    | `cells`        | to do                                                                    |
    | `finished`     | of these                                                                 |
    | `env_steps`    | so far                                                                   |
    | `elapsed_s`    | since the beginning                                                      |
    | `left_s`       | estimated                                                                |
    | `compiling`    | whether a worker has been compiling for a while                          |
    """

    name: str
    cells: int
    jobs: int
    stream: Any = None
    clock: Callable[[], float] = time.monotonic
    works: Sequence[Work] = ()
    _state: State = field(default_factory=State)
    _began: float = 0.0
    _last: float = 0.0

    def __enter__(self) -> "JsonLines":
        self._began = self._last = self.clock()
        self._state = State(works=self.works)
        self._say("begin")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._say("end")

    def show(self, state: State) -> None:
        self._state = state
        if self.clock() - self._last >= 1.0:
            self._last = self.clock()
            self._say("progress")

    def _say(self, event: str) -> None:
        line = {
            "event": event,
            "sweep": self.name,
            "cells": self.cells,
            "finished": self._state.finished,
            "env_steps": self._state.steps,
            "elapsed_s": round(self.clock() - self._began, 3),
            "left_s": round(seconds_left(self._state.works, self.jobs), 3),
            "compiling": self._state.compiling,
        }
        print(json.dumps(line), file=self.stream or sys.stdout, flush=True)


@dataclass
class Bar:
    """Shows how far a sweep is, from `with` to its end. What the terminal cannot take is left out: the sweep goes on.

    Args:
        name: of what is taught.
        cells: to do.
        jobs: workers.
        stream: where to; stderr by default. What is no terminal gets a line at the beginning, one a minute, and one
            at the end.
    """

    name: str
    cells: int
    jobs: int
    stream: Any = None
    clock: Callable[[], float] = time.monotonic
    works: Sequence[Work] = ()
    """All programs, before anything is done."""
    _bar: Progress | None = None
    _live: Live | None = None
    _state: State = field(default_factory=State)
    _began: float = 0.0
    _line: float = 0.0

    def __enter__(self) -> "Bar":
        stream = self.stream or sys.stderr
        self.stream = stream
        self._began = self._line = self.clock()
        if stream.isatty():
            console = Console(file=cast(TextIO, _Patient(stream)))
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[cells]} cells"),
                TextColumn("{task.fields[speed]}"),
                TimeElapsedColumn(),
                TextColumn("{task.fields[left]}"),
                console=console,
            )
            cells, speed, left = self._fields()
            self._task = self._bar.add_task(self.name, total=1.0, cells=cells, speed=speed, left=left)
            self._live = Live(console=console, get_renderable=self._shown, refresh_per_second=4)
            self._live.start()
        else:
            where = f"{self.jobs} {'process' if self.jobs == 1 else 'processes'}"
            self._print(f"{self.name}: {self.cells} cells in {where}{self._expected()}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._state.sofar = (
                None  # what is left on the screen is the bar: the report has a table of its own
            )
            self._live.stop()
        else:
            took = _clock_time(self.clock() - self._began)
            self._print(f"{self.name}: {self._state.finished}/{self.cells} cells in {took}, {self._speed()}")

    def show(self, state: State) -> None:
        """Show this, now or with the next line."""
        self._state = state
        if self._bar is not None:
            cells, speed, left = self._fields()
            self._bar.update(self._task, completed=self._done(), cells=cells, speed=speed, left=left)
        elif self.clock() - self._line >= LINE_SECONDS:
            self._line = self.clock()
            parts = (f"{state.finished}/{self.cells} cells", self._speed(), self._left())
            self._print(f"{self.name}: {', '.join(part for part in parts if part)}")

    def _shown(self) -> RenderableType:
        """The table so far above the bar, as tall as the terminal allows."""
        assert self._bar is not None
        sofar, console = self._state.sofar, self._bar.console
        if sofar is None or sofar.range is None:
            return self._bar
        return Group(table(sofar, max(console.height - ROOM, 1), console.encoding), self._bar)

    def _expected(self) -> str:
        """How long it may take, for the first line; said where the programs have run here before."""
        if not self.works or not all(work.before for work in self.works):
            return ""
        compiling = max(work.usual_compiling for work in self.works)
        seconds = _clock_time(seconds_left(self.works, self.jobs))
        return f", about {seconds}, of which {_clock_time(compiling)} until all programs are there"

    def _fields(self) -> tuple[str, str, str]:
        return f"{self._state.finished}/{self.cells}", self._speed(), self._left()

    def _done(self) -> float:
        """Share of the time that is over, as far as it can be told."""
        left = seconds_left(self._state.works, self.jobs)
        spent = self.clock() - self._began
        return spent / (spent + left) if spent + left else 0.0

    def _speed(self) -> str:
        state = self._state
        speed = (
            f"{state.steps / max(self.clock() - self._began, 1e-9):,.0f} env steps/s" if state.steps else ""
        )
        return ", ".join(filter(None, (speed, "compiling" if state.compiling else ""))) or "starting"

    def _left(self) -> str:
        """Time left, once some steps tell how fast this machine is."""
        works = self._state.works
        if not any(is_seen(work) for work in works):
            return ""
        return f"{_clock_time(seconds_left(works, self.jobs))} left"

    def _print(self, line: str) -> None:
        with suppress(OSError, ValueError):
            print(line, file=self.stream, flush=True)


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


def _clock_time(seconds: float) -> str:
    """As 1:02:03, or 2:03."""
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"
