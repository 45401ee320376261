"""What is to be said of a sweep while it runs, whoever shows it. Loads no jax."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol

from rich.console import RenderableType

from gpcjax.sweep.estimate import compiling_left, seconds_left
from gpcjax.sweep.growing import table
from gpcjax.sweep.sofar import SoFar
from gpcjax.sweep.works import Work, is_seen


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
    _reckoned: tuple[float, float] | None = None
    """When the time left was reckoned last, and what it was."""

    def begin(self) -> None:
        """From now on."""
        self.began = self.clock()

    @property
    def first(self) -> str:
        """The line of the beginning: about how long it may take, and how much of that is compiling."""
        line = (
            f"{self.name}: {self.cells} cells in {self.jobs} {'process' if self.jobs == 1 else 'processes'}"
        )
        if not self.works:
            return line
        return f"{line}, about {clock_time(seconds_left(self.works, self.jobs))}{self._compiling(self.works)}"

    def _compiling(self, works: Sequence[Work]) -> str:
        seconds = round(compiling_left(works, self.jobs))
        return f", {clock_time(seconds)} of it compiling" if seconds else ""

    @property
    def line(self) -> str:
        """How far it is."""
        parts = (f"{self.finished} cells", self.speed, self.left)
        return f"{self.name}: {', '.join(part for part in parts if part)}"

    @property
    def last(self) -> str:
        """What it has come to."""
        took = clock_time(self.clock() - self.began)
        return f"{self.name}: {self.finished} cells in {took}, {self._rate or 'no steps'}"

    @property
    def finished(self) -> str:
        """Cells, of all."""
        return f"{self.state.finished}/{self.cells}"

    @property
    def share(self) -> float:
        """Of the time that is over, as far as it can be told."""
        left = self._seconds_left()
        spent = self.clock() - self.began
        return spent / (spent + left) if spent + left else 0.0

    def _seconds_left(self) -> float:
        """Reckoned each second: messages come as often as there are workers, and who shows them answers these, too."""
        now = self.clock()
        if self._reckoned is None or now - self._reckoned[0] >= 1.0 or self.state.finished >= self.cells:
            self._reckoned = now, seconds_left(self.state.works or self.works, self.jobs)
        since, seconds = self._reckoned
        return max(seconds - (now - since), 0.0)

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
        """Time left: a guess, with what of it is compiling, until some steps tell how fast this machine is."""
        works = self.state.works or self.works
        if not works:
            return ""
        seconds = clock_time(self._seconds_left())
        if any(is_seen(work) for work in works):
            return f"{seconds} left"
        return f"about {seconds} left{self._compiling(works)}"

    def sofar(self, lines: int, encoding: str | None) -> RenderableType | None:
        """The table so far, of so many groups at most; None as long as there is nothing in it."""
        sofar = self.state.sofar
        return None if sofar is None or sofar.range is None else table(sofar, max(lines, 1), encoding)


def clock_time(seconds: float) -> str:
    """As 1:02:03, or 2:03."""
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"
