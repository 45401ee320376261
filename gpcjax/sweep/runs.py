"""The runs of one program in a worker: where they come from, what becomes of them, what is saved of them meanwhile."""

import dataclasses
from collections import deque
from pathlib import Path

import numpy as np

from gpcjax.engine.lanes import Lane, Start
from gpcjax.engine.pool import Finished, Kept, Pool, Resumed
from gpcjax.errors import UserError
from gpcjax.learners.base import Status
from gpcjax.learners.packed import compact
from gpcjax.policies.saved import has_format, pack_controller
from gpcjax.sweep.build import pack_learned, start_of
from gpcjax.sweep.checkpointing import Checkpointer, Saved
from gpcjax.sweep.executors.base import Orders, Say
from gpcjax.sweep.keeping import KeptRow, What
from gpcjax.sweep.packing import packed
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.rehearsal import check_alike
from gpcjax.sweep.rows import CellRows


class Runs:
    """What a pool asks for and gives, between it and the desk.

    Args:
        pool: of the program.
        orders: what is to be done beside the rows.
        say: takes a message to the desk and gives its answer.
    """

    def __init__(self, pool: Pool, orders: Orders, say: Say):
        self._pool, self._keeping, self._say = pool, orders.keeping, say
        self._cells: deque[Cell] = deque()
        folder = None if orders.checkpoints is None else Path(orders.checkpoints)
        self._saved = Saved(folder, self._note)
        self._checkpointer = Checkpointer(folder, orders.seconds, orders.agree)
        self._told = False
        """Whether the person knows that runs cannot be saved."""
        self._kept: dict[Cell, list[KeptRow]] = {}

    def next_start(self) -> Start | Resumed | None:
        """The next run, which may go on from where it was saved; None if there is no more."""
        if not self._cells:
            answer = self._say(("next",))
            assert answer is not None
            self._cells.extend(answer[1])
            for places in answer[2:]:
                self._saved.add(places)
        if not self._cells:
            return None
        cell = self._cells.popleft()
        going_on = self._saved.go_on(cell, self._pool)
        if going_on is None:
            start = start_of(cell)
            check_alike(cell, start, self._pool.template)
            return start
        run, self._kept[cell] = going_on
        return run

    def keep(self, each: Kept) -> None:
        """Takes what a run had learned on its way."""
        assert self._keeping is not None
        rows = self._kept.setdefault(each.name, [])
        if self._keeping.best:  # each that comes is better than the one before
            rows.clear()
        rows.append(kept_row(self._keeping.what, each.episode, each.name, each.lane))

    def deliver(self, finished: Finished) -> None:
        """Hands in a run that ended."""
        rows, learned = rows_of(finished.name, finished.lane), self._kept.pop(finished.name, [])
        if self._keeping is not None and len(rows.episode):
            last = len(rows.episode)
            if not learned or not (self._keeping.best or learned[-1].episode == last):
                learned.append(kept_row(self._keeping.what, last, finished.name, finished.lane))
        self._say(("rows", dataclasses.replace(rows, kept=tuple(learned))))

    def save(self) -> None:
        """Saves the runs that are under way, if it is time."""
        try:
            self._checkpointer.look(self._pool, self._kept)
        except UserError as error:
            if not self._told:  # the reason is the same until somebody sees to it
                self._note(f"no checkpoint: {error}")
            self._told = True

    def close(self) -> None:
        """All runs have ended, and are handed in."""
        name = self._checkpointer.close()
        if name is not None:
            self._say(("over", name))

    def _note(self, line: str) -> None:
        self._say(("note", line))


def rows_of(cell: Cell, lane: Lane) -> CellRows:
    """What is stored of a finished lane: an episode that never began has no row.

    One that was over before its first step, as its start or the action there was no number, has a row, with NaN.
    """
    began = np.flatnonzero((lane.rows.length > 0) | np.isnan(lane.rows.returns))
    status = [Status.OK.label] * len(began)
    if began.size:
        status[-1] = Status(int(lane.status)).label
    measured = {name: value for name, value in vars(lane.rows).items() if name != "own"}
    episodes, own = (
        {name: np.asarray(value)[began] for name, value in values.items()}
        for values in (measured, lane.rows.own)
    )
    logged = int(lane.log.count)
    corrections = {
        name: np.asarray(getattr(lane.log, name))[:logged] for name in ("moments", "values", "outcome")
    }
    return CellRows(
        cell=cell, episode=began + 1, status=status, episodes=episodes, corrections=corrections, own=own
    )


def kept_row(what: What, episode: int, cell: Cell, lane: Lane) -> KeptRow:
    """What the learner of a cell had learned after this many episodes.

    A policy without a form of its own, as a person's own learner may have, is kept as the state that it follows from.
    """
    if what == "policies" and has_format(lane.controller):
        kind, (card, arrays) = "policy", pack_controller(lane.controller)
    else:
        kind = "state"
        card, arrays = pack_learned(cell, lane.learner, compact(lane.learner, lane.state))
    text, content = packed(card, arrays)
    return KeptRow(episode, float(np.asarray(lane.rows.returns)[episode - 1]), kind, text, content)
