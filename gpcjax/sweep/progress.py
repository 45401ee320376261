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
class Told:
    """What is to be said of a sweep that runs, whoever shows it."""

    name: str
    """Of what is taught."""
    cells: int
    jobs: int
    works: Sequence[Work] = ()
    """All programs, before anything is done."""
    clock: Callable[[], float] = time.monotonic
    state: State = field(default_factory=State)
    began: float = 0.0

    def begin(self) -> None:
        """From now on."""
        self.began = self.clock()

    @property
    def first(self) -> str:
        """The line of the beginning: how long it may take is said where the programs have run here before."""
        line = (
            f"{self.name}: {self.cells} cells in {self.jobs} {'process' if self.jobs == 1 else 'processes'}"
        )
        if not self.works or not all(work.before for work in self.works):
            return line
        compiling = max(work.usual_compiling for work in self.works)
        seconds = _clock_time(seconds_left(self.works, self.jobs))
        return f"{line}, about {seconds}, of which {_clock_time(compiling)} until all programs are there"

    @property
    def line(self) -> str:
        """How far it is."""
        parts = (f"{self.finished} cells", self.speed, self.left)
        return f"{self.name}: {', '.join(part for part in parts if part)}"

    @property
    def last(self) -> str:
        """What it has come to."""
        took = _clock_time(self.clock() - self.began)
        return f"{self.name}: {self.finished} cells in {took}, {self._rate or 'no steps'}"

    @property
    def finished(self) -> str:
        """Cells, of all."""
        return f"{self.state.finished}/{self.cells}"

    @property
    def share(self) -> float:
        """Of the time that is over, as far as it can be told."""
        left = seconds_left(self.state.works, self.jobs)
        spent = self.clock() - self.began
        return spent / (spent + left) if spent + left else 0.0

    @property
    def speed(self) -> str:
        """Steps a second, and whether it compiles."""
        return (
            ", ".join(filter(None, (self._rate, "compiling" if self.state.compiling else ""))) or "starting"
        )

    @property
    def _rate(self) -> str:
        steps, spent = self.state.steps, max(self.clock() - self.began, 1e-9)
        return f"{steps / spent:,.0f} env steps/s" if steps else ""

    @property
    def left(self) -> str:
        """Time left, once some steps tell how fast this machine is."""
        works = self.state.works
        if not any(is_seen(work) for work in works):
            return ""
        return f"{_clock_time(seconds_left(works, self.jobs))} left"

    def sofar(self, lines: int, encoding: str | None) -> RenderableType | None:
        """The table so far, of so many groups at most; None as long as there is nothing in it."""
        sofar = self.state.sofar
        return None if sofar is None or sofar.range is None else table(sofar, max(lines, 1), encoding)


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


def _clock_time(seconds: float) -> str:
    """As 1:02:03, or 2:03."""
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"
