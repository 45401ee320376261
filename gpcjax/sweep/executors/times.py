"""What workers have done, and the time that it took them, put down to their programs. Loads no jax."""

import dataclasses
import time

from gpcjax.sweep.crowd import Crowd
from gpcjax.sweep.estimate import overdue
from gpcjax.sweep.executors.base import Totals
from gpcjax.sweep.sharing import Sharing

COMPILES_FROM = 0.5
"""Seconds from which on a compilation is spoken of: taking a compiled program from the cache is over by then. For so
long a worker is silent only while it compiles: before XLA has a program, which it says, it is traced."""

NOTE_SECONDS = 0.2
"""Between two looks at how much of a core workers have."""


@dataclasses.dataclass
class _Heard:
    """What a worker has said of its work."""

    progress: Totals = dataclasses.field(default_factory=Totals)
    """What it has done, as far as it has told."""
    since: float = 0.0
    """When its time was last put down to its program."""
    told: float | None = None
    """When it last said what it has done."""
    compiling_since: float | None = None


class Times:
    """Keeps the `Work` of all programs of a sweep up to date, by what its workers say and when they say it.

    Args:
        sharing: who has which program.
        workers: how many there are.
        starts: seconds until workers are there.
    """

    def __init__(self, sharing: Sharing, workers: int, starts: float):
        self._sharing = sharing
        self._heard = [_Heard() for _ in range(workers)]
        self._done = Totals()
        """What all workers have done, those that are gone too; kept up as they tell, however many they are."""
        self._began, self._starts, self._is_there = time.monotonic(), starts, False
        self.started: float | None = None
        """Seconds of a core until a worker was there, of those that were started for this sweep."""
        self._crowd, self._noted = Crowd(), 0.0
        self._note()

    def begin(self, seconds: float, processor: float, piece: float) -> None:
        """A worker is there, after so many seconds, of all and of a core's; a piece of work took it so long."""
        self._crowd.begin(seconds, processor, piece)
        self.started = max(self.started or 0.0, processor)

    def are_there(self) -> None:
        """Workers are there, whether they have said so or not."""
        self._is_there = True

    def turn(self, worker: int) -> None:
        """A worker turns to a program."""
        self._heard[worker].since = time.monotonic()

    def lose(self, worker: int) -> None:
        """A worker is gone: another one has its number."""
        self._heard[worker] = _Heard()

    def compiling(self, worker: int, begins: bool) -> None:
        """XLA begins with a program for this worker, or has it."""
        self._heard[worker].compiling_since = time.monotonic() if begins else None

    def take(self, worker: int, progress: Totals) -> None:
        """Puts what a worker has done since it was last heard, and the time, down to its program."""
        heard, now = self._heard[worker], time.monotonic()
        before, heard.progress = heard.progress, progress
        told, heard.told = heard.told, now
        heard.compiling_since = None  # it would not speak
        more = progress.plus(before, -1)
        self._done = self._done.plus(more)
        program = self._sharing.at(worker)
        if program is None:
            return
        work = self._sharing.works[program]
        work.add(more.env_steps, more.episodes, more.compile_seconds)
        work.kept += more.kept
        if more.env_steps:
            self._sharing.steps(worker)
        work.paces.take(worker, progress.paces)
        work.seconds += max(now - heard.since - more.compile_seconds, 0.0)
        heard.since = now
        if told is not None and progress.processor_seconds:
            seconds, processor = now - told, progress.processor_seconds - before.processor_seconds
            work.heard_seconds += seconds
            work.processor_seconds += processor
            self._crowd.take(seconds, processor)

    def totals(self) -> Totals:
        """What all have done so far."""
        self._note()
        long_ago = time.monotonic() - COMPILES_FROM
        compiling = (heard.compiling_since for heard in self._heard)
        return dataclasses.replace(
            self._done,
            works=tuple(self._sharing.works.values()),
            compiling=any(since is not None and since < long_ago for since in compiling),
        )

    def _note(self) -> None:
        """Tells the programs what is known of all of them; not each time, as workers may be thousands."""
        now = time.monotonic()
        if now - self._noted < NOTE_SECONDS:
            return
        self._noted, slowness, ready_in = now, self._crowd.slowness, 0.0
        if not self._is_there:
            slowness = self._crowd.late(now - self._began, self._starts)
            ready_in = overdue(slowness * self._starts, now - self._began)
        for work in self._sharing.works.values():
            work.slowness, work.machine = slowness, self._crowd.machine
            work.ready_in, work.compiling_for = ready_in, 0.0
        for worker, heard in enumerate(self._heard):
            program, silent_for = self._sharing.at(worker), now - heard.since
            if program is not None and silent_for > COMPILES_FROM:
                work = self._sharing.works[program]
                work.compiling_for = max(work.compiling_for, silent_for)
