"""All lessons of a process: who is due takes a step, on one clock; what can wait is done beside it.

| thread   | does                                                                                      |
|----------|-------------------------------------------------------------------------------------------|
| clock    | the steps of all, and what seats are asked for                                            |
| learning | corrections, one after the other, and sigma_h                                             |
| papers   | has recordings on the disk each second, writes policies and rows                          |
| door     | prepares who comes                                                                        |

A run that is being corrected misses no step: it is caught up with as soon as that is over. Others do not wait for it.
"""

import contextlib
import gc
import math
import queue
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from gpcjax.engine.classroom import kind_of
from gpcjax.engine.session import credit_of, propose_together
from gpcjax.errors import UserError
from gpcjax.gp.threads import one_thread
from gpcjax.study.kind import Kind
from gpcjax.study.seat import Run, Say, Seat, Standing
from gpcjax.sweep.lock import held
from gpcjax.teach.course import Course
from gpcjax.teach.errands import Errands
from gpcjax.teach.taught import Taught, settings_of
from gpcjax.teach.worlds import begin_together, step_together

__all__ = ["Hall", "Run", "Say", "Seat", "Standing"]

LATEST = 0.25
"""Seconds that a clock may be behind; what is beyond is let go."""

FLUSH_APART, KEEP_APART, SIGMA_APART = 1.0, 10.0, 0.2
"""Seconds between two of a kind, for each run."""


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
        self._papers, self._door = Errands(self.fault), Errands(self.fault)
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
            here = next((each for each in self._seats if each.run.folder == run.folder and not each.left), None)
            if here is not None:
                raise UserError(f"{run.folder}: somebody is at this run, who must leave before")
            if len(self._seats) >= self._places:
                raise UserError(f"all {self._places:,} places are taken: try again when somebody has left")
            if any(each.run.folder == run.folder for each in self._seats):  # one that is just being left
                raise UserError(f"{run.folder}: somebody sits there: try again when its place is given back")
            self._seats.add(seat)
        self._door.ask(f"{id(seat)}", lambda: self._prepare(seat))
        return seat

    @property
    def free(self) -> int:
        """Places that nobody has."""
        with self._taking:
            return self._places - len(self._seats)

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
        """The step that a run has missed."""
        if seat.behind and seat.runs:
            self._steps(seat.kind, [seat], 0.0)

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
            try:
                if seat.taught is not None:
                    self.writes(seat)
                    self._keep(seat)
            finally:
                with seat.lock, self._taking:
                    if seat.taught is not None:
                        seat.kind.release(seat.taught)
                        seat.held.close()
                    seat.taught = None
                    self._seats.discard(seat)
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
        key = course.env, kind_of(learner, credit_of(settings_of(course))), dict(course.settings).get("credit")
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
        self._papers.ask(f"{name} {id(seat)}", lambda: do() and None, apart)

    def _flush(self, seat: Seat) -> None:
        def flush() -> None:
            if seat.taught is not None and not seat.left:
                self.writes(seat)
                self._flush(seat)

        self._ask("flush", seat, flush, FLUSH_APART)

    def _keep(self, seat: Seat) -> bool:
        taught = seat.taught
        if taught is None:
            return False
        with seat.lock:
            write = taught.keep()
        seat.catch_up()
        try:
            write()
        except Exception as error:
            text = self._words(error)
            self.does(lambda: seat.problem(text))
            return False
        return True

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
                self._guarded(lambda: self._tick(kind, -wait))
                continue
            with contextlib.suppress(queue.Empty):
                self._guarded(self._queue.get(timeout=None if wait == math.inf else wait))

    def _close(self) -> None:
        self._closing = True

    def _tick(self, kind: Kind, behind: float) -> None:
        running = [seat for seat in self._seats_of(kind) if seat.runs]
        kind.due += kind.seconds + (behind if behind > LATEST else 0.0)
        if running:
            try:
                self._steps(kind, running, 1000 * behind)
            except Exception as error:  # of ours: all of this kind would meet it at each step
                self.fault(error)
                for seat in running:
                    seat.breaks(self._words(error))
        else:
            kind.due = math.inf

    def _seats_of(self, kind: Kind) -> Iterable[Seat]:
        with self._taking:
            return [seat for seat in self._seats if seat.kind is kind]

    def _steps(self, kind: Kind, due: Sequence[Seat], late: float) -> None:
        """One step of each of these, but for those that are held: they are caught up with."""
        free: list[Seat] = []
        for seat in due:
            seat.behind = not seat.lock.acquire(blocking=False)
            if not seat.behind:
                free.append(seat)
        try:
            if free:
                self._step(kind, free, late)
        finally:
            for seat in free:
                seat.lock.release()

    def _step(self, kind: Kind, seats: Sequence[Seat], late: float) -> None:
        actions = [seat.session.latest[1] for seat in seats]
        going: list[tuple[Seat, np.ndarray]] = []
        beginning: list[Seat] = []
        moves = step_together(kind.worlds, [seat.world for seat in seats], actions)
        for seat, moved in zip(seats, moves, strict=True):
            if isinstance(moved, UserError):
                seat.breaks(str(moved))
                continue
            seat.moves(moved)
            why = "over" if moved.over else "time" if seat.time_is_up() else None
            if why is None:
                going.append((seat, moved.obs))
            elif self._goes_on_after(seat, why):
                beginning.append(seat)
        if beginning:
            worlds, episodes = [seat.world for seat in beginning], [seat.episode for seat in beginning]
            for seat, obs in zip(beginning, begin_together(kind.worlds, worlds, episodes), strict=True):
                if isinstance(obs, UserError):
                    seat.breaks(str(obs))
                else:
                    going.append((seat, obs))
        if not going:
            return
        raised = propose_together([seat.session for seat, _ in going], np.array([obs for _, obs in going]))
        now = time.perf_counter()
        for (seat, _), error in zip(going, raised, strict=True):
            if error is not None:
                seat.breaks(str(error))
                continue
            seat.stepped(late)
            if seat.run.cue and kind.prior is not None and now - seat.sigma_asked > SIGMA_APART:
                seat.sigma_asked = now
                self.learns(seat.measure_sigma)

    def _goes_on_after(self, seat: Seat, why: str) -> bool:
        """Ends an episode: whether another one follows."""
        seat.ends(why)
        if not seat.over:
            self.keeps(seat)
            return True
        self.completes(seat)
        return False


def _of(course: Course) -> Hashable:
    """All but the seed."""
    return course.env, course.algo, course.settings
