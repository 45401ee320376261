"""Which worker gets which cells, and in what order. Pure: no process, no clock, no jax."""

import itertools
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping

from gpcjax.registry import find
from gpcjax.sweep.estimate import least_to_join
from gpcjax.sweep.experience import Cost
from gpcjax.sweep.plan import Cell, Program, program_of
from gpcjax.sweep.works import works_of

Before = Callable[[Iterable[Program]], Mapping[Program, Cost]]
"""Tells what programs took when they ran here the last time, of those that are known."""

BATCH = 16
"""Cells handed out at once, at most."""


class Sharing:
    """The cells that are not done, by program, and who has which of them.

    A worker compiles a program, then takes cells of it, a few at a time, until there are none: first those of the first
    seed, so that the runs which are over, of which tables are made and times reckoned, are a sample of all. Programs go
    out one after the other, those first that usually take longest, each to a worker of its own: in the end nobody waits
    for one that was begun late. A worker that finds none left joins the one with most cells to do, where that saves
    more than it costs.

    Where machines differ, one that has nothing left takes copies of what another one has had for longest: nobody waits
    for a slow one, or for one that hangs. The rows that come first count.

    Args:
        cells: what is to run.
        workers: how many there are; they are named by their numbers from 0 on.
        before: tells what programs took the last time.
    """

    def __init__(self, cells: Iterable[Cell], workers: int, before: Before = lambda programs: {}):
        left: dict[Program, deque[Cell]] = {}
        for cell in sorted(cells, key=lambda cell: cell.seed):
            left.setdefault(program_of(cell), deque()).append(cell)
        self._sizes = {program: len(cells) for program, cells in left.items()}
        works = works_of(self._sizes, before(self._sizes))
        longest_first = sorted(works, key=lambda program: -works[program].usual_whole)
        self._left = {program: left[program] for program in longest_first}
        self._workers = workers
        self._at: dict[int, Program] = {}
        """The program that each worker has."""
        self._given: dict[int, int] = {}
        """Cells of this program that it has been given."""
        self._out: dict[Cell, list[int]] = {}
        """Cells that are not back yet, the oldest first, and who has them: two where one has a copy."""
        self._copies: dict[int, deque[Cell]] = {}
        """Of what a worker is to take copies, in the place of cells that nobody has."""
        self._late: dict[int, set[Cell]] = {}
        """Cells that a worker still has, and another one has brought back."""
        self._stepping: set[int] = set()
        """Workers that have made a step in their programs."""
        self.works = {program: works[program] for program in longest_first}
        """The state of each program, in the order in which they go out; what is reckoned by time is filled in by who
        keeps the time."""

    @property
    def left(self) -> int:
        """Cells whose rows have not come."""
        return len(self._out) + sum(map(len, self._left.values()))

    def at(self, worker: int) -> Program | None:
        """The program that this worker has."""
        return self._at.get(worker)

    def next_program(self, worker: int, elsewhere: Collection[Program] | None = None) -> Cell | None:
        """A cell of the program that this worker turns to, as an example; None if there is nothing for it.

        With `elsewhere`, programs that workers have for the cells of others, it is one that nobody has, here or there.
        """
        self.leave(worker)
        taken = set(self._at.values())
        free = [key for key, cells in self._left.items() if cells and key not in taken]
        if elsewhere is not None:
            free = [key for key in free if key not in elsewhere]
        shared = [key for key, cells in self._left.items() if len(cells) >= least_to_join(self.works[key])]
        if not free and (elsewhere is not None or not shared):
            return None
        program = free[0] if free else max(shared, key=lambda key: len(self._left[key]))
        self._turn(worker, program)
        return self._left[program][0]

    def next_copy(self, worker: int) -> Cell | None:
        """The same, where this worker finds nothing left: of what another one has; None if all has a copy by now.

        `next_cells` gives it these cells then: those of the program, and the worker, whose turn was longest ago.
        """
        self.leave(worker)
        alone = {cell: holders[0] for cell, holders in self._out.items() if len(holders) == 1}
        alone = {cell: holder for cell, holder in alone.items() if holder != worker}
        if not alone:
            return None
        oldest, slow = next(iter(alone.items()))
        program = program_of(oldest)
        same = (cell for cell, holder in alone.items() if holder == slow and program_of(cell) == program)
        self._copies[worker] = deque(itertools.islice(same, BATCH))
        self._turn(worker, program)
        return oldest

    def _turn(self, worker: int, program: Program) -> None:
        """Note that this worker turns to a program."""
        self._at[worker], self._given[worker] = program, 0
        work = self.works[program]
        work.workers += 1
        work.starting += 1
        work.joined += 1

    def next_cells(self, worker: int) -> list[Cell]:
        """The next cells of the program of this worker, none if there are no more."""
        if worker in self._copies:
            taken = [cell for cell in self._copies[worker] if cell in self._out]  # some may be back by now
            self._copies[worker].clear()
            for cell in taken:
                self._out[cell].append(worker)
            return taken
        program = self._at[worker]
        cells = self._left[program]
        share = min(max(1, min(BATCH, len(cells) // (4 * self._workers))), len(cells))
        if find("task", program.env).on_host:
            # Runs of minutes: a worker leaves the others their part, even where its first block could take it all.
            share = min(share, -(-self._sizes[program] // self._workers) - self._given[worker])
        self._given[worker] += share
        self.works[program].begun += share
        taken = [cells.popleft() for _ in range(share)]
        self._out |= {cell: [worker] for cell in taken}
        return taken

    def steps(self, worker: int) -> None:
        """Note that this worker has made a step in its program: it has compiled it."""
        if worker in self._at and worker not in self._stepping:
            self._stepping.add(worker)
            self.works[self._at[worker]].starting -= 1

    def back(self, worker: int, cell: Cell) -> bool:
        """Note that the rows of this cell have come; False if those of a copy came before.

        Raises:
            KeyError: this worker has no such cell.
        """
        if worker in self._out.get(cell, ()):
            for other in self._out.pop(cell):
                if other != worker:
                    self._late.setdefault(other, set()).add(cell)
            return True
        self._late.get(worker, set()).remove(cell)
        return False

    def is_late(self, worker: int) -> bool:
        """Whether this worker still has cells that another one has brought back."""
        return bool(self._late.get(worker))

    def leave(self, worker: int) -> None:
        """Note that this worker is no longer at its program."""
        self._copies.pop(worker, None)
        program = self._at.pop(worker, None)
        if program is not None:
            self.works[program].paces.leave(worker)
            self.works[program].workers -= 1
            self.works[program].starting -= worker not in self._stepping
        self._stepping.discard(worker)

    def lose(self, worker: int) -> list[Cell]:
        """Note that this worker is gone: its cells, which are given, go to others, first of all.

        A cell of which another one has a copy stays with that.
        """
        self.leave(worker)
        self._late.pop(worker, None)
        held = [cell for cell, holders in self._out.items() if worker in holders]
        for cell in held:
            self._out[cell].remove(worker)
        lost = [cell for cell in held if not self._out[cell]]
        for cell in reversed(lost):
            del self._out[cell]
            program = program_of(cell)
            self._left[program].appendleft(cell)
            self.works[program].begun -= 1
        return lost
