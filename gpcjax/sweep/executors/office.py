"""Where the workers of several sweeps ask: they go from one desk to the next. Loads no jax."""

import heapq
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from gpcjax.errors import Failure, ForeignError, UserError
from gpcjax.sweep import stopping
from gpcjax.sweep.executors.base import Message
from gpcjax.sweep.executors.desk import Desk

STOP, AGAIN = ("stop",), ("again",)


class _Seat(NamedTuple):
    """Where a worker is: which desk, and the number that it has there."""

    desk: int
    number: int


class Errands:
    """Functions that workers call, once each, beside the sweeps of an `Office`.

    Args:
        functions: names "module:function" of this package, and the words that each is called with.
    """

    def __init__(self, functions: Sequence[tuple[str, tuple[Any, ...]]]):
        self._left = list(functions)[::-1]
        self.number = len(self._left)

    def next(self) -> Message | None:
        """The answer to a worker that has nothing to do; None if nothing is left."""
        return ("errand", *self._left.pop()) if self._left else None

    def answer(self, message: Message) -> None:
        """Takes what a worker says meanwhile.

        Raises:
            Failure: the function failed.
            UserError: it says that what a person asked for cannot be done.
        """
        match message:
            case ("failed", str() as line, str() as details):
                raise Failure(f"a worker process failed: {line}", details)
            case ("refused", str() as line):
                raise UserError(line)
            case ("theirs", *arguments):
                raise ForeignError(*arguments)


class Office:
    """Several desks whose workers go from one to the next, as if all cells were of one sweep.

    While one worker has the last cells of a sweep, the others begin with the next one; and a program that somebody
    compiles for one sweep is left alone for another as long as there is anything else to do.

    Args:
        desks: of the sweeps, in the order in which workers turn to them.
        jobs: workers there may be.
        on_turn: called with the index of a desk when the first worker turns to it.
        on_over: called with the index of a desk when all its rows and baselines have come.
        errands: what else is to be done, once a sweep is over, so that its programs are there, or at the end.
    """

    def __init__(
        self,
        desks: Sequence[Desk],
        jobs: int,
        on_turn: Callable[[int], None] = lambda desk: None,
        on_over: Callable[[int], None] = lambda desk: None,
        errands: Errands | None = None,
    ):
        self.desks, self._errands = tuple(desks), errands or Errands([])
        self.workers = min(jobs, sum(desk.workers for desk in self.desks) + self._errands.number)
        self._on_turn, self._on_over = on_turn, on_over
        self._free = [list(range(desk.workers)) for desk in self.desks]
        """Numbers that nobody has at each desk."""
        self._seats: dict[int, _Seat] = {}
        self._seated: set[int] = set()
        """Workers that have had a seat, and count what they did there."""
        self._promised: dict[int, Message] = {}
        """What workers are answered when they have put away what they did elsewhere."""
        self._new = set(range(len(self.desks)))
        """Desks that no worker has turned to."""
        self._over: set[int] = set()

    def answer(self, worker: int, message: Message) -> Message | None:
        """The answer to what this worker says; None where it asks nothing. Raises as `Desk.answer` does."""
        stopping.check()
        if message == ("ready",):
            return self._promised.pop(worker, None) or self._turn(worker)
        if message[0] == "begun":  # what it tells of the machine is for all
            for desk in self.desks:
                desk.answer(0, message)
            return None
        seat = self._seats.get(worker)
        if seat is None:
            self._errands.answer(message)
            return None
        return self.desks[seat.desk].answer(seat.number, message)

    def look(self) -> None:
        """Nothing comes, time goes on: tell of the progress. Raises as `Desk.look` does."""
        stopping.check()
        for index in sorted({seat.desk for seat in self._seats.values()}):
            self.desks[index].look()

    def _turn(self, worker: int) -> Message:
        """What a worker does next: a program that nobody has, or else anything; where it is, or at another desk."""
        for desk in self.desks:
            desk.are_there()
        seat = self._seats.get(worker)
        others = [other for holder, other in self._seats.items() if holder != worker]
        at = [self.desks[other.desk].at(other.number) for other in others]
        elsewhere = {program for program in at if program is not None}
        if self._over and (errand := self._errand(worker)) is not None:
            return errand
        for busy in (elsewhere, None):
            for place in self._places(seat):
                answer = self.desks[place.desk].turn(place.number, busy)
                if answer != STOP:
                    return answer if place == seat else self._move(worker, place, answer)
        self._leave(worker)
        for index in range(len(self.desks)):
            self._note_over(index)
        return self._errand(worker) or STOP

    def _errand(self, worker: int) -> Message | None:
        """One for a worker, which leaves its seat for it."""
        errand = self._errands.next()
        if errand is not None:
            self._leave(worker)
        return errand

    def _places(self, seat: _Seat | None) -> list[_Seat]:
        """Where a worker on this seat can ask, in turn."""
        free = [_Seat(index, numbers[0]) for index, numbers in enumerate(self._free) if numbers]
        if seat is None:
            return free
        return [seat, *(place for place in free if place.desk != seat.desk)]

    def _move(self, worker: int, place: _Seat, answer: Message) -> Message:
        """Has a worker take this seat; what it does there it is told when it has put away what it did before."""
        self._leave(worker)
        heapq.heappop(self._free[place.desk])
        self._seats[worker] = place
        if place.desk in self._new:
            self._new.discard(place.desk)
            self._on_turn(place.desk)
        if worker not in self._seated:
            self._seated.add(worker)
            return answer
        self._promised[worker] = answer
        return AGAIN

    def _leave(self, worker: int) -> None:
        """Has a worker leave its seat, if it has one."""
        seat = self._seats.pop(worker, None)
        if seat is not None:
            self.desks[seat.desk].lose(seat.number)  # it has nothing of that desk any more
            heapq.heappush(self._free[seat.desk], seat.number)
            self._note_over(seat.desk)

    def _note_over(self, index: int) -> None:
        """Tells of a desk at which nobody is any more, if it is done."""
        nobody = all(seat.desk != index for seat in self._seats.values())
        if nobody and index not in self._over and self.desks[index].done:
            self._over.add(index)
            self._on_over(index)
