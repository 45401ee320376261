"""All lessons of a process: who is due takes a step, on one clock; what can wait is done beside it.

| thread   | does                                                                                      |
|----------|-------------------------------------------------------------------------------------------|
| clock    | the steps of all, and what seats are asked for                                            |
| learning | corrections, one after the other, and sigma_h                                             |
| flushing | has recordings on the disk each second                                                    |
| papers   | has policies and rows written, by a process of its own                                    |
| door     | prepares who comes                                                                        |

Over 300 lines: one class, as what these threads share has to be seen together.

A run that is being corrected misses no step: it is caught up with as soon as that is over. Others do not wait for it.
"""

import contextlib
import functools
import gc
import math
import queue
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpcjax.engine.classroom import kind_of
from gpcjax.engine.course import credit_of
from gpcjax.engine.seated import propose_together
from gpcjax.errors import UserError
from gpcjax.gp.threads import one_thread
from gpcjax.study.kind import Kind
from gpcjax.study.seat import Seat
from gpcjax.study.standing import Run, Say, Standing
from gpcjax.sweep.lock import held
from gpcjax.teach.clerk import Clerk
from gpcjax.teach.course import Course
from gpcjax.teach.errands import Errands
from gpcjax.teach.kept import Kept
from gpcjax.teach.taught import Taught, settings_of
from gpcjax.teach.worlds import begin_together, step_together

__all__ = ["Hall", "Run", "Say", "Seat", "Standing"]

LATEST = 0.25
"""Seconds that a clock may be behind; what is beyond is let go."""

FLUSH_APART, KEEP_APART, SIGMA_APART = 1.0, 10.0, 0.2
"""Seconds between two of a kind, for each run."""

LEAVE_SECONDS = 60.0
"""Within which what a run has come to is written when it is left."""


class Hall:
    """Places for runs of some courses.

    Args:
        courses: all that is taught here; runs of these differ in their seeds alone.
        places: how many runs at most.
        say_problem: takes a line for who looks after the study, from any thread: what concerns no single run.

    Raises:
        UserError: a course that cannot be taught.
    """

    def __init__(self, courses: Sequence[Course], places: int, say_problem: Callable[[str], None]):
        self._places, self._say_problem = places, say_problem
        self._seats: set[Seat] = set()
        self._taking = threading.Lock()
        self._kinds: dict[Hashable, Kind] = {}
        self._kind_of: dict[Hashable, Kind] = {}
        for course in courses:
            self._add(course)
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._lessons: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._closing = False
        self._context = contextlib.ExitStack()
        self._clock = threading.Thread(target=self._run, daemon=True, name="clock")
        self._learning = threading.Thread(target=self._learn, daemon=True, name="learning")

    def start(self) -> None:
        """Compiles all that runs need, also what they need when dictionaries have grown, and starts."""
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda kind: kind.compile(), self._kinds.values()))
        self._context.enter_context(one_thread())
        gc.collect()
        gc.freeze()  # what was loaded stays: to look through it takes longer than a step
        self._context.callback(gc.unfreeze)
        self._clerk = Clerk()
        self._context.callback(self._clerk.close)
        self._door, self._flushing, self._papers = (Errands(self.fault) for _ in range(3))
        for thread in (self._clock, self._learning):
            thread.start()

    def close(self) -> None:
        """Writes what there is, and ends."""
        for seat in list(self._seats):
            seat.leave()
        self._door.close()
        self.does(self._close)
        self._clock.join()
        self._lessons.put(None)
        self._learning.join()
        self._papers.close()
        self._flushing.close()
        self._context.close()

    def seat(self, run: Run, say: Say) -> Seat:
        """A place for a run. It is prepared, told (`task`, `ready`, `state`, `frame`), and rests until `go_on`.

        Raises:
            UserError: all places are taken, or nothing like it is taught here.
        """
        kind = self._kind_of.get(_of(run.course))
        if kind is None:
            raise UserError(f"{run.course.algo} on {run.course.env}, with these settings, is not taught here")
        seat = Seat(self, kind, run, say)
        with self._taking:
            here = next(
                (each for each in self._seats if each.run.folder == run.folder and not each.left), None
            )
            if here is not None:
                raise UserError(f"{run.folder}: somebody is at this run, who must leave before")
            if self._taken >= self._places:
                raise UserError(f"all {self._places:,} places are taken: try again when somebody has left")
            if any(each.run.folder == run.folder for each in self._seats):  # one that is just being left
                raise UserError(f"{run.folder}: somebody sits there: try again when its place is given back")
            self._seats.add(seat)
        self._door.ask(f"{id(seat)}", lambda: self._prepare(seat))
        return seat

    def await_left(self, folder: Path) -> None:
        """Waits until all is written of the runs in a folder, whose seats were told to leave: nothing is after that.

        Raises:
            UserError: that takes too long.
        """
        with self._taking:
            here = [each for each in self._seats if each.run.folder.is_relative_to(folder)]
        for each in here:
            if not each.gone.wait(LEAVE_SECONDS):
                raise UserError(f"{each.run.folder}: it is still being written, try again")

    @property
    def free(self) -> int:
        """Places that nobody has."""
        with self._taking:
            return self._places - self._taken

    @property
    def _taken(self) -> int:
        return sum(not seat.released for seat in self._seats)

    # --- for seats

    def does(self, what: Callable[[], None]) -> None:
        """Has something done between two steps."""
        self._queue.put(what)

    def learns(self, what: Callable[[], None]) -> None:
        """Has something done by the thread of corrections."""
        self._lessons.put(what)

    def wakes(self, kind: Kind) -> None:
        """Somebody runs again."""
        if kind.due == math.inf:
            kind.due = time.perf_counter()

    def catch_up(self, seat: Seat) -> None:
        """The rest of a step at which a run was held."""
        if seat.behind and not seat.left:
            self._propose(seat.kind, [seat], 0.0)

    def keeps(self, seat: Seat, apart: float = KEEP_APART) -> None:
        """Has policy and rows written as they are."""
        self._ask("keep", seat, lambda: self._keep(seat), apart)

    def completes(self, seat: Seat) -> None:
        """Has all written, and tells so."""

        def write() -> None:
            if self.writes(seat) and self._keep(seat):
                seat.tell_over()

        self._ask("over", seat, write)

    def leaves(self, seat: Seat) -> None:
        """Has all written, and gives the place back."""
        if seat.left:
            return
        seat.rests("left")
        seat.left = True

        def write() -> None:
            sat, kept = seat.taught is not None, None
            try:
                if seat.taught is not None:
                    self.writes(seat)
                    kept = self._kept(seat, seat.taught)
                with seat.lock, self._taking:
                    if seat.taught is not None:
                        seat.kind.release(seat.taught)
                    seat.taught, seat.released = None, True
                if kept is not None:  # which takes a while: the place is free before
                    self._clerk.write(kept)
            finally:
                with self._taking:
                    seat.taught, seat.released = None, True
                    self._seats.discard(seat)
                if sat:
                    seat.held.close()
                seat.gone.set()

        self._ask("leave", seat, write)

    def writes(self, seat: Seat) -> bool:
        """Has the recording on the disk; False, and a problem, if that cannot be."""
        try:
            seat.session.flush()
        except UserError as error:
            text = str(error)
            self.does(lambda: seat.problem(text))
            return False
        return True

    def fault(self, error: BaseException) -> None:
        """Tells what should not have happened."""
        self._say_problem(self._words(error))

    @staticmethod
    def _words(error: BaseException) -> str:
        told = isinstance(error, UserError | OSError)
        return str(error) if told else f"a fault of gpcjax: {type(error).__name__}: {error}"

    # --- the door, and papers

    def _add(self, course: Course) -> None:
        learner = Kind.learner_of(course)
        key = (
            course.env,
            kind_of(learner, credit_of(settings_of(course))),
            dict(course.settings).get("credit"),
        )
        if key not in self._kinds:
            self._kinds[key] = Kind(course, self._places)
        self._kind_of[_of(course)] = self._kinds[key]

    def _prepare(self, seat: Seat) -> None:
        if seat.left:
            return
        with self._taking:
            before = [each for each in self._seats if each is not seat and each.run.folder == seat.run.folder]
        for each in before:  # who was there is leaving: its last steps are being written
            each.gone.wait()
        try:
            seat.run.folder.mkdir(parents=True, exist_ok=True)
            seat.held.enter_context(held(seat.run.folder))
            taught = seat.kind.prepare(seat.run)
        except Exception as error:
            seat.held.close()
            text = self._words(error)
            self.does(lambda: seat.problem(text))
            return
        self.does(lambda: self._sit(seat, taught))

    def _sit(self, seat: Seat, taught: Taught) -> None:
        if seat.left:
            seat.kind.release(taught)
            seat.held.close()
            return
        seat.sits(taught)
        self._flush(seat)

    def _ask(self, name: str, seat: Seat, do: Callable[[], object], apart: float = 0.0) -> None:
        def done() -> None:
            do()

        self._papers.ask(f"{name} {id(seat)}", done, apart)

    def _flush(self, seat: Seat) -> None:
        def flush() -> None:
            if seat.taught is not None and not seat.left:
                try:
                    self.writes(seat)
                finally:  # a fault at one time is none for all that follow
                    self._flush(seat)

        self._flushing.ask(f"{id(seat)}", flush, FLUSH_APART)

    def _keep(self, seat: Seat) -> bool:
        taught = seat.taught
        if taught is None:
            return False
        try:
            self._clerk.write(self._kept(seat, taught))
        except Exception as error:
            text = self._words(error)
            self.does(lambda: seat.problem(text))
            return False
        return True

    @staticmethod
    def _kept(seat: Seat, taught: Taught) -> Kept:
        """What is written of a run, as it is now."""
        with seat.lock:
            kept = taught.kept()
        seat.catch_up()
        return kept(taught.session)

    # --- learning

    def _learn(self) -> None:
        while (do := self._lessons.get()) is not None:
            self._guarded(do)

    def _guarded(self, do: Callable[[], None]) -> None:
        try:
            do()
        except Exception as error:
            self.fault(error)

    # --- the clock

    def _run(self) -> None:
        while not self._closing:
            kind = min(self._kinds.values(), key=lambda kind: kind.due)
            wait = kind.due - time.perf_counter()
            if wait <= 0:
                self._guarded(functools.partial(self._tick, kind, -wait))
                continue
            with contextlib.suppress(queue.Empty):
                self._guarded(self._queue.get(timeout=None if wait == math.inf else wait))

    def _close(self) -> None:
        self._closing = True

    def _tick(self, kind: Kind, behind: float) -> None:
        running = [seat for seat in self._seats_of(kind) if seat.runs and not seat.behind]
        kind.due += kind.seconds + (behind if behind > LATEST else 0.0)
        if running:
            try:
                self._steps(kind, running, 1000 * behind)
            except Exception as error:  # of ours: all of this kind would meet it at each step
                self.fault(error)
                for seat in running:
                    seat.breaks(self._words(error))
        elif not any(seat.runs for seat in self._seats_of(kind)):
            kind.due = math.inf

    def _seats_of(self, kind: Kind) -> Iterable[Seat]:
        with self._taking:
            return [seat for seat in self._seats if seat.kind is kind]

    def _steps(self, kind: Kind, seats: Sequence[Seat], late: float) -> None:
        """One step of each of these: of their tasks, then of their policies."""
        moves = step_together(
            kind.worlds, [seat.world for seat in seats], [seat.session.latest[1] for seat in seats]
        )
        going, beginning = [], []
        for seat, moved in zip(seats, moves, strict=True):
            try:
                if isinstance(moved, UserError):
                    raise moved
                seat.moves(moved)
            except UserError as error:
                seat.breaks(str(error))
                continue
            going.append(seat)
            if seat.goes_on_after:
                beginning.append(seat)
        if beginning:
            worlds, episodes = [seat.world for seat in beginning], [seat.episode + 1 for seat in beginning]
            for seat, obs in zip(beginning, begin_together(kind.worlds, worlds, episodes), strict=True):
                if isinstance(obs, UserError):
                    seat.breaks(str(obs))
                    going.remove(seat)
                else:
                    seat.next = obs
        self._propose(kind, going, late)

    def _propose(self, kind: Kind, seats: Sequence[Seat], late: float) -> None:
        """What follows from where the tasks of these are, but for those that are held: they are caught up with."""
        free = [seat for seat in seats if seat.is_taken_by_clock()]
        try:
            for seat in free:
                seat.closes()
            going = [seat for seat in free if seat.next is not None]
            raised = (
                propose_together([seat.session for seat in going], np.array([seat.next for seat in going]))
                if going
                else []
            )
            for seat, error in zip(going, raised, strict=True):
                seat.proposes(error)
        finally:
            for seat in free:
                seat.lock.release()
        now = time.perf_counter()
        for seat in free:
            seat.tells_step(late)
            if seat.over:
                self.completes(seat)
            elif seat.run.cue and kind.prior is not None and now - seat.sigma_asked > SIGMA_APART:
                seat.sigma_asked = now
                self.learns(seat.measure_sigma)


def _of(course: Course) -> Hashable:
    """All but the seed."""
    return replace(course, seed=0)
