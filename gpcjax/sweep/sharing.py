"""Which worker gets which cells, and in what order. Pure: no process, no clock, no jax."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping

from gpcjax.registry import find
from gpcjax.sweep.estimate import least_to_join, works_of
from gpcjax.sweep.experience import Cost
from gpcjax.sweep.plan import Cell, Program, program_of

Before = Callable[[Iterable[Program]], Mapping[Program, Cost]]
"""Tells what programs took when they ran here the last time, of those that are known."""

BATCH = 16
"""Cells handed out at once, at most."""


class Sharing:
    """The cells that are not done, by program, and who has which of them.

    A worker compiles a program, then takes cells of it, a few at a time, until there are none: first those of the first
    seed, so that the runs which are over, of which tables are made and times reckoned, are a sample of all. Programs go
    out in their order, each to a worker of its own; a worker that finds none left joins the one with most cells to do,
    where they are worth compiling it once more.

    Args:
        cells: what is to run.
        workers: how many there are; they are named by their numbers from 0 on.
        before: tells what programs took the last time.
    """

    def __init__(self, cells: Iterable[Cell], workers: int, before: Before = lambda programs: {}):
        self._left: dict[Program, deque[Cell]] = {}
        for cell in sorted(cells, key=lambda cell: cell.seed):
            self._left.setdefault(program_of(cell), deque()).append(cell)
        self._sizes = {program: len(cells) for program, cells in self._left.items()}
        self._workers = workers
        self._at: dict[int, Program] = {}
        """The program that each worker has."""
        self._given: dict[int, int] = {}
        """Cells of this program that it has been given."""
        self._out: dict[Cell, int] = {}
        """Cells that are not back yet, and who has them."""
        self._stepping: set[int] = set()
        """Workers that have made a step in their programs."""
        self.works = works_of(self._sizes, before(self._sizes))
        """The state of each program; what is reckoned by time is filled in by who keeps the time."""

    @property
    def left(self) -> int:
        """Cells whose rows have not come."""
        return len(self._out) + sum(map(len, self._left.values()))

    def at(self, worker: int) -> Program | None:
        """The program that this worker has."""
        return self._at.get(worker)

    def next_program(self, worker: int) -> Cell | None:
        """A cell of the program that this worker turns to, as an example; None if there is nothing for it."""
        self.leave(worker)
        taken = set(self._at.values())
        free = [key for key, cells in self._left.items() if cells and key not in taken]
        shared = [key for key, cells in self._left.items() if len(cells) >= least_to_join(key.env)]
        if not free and not shared:
            return None
        program = free[0] if free else max(shared, key=lambda key: len(self._left[key]))
        self._at[worker], self._given[worker] = program, 0
        work = self.works[program]
        work.workers += 1
        work.starting += 1
        work.joined += 1
        return self._left[program][0]

    def next_cells(self, worker: int) -> list[Cell]:
        """The next cells of the program of this worker, none if there are no more."""
        program = self._at[worker]
        cells = self._left[program]
        share = min(max(1, min(BATCH, len(cells) // (4 * self._workers))), len(cells))
        if find("task", program.env).on_host:
            # Runs of minutes: a worker leaves the others their part, even where its first block could take it all.
            share = min(share, -(-self._sizes[program] // self._workers) - self._given[worker])
        self._given[worker] += share
        self.works[program].begun += share
        taken = [cells.popleft() for _ in range(share)]
        self._out |= dict.fromkeys(taken, worker)
        return taken

    def steps(self, worker: int) -> None:
        """Note that this worker has made a step in its program: it has compiled it."""
        if worker in self._at and worker not in self._stepping:
            self._stepping.add(worker)
            self.works[self._at[worker]].starting -= 1

    def back(self, cell: Cell) -> bool:
        """Note that the rows of this cell have come; False if nobody has it, as they came before."""
        return self._out.pop(cell, None) is not None

    def leave(self, worker: int) -> None:
        """Note that this worker is no longer at its program."""
        program = self._at.pop(worker, None)
        if program is not None:
            self.works[program].paces.leave(worker)
            self.works[program].workers -= 1
            self.works[program].starting -= worker not in self._stepping
        self._stepping.discard(worker)

    def lose(self, worker: int) -> list[Cell]:
        """Note that this worker is gone: its cells, which are given, go to others, first of all."""
        self.leave(worker)
        lost = [cell for cell, holder in self._out.items() if holder == worker]
        for cell in reversed(lost):
            del self._out[cell]
            program = program_of(cell)
            self._left[program].appendleft(cell)
            self.works[program].begun -= 1
        return lost
