"""What a run begins with, as the state of its learner."""

import functools
from collections.abc import Sequence
from pathlib import Path

from gpcjax.elsewhere import path_here
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State
from gpcjax.learners.carried import carried, points_of
from gpcjax.learners.packed import unpack_learner
from gpcjax.learners.saved import load_learner
from gpcjax.sweep import sources
from gpcjax.sweep.packing import unpacked
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.source import Source


def state_of(cell: Cell, learner: Learner, rooms: Sequence[tuple[int, int]]) -> State:
    """What the learner of a cell begins with, in the smallest of these rooms that has enough.

    Args:
        cell: whose `start` is given.
        learner: of the cell.
        rooms: points of each policy and each human model, growing.

    Raises:
        UserError: it is gone, has changed, or cannot be carried over.
    """
    assert cell.start is not None
    source, state, told = _learned(cell)
    held = points_of(source, state)
    enough = (room for room in rooms if all(a <= b for a, b in zip(held, room, strict=True)))
    return carried(source, state, learner, next(enough, rooms[-1]), told)


def _learned(cell: Cell) -> tuple[Learner, State, str]:
    """A learner, its state, and what messages call it."""
    assert cell.start is not None
    contents = _contents(cell.start)
    found, folder = contents.of(cell), contents.folder
    told = f"start {folder}"
    if not found.values:
        return *_saved(cell.start), told
    try:
        return *unpack_learner(*unpacked(*contents.packed(found)), told), told
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{told}: what was kept there is damaged ({error})") from None


@functools.lru_cache(maxsize=2)
def _saved(source: Source) -> tuple[Learner, State]:
    return load_learner(Path(path_here(source.folder)))


@functools.lru_cache(maxsize=2)
def _contents(source: Source) -> sources.Contents:
    """What the folder holds, read once; the same as when the sweep was asked for."""
    contents = sources.contents_of(Path(path_here(source.folder)), "start")
    if contents.digest != source.digest:
        raise UserError(f"start {source.folder}: it has changed since the sweep was asked for")
    return contents
