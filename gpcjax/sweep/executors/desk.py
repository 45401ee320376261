"""The desk at which all workers of a sweep ask, whatever runs them. Loads no jax."""

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from gpcjax.errors import Failure, ForeignError, UserError
from gpcjax.sweep import stopping
from gpcjax.sweep.blocks import Block
from gpcjax.sweep.checkpoints import HERE, Place
from gpcjax.sweep.crowd import Crowd
from gpcjax.sweep.estimate import overdue
from gpcjax.sweep.executors.base import NO_ORDERS, Message, Orders, Totals
from gpcjax.sweep.machine import kind_of
from gpcjax.sweep.plan import Cell, Program, program_of
from gpcjax.sweep.rows import CellRows
from gpcjax.sweep.sharing import Before, Sharing
from gpcjax.sweep.works import Work

COMPILES_FROM = 0.5
"""Seconds from which on a compilation is spoken of: taking a compiled program from the cache is over by then. For so
long a worker is silent only while it compiles: before XLA has a program, which it says, it is traced."""

NOTE_SECONDS = 0.2
"""Between two looks at how much of a core workers have."""


@dataclasses.dataclass
class _Heard:
    """What is known of a worker."""

    progress: Totals = dataclasses.field(default_factory=Totals)
    """What it has done, as far as it has told."""
    since: float = 0.0
    """When its time was last put down to its program."""
    told: float | None = None
    """When it last said what it has done."""
    compiling_since: float | None = None
    baseline: tuple[str, str] | None = None
    """What it measures now."""
    machine: str = HERE
    """The kind of machine that it is on, where that is another one than the desk's."""


class Desk:
    """Answers what workers say: hands out cells and baselines, takes in rows, reckons the progress. Safe for threads.

    Args:
        cells: what to run.
        baselines: (env, name) of idle policies and experts to measure, first.
        jobs: workers there may be.
        on_rows: called with the rows of each finished cell, or of some at once.
        on_baseline: called with the name and the numbers of each baseline.
        on_progress: called with the totals, some times a second.
        on_note: called with each line that a worker has for the person.
        orders: what workers do beside.
        before: tells what programs took the last time.
        starts: seconds until workers are there, likewise.
        on_machine: called with the description of each machine that a worker says to be on.
        on_over: called with the name of each checkpoint whose runs have all been handed in.
        places: where runs can go on, by the kind of machine.
    """

    def __init__(
        self,
        cells: Iterable[Cell],
        baselines: Iterable[tuple[str, str]],
        jobs: int,
        on_rows: Callable[[CellRows | Block], None],
        on_baseline: Callable[[str, dict[str, float]], None],
        on_progress: Callable[[Totals], None],
        on_note: Callable[[str], None] = lambda line: None,
        orders: Orders = NO_ORDERS,
        before: Before = lambda programs: {},
        starts: float = 0.0,
        on_machine: Callable[[Mapping[str, Any]], None] = lambda described: None,
        on_over: Callable[[str], None] = lambda name: None,
        places: Mapping[str, Mapping[Cell, Place]] = {},
    ):
        self.cells, self.baselines = tuple(cells), tuple(baselines)
        self.workers = max(1, min(jobs, len(self.cells) or 1))
        """How many there is work for."""
        self._sharing = Sharing(self.cells, self.workers, before)
        self._measure = deque(self.baselines)
        self._on_rows, self._on_baseline, self._on_progress = on_rows, on_baseline, on_progress
        self._on_note, self._on_machine, self._on_over = on_note, on_machine, on_over
        self.orders = orders
        self._places = {kind: dict(theirs) for kind, theirs in places.items()}
        self._heard = [_Heard() for _ in range(self.workers)]
        self._done = Totals()
        """What all workers have done, those that are gone too; kept up as they tell, however many they are."""
        self._copies = False
        self._began, self._starts, self._is_there = time.monotonic(), starts, False
        self.started: float | None = None
        """Seconds of a core until a worker was there, of those that were started for this sweep."""
        self._crowd, self._noted = Crowd(), 0.0
        self._note_times()
        self._lock = threading.Lock()

    @property
    def done(self) -> bool:
        """Whether all rows and baselines have come."""
        with self._lock:
            return not (self._sharing.left or self._measuring())

    @property
    def works(self) -> dict[Program, Work]:
        """What has been done for each program so far."""
        return self._sharing.works

    def answer(self, worker: int, message: Message) -> Message | None:
        """The answer to what this worker says; None where it asks nothing.

        Raises:
            Failure: the worker says that it failed.
            UserError: it says that what a person asked for cannot be done, or that somebody else's code failed.
            Stopped: a signal came in, within `stopping.deferred`.
        """
        with self._lock:
            stopping.check()
            return self._answer(worker, message)

    def look(self) -> None:
        """Nothing comes, time goes on: tell of the progress.

        Raises:
            Stopped: a signal came in, within `stopping.deferred`.
        """
        with self._lock:
            stopping.check()
            self._on_progress(self._totals())

    def give_copies(self) -> None:
        """From now on workers that have nothing left run what others have had for longest: for machines that differ."""
        self._copies = True

    def is_late(self, worker: int) -> bool:
        """Whether all that this worker still has came from others: nobody needs to wait for it once all is done."""
        with self._lock:
            return self._sharing.is_late(worker)

    def lose(self, worker: int, places: Mapping[Cell, Place] = {}) -> None:
        """Take back what this worker had, which is gone, for others; for executors whose machines come and go.

        What it still says must not be passed on. Workers that were told to stop are not called back, so another one
        should be run in its place, under the same number. `places` are where its runs can go on, on such a machine.
        """
        with self._lock:
            heard, self._heard[worker] = self._heard[worker], _Heard()
            lost = self._sharing.lose(worker)
            alike = self._places.setdefault(heard.machine, {})
            alike |= {cell: places[cell] for cell in lost if cell in places}
            if heard.baseline is not None:
                self._measure.appendleft(heard.baseline)

    def refuse_less(self) -> None:
        """Raise `Failure` unless all rows and baselines have come: an executor ended too early."""
        left, measuring = self._sharing.left, self._measuring()
        if left or measuring:
            raise Failure(f"the executor ended with {left} cells and {measuring} baselines to do")

    def _measuring(self) -> int:
        """Baselines that have not come."""
        return len(self._measure) + sum(heard.baseline is not None for heard in self._heard)

    def _answer(self, worker: int, message: Message) -> Message | None:
        match message:
            case ("begun", float() as seconds, float() as processor, float() as piece):
                self._crowd.begin(seconds, processor, piece)
                self.started = max(self.started or 0.0, processor)
            case ("ready",):
                return self._next_program(worker)
            case ("next",):
                cells = self._sharing.next_cells(worker)
                alike = self._places.get(self._heard[worker].machine, {})
                places = {cell: alike[cell] for cell in cells if cell in alike}
                return ("cells", cells, places) if places else ("cells", cells)
            case ("rows", CellRows() | Block() as rows):
                self._take(worker, rows, self._heard[worker].machine)
            case ("over", str() as name):
                self._on_over(name)
            case ("machine", dict() as described):
                self._heard[worker].machine = kind_of(described)
                self._on_machine(described)
            case ("baseline", name, numbers):
                self._heard[worker].baseline = None
                self._on_baseline(name, numbers)
            case ("progress", Totals() as progress):
                self._reckon(worker, progress)
                self._on_progress(self._totals())
            case ("compiling", bool() as compiling):
                self._heard[worker].compiling_since = time.monotonic() if compiling else None
            case ("note", str() as line):
                self._on_note(line)
            case ("failed", line, details):
                raise Failure(f"a worker process failed: {line}", details)
            case ("refused", str() as line):
                raise UserError(line)
            case ("theirs", *arguments):
                raise ForeignError(*arguments)
        return None

    def _next_program(self, worker: int) -> Message:
        heard, measures = self._heard[worker], worker == self.workers - 1
        self._is_there = True
        self._sharing.leave(worker)
        cell = None if self._measure and measures else self._sharing.next_program(worker)
        if cell is not None:
            heard.since = time.monotonic()
            return ("program", cell, self.orders)
        if self._measure:  # the last worker does it first of all, another one when it has nothing else
            heard.baseline = self._measure.popleft()
            return ("baseline", *heard.baseline)
        copy = self._sharing.next_copy(worker) if self._copies else None
        if copy is not None:
            heard.since = time.monotonic()
            return ("program", copy, self.orders)
        return ("stop",)

    def _take(self, worker: int, rows: CellRows | Block, machine: str) -> None:
        if machine:
            rows = dataclasses.replace(rows, machine=machine)
        first = self._first(worker, rows)
        if first is None:
            return
        for cell, _, lengths in first.runs:
            work = self._sharing.works[program_of(cell)]
            work.finished += 1
            work.finished_steps += int(lengths.sum())
            work.finished_episodes += len(lengths)
        self._on_rows(first)

    def _first(self, worker: int, rows: CellRows | Block) -> CellRows | Block | None:
        """Those of the rows that have not come from another worker before."""
        new = []
        for place, cell in enumerate(rows.cells):
            try:
                if self._sharing.back(worker, cell):
                    new.append(place)
            except KeyError:
                raise Failure(f"rows of a cell came that its worker has not: {cell}") from None
        if len(new) == len(rows.cells):
            return rows
        return rows.chosen(new) if new and isinstance(rows, Block) else None

    def _reckon(self, worker: int, progress: Totals) -> None:
        """Put what a worker has done since it was last heard, and the time, down to its program."""
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

    def _note_times(self) -> None:
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

    def _totals(self) -> Totals:
        self._note_times()
        long_ago = time.monotonic() - COMPILES_FROM
        compiling = (heard.compiling_since for heard in self._heard)
        return dataclasses.replace(
            self._done,
            works=tuple(self._sharing.works.values()),
            compiling=any(since is not None and since < long_ago for since in compiling),
        )
