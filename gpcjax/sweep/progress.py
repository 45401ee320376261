"""How far a sweep is and how long it will take: a bar in a terminal, a line a minute elsewhere. Loads no jax."""

import heapq
import itertools
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, TextIO, cast

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from gpcjax.registry import find
from gpcjax.sweep import costs
from gpcjax.sweep.plan import Program

LINE_SECONDS = 60.0
"""Between two lines of a log file."""

COMPILES_FROM = 0.5
"""Seconds from which on a compilation is spoken of: taking a compiled program from the cache is over by then."""

JOIN = 48
"""A program that another worker already runs must have this many cells left to be worth compiling a second time."""


@dataclass
class Work:
    """The cells of one program: what has been done for them, by all workers, and what is still to do."""

    env: str
    algo: str
    cells: int
    episodes: int
    """Of each cell."""
    oracle: str = ""
    """Whose targets may cost more than a step."""
    begun: int = 0
    """Cells that were handed to workers."""
    finished: int = 0
    finished_steps: int = 0
    """Steps of the finished cells."""
    finished_episodes: int = 0
    """Episodes of the finished cells: fewer than they might have had, where runs stopped."""
    steps: int = 0
    done_episodes: int = 0
    seconds: float = 0.0
    """That workers have spent on it, compilations left out."""
    compile_seconds: float = 0.0
    workers: int = 0
    """Workers that are at it now."""
    starting: int = 0
    """Those of them that have not made a step yet."""
    joined: int = 0
    """Workers that have been at it: each compiles for itself."""
    recent_steps: float = 0.0
    recent_episodes: float = 0.0
    """Of the last seconds: what an episode takes by now, where learners live longer and longer."""

    def add(self, steps: int, episodes: int, compile_seconds: float) -> None:
        """Take in what a worker has done since it was last heard."""
        self.steps += steps
        self.done_episodes += episodes
        self.compile_seconds += compile_seconds
        self.recent_steps = 0.9 * self.recent_steps + steps
        self.recent_episodes = 0.9 * self.recent_episodes + episodes

    def _steps_left(self) -> tuple[float, float]:
        """Expected steps of the runs that are under way, and of those that are not begun.

        Runs that are over are no sample of those that are not: on tasks where one falls early, the short ones come
        first. So the runs that are under way go on as they do now, and those not begun are like all the others.
        """
        if self.finished >= self.cells:
            return 0.0, 0.0
        running = max(self.begun - self.finished, 0)
        episodes = max(self.done_episodes - self.finished_episodes, 0)
        steps = max(self.steps - self.finished_steps, 0)
        recent = self.recent_steps / self.recent_episodes if self.recent_episodes > 0.5 else 0.0
        length = max(recent, steps / episodes if episodes else 0.0)
        if not length:
            length = self.steps / max(self.done_episodes, 1)
        of_running = length * max(running * self.episodes - episodes, 0)
        known = self.finished + running
        each = (self.finished_steps + steps + of_running) / known if known else 0.0
        return of_running, each * (self.cells - known)

    @property
    def steps_left(self) -> float:
        """Expected steps of all that is not done."""
        return sum(self._steps_left())

    @property
    def steps_free(self) -> float:
        """Those of cells that no worker has."""
        return self._steps_left()[1]

    @property
    def done(self) -> float:
        """Share of its steps that are done, from 0 to 1; a program without steps has none."""
        return self.steps / (self.steps + self.steps_left) if self.steps else 0.0


def works_of(sizes: Mapping[Program, int]) -> dict[Program, Work]:
    """The programs with so many cells each, in their order, with nothing done yet."""
    return {key: Work(key.env, key.algo, cells, key.episodes, key.oracle) for key, cells in sizes.items()}


def least_to_join(env: str) -> int:
    """Cells that must be left of a program of this task for a further worker to compile it too.

    Where the host simulates, one is enough: its steps take longer than any compilation.
    """
    return 1 if find("task", env).on_host else JOIN


def seconds_left(works: Sequence[Work], jobs: int) -> float:
    """Estimated seconds until all programs are done, by `jobs` workers.

    A program that has been seen for a while costs what it did so far, in seconds a step; another one what
    `costs` says, times what programs that were seen cost of it on this machine. Compilations are reckoned apart:
    they come first, and are much shorter where the programs come from the cache. Then workers go through what is left
    as `sharing` hands it out: a program each, and those who have no more join the one with most left.
    """
    if all(work.finished >= work.cells and not work.workers for work in works):
        return 0.0
    seen = [work for work in works if _is_seen(work)]
    usual = sum(_usual(work) * work.done for work in seen)
    speed = sum(work.seconds for work in seen) / usual if usual else 1.0
    begun = [work for work in works if work.steps]
    usual_compiling = sum(costs.compiling(work.algo) * work.joined for work in begun)
    compiling = sum(work.compile_seconds for work in begun) / usual_compiling if usual_compiling else 1.0

    bound, free, to_compile = {}, {}, {}
    """Seconds of each program: of cells that workers have, of cells that nobody has, and to begin with it."""
    for index, work in enumerate(works):
        if work.finished >= work.cells:
            continue
        seconds = (
            work.seconds * (1 - work.done) / work.done
            if _is_seen(work)
            else _usual(work) * speed * (1 - work.done)
        )
        of_free = work.steps_free / work.steps_left if work.steps else 1.0
        free[index], bound[index] = seconds * of_free, seconds * (1 - of_free)
        to_compile[index] = costs.compiling(work.algo) * compiling
    at = [index for index, work in enumerate(works) for _ in range(work.workers)]
    ends = []
    """When each worker has done what it has now, and where it is."""
    for index, same in itertools.groupby(at):
        work, stepping = works[index], works[index].workers - works[index].starting
        compile_left = costs.compiling(work.algo) * compiling
        if stepping or work.steps:  # it joined another; since when is not known
            compile_left /= 2
        else:
            compile_left = max(compile_left - work.compile_seconds / work.workers, 0.0)
        for number, _ in enumerate(same):
            if number < stepping:
                ends.append((bound.get(index, 0.0) / stepping, index))
            else:
                ends.append(
                    (compile_left + (0.0 if stepping else bound.get(index, 0.0) / work.workers), index)
                )
    ends += [(0.0, -1)] * (jobs - len(ends))
    last, taken, at_first = 0.0, set(at), dict(free)
    heapq.heapify(ends)
    while ends:
        now, index = heapq.heappop(ends)
        last = max(last, now)
        if free.get(index, 0.0) > 0:  # a part of what is left of its program, in several takings
            some = min(free[index], max(free[index] / (2 * jobs), 0.05))
            free[index] -= some
            heapq.heappush(ends, (now + some, index))
            continue
        fresh = [each for each in free if each not in taken]
        least = {each: least_to_join(works[each].env) for each in free}
        cells = {
            each: (works[each].cells - works[each].begun) * seconds / at_first[each] if seconds else 0.0
            for each, seconds in free.items()
        }
        shared = [each for each in free if cells[each] >= least[each]]
        if fresh or shared:
            index = fresh[0] if fresh else max(shared, key=lambda each: cells[each])
            taken.add(index)
            heapq.heappush(ends, (now + to_compile[index], index))
    return last


def _is_seen(work: Work) -> bool:
    """Whether its own speed can be told."""
    return work.done > 0.02 and work.seconds > 0.5


def _usual(work: Work) -> float:
    return work.cells * work.episodes * costs.of_episode(work.env, work.algo, work.oracle)


@dataclass
class State:
    """What there is to show."""

    finished: int = 0
    """Cells."""
    steps: int = 0
    works: Sequence[Work] = ()
    compiling: bool = False
    """Whether a worker has been compiling for a while."""


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
    _bar: Progress | None = None
    _state: State = field(default_factory=State)
    _began: float = 0.0
    _line: float = 0.0

    def __enter__(self) -> "Bar":
        stream = self.stream or sys.stderr
        self.stream = stream
        self._began = self._line = self.clock()
        if stream.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[cells]} cells"),
                TextColumn("{task.fields[speed]}"),
                TimeElapsedColumn(),
                TextColumn("{task.fields[left]}"),
                console=Console(file=cast(TextIO, _Patient(stream))),
                refresh_per_second=4,
            )
            cells, speed, left = self._fields()
            self._task = self._bar.add_task(self.name, total=1.0, cells=cells, speed=speed, left=left)
            self._bar.start()
        else:
            self._print(
                f"{self.name}: {self.cells} cells in {self.jobs} {'process' if self.jobs == 1 else 'processes'}"
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
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
        if not any(_is_seen(work) for work in works):
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
