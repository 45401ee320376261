"""A worker's checkpoints: it saves the runs that it has every now and then, and goes on with saved ones.

See `gpcjax.sweep.checkpoints` for the folders, and for which runs go on from where.
"""

import itertools
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.engine.pool import Pool, Resumed
from gpcjax.engine.snapshots import NotResumed, Snapshot, pack, unpack
from gpcjax.errors import UserError
from gpcjax.policies.folder import LARGEST_ARRAY, read_arrays, read_card, write_folder
from gpcjax.sweep.checkpoints import KIND, Place, runs_as_json, runs_of
from gpcjax.sweep.keeping import KeptRow
from gpcjax.sweep.packing import compressed, expanded
from gpcjax.sweep.plan import Cell

SHARE = 0.02
"""Of its time that a worker may spend on checkpoints: large ones are written less often."""

KEPT = "kept"
"""Name of the array that says what is kept; those of its pieces begin with it."""

PIECE = LARGEST_ARRAY // 2
"""Bytes of what is kept that are one array."""

Kept = dict[Cell, list[KeptRow]]
"""What is to be kept of runs that are under way, so far."""

_numbers = itertools.count()


class Checkpointer:
    """The checkpoints that one worker makes of one pool.

    Args:
        folder: `OUT/checkpoints`; None where nothing is saved.
        seconds: between two of them, at least; 0 for never.
        agree: what runs must agree in to go on from them (`gpcjax.sweep.checkpoints.told`).
    """

    def __init__(self, folder: Path | None, seconds: float, agree: Mapping[str, Any]):
        self._folder, self._seconds, self._agree = folder, seconds, agree
        self._written: Path | None = None
        self._since = time.monotonic()
        self._took = 0.0

    def look(self, pool: Pool, kept: Kept) -> None:
        """Saves all runs of the pool if it is time, in the place of the ones before.

        Raises:
            UserError: they cannot be written.
        """
        wait = max(self._seconds, self._took / SHARE)
        if self._folder is None or not self._seconds or time.monotonic() - self._since < wait:
            return
        began = time.monotonic()
        try:
            self._save(self._folder, pool, kept)
        finally:  # where nothing can be written, too: it is tried again when it is time again
            self._since = time.monotonic()
            self._took = self._since - began

    def _save(self, folder: Path, pool: Pool, kept: Kept) -> None:
        if not folder.parent.is_dir():  # to make it anew would hide from the sweep that its rows are gone
            raise UserError(f"{folder.parent}: the folder was removed or moved while it was in use")
        snapshots = pool.snapshot()
        if snapshots:
            card, arrays = _packed(snapshots, kept)
            path = folder / f"{time.time_ns()}-{os.getpid()}-{next(_numbers)}"
            write_folder(path, {"kind": KIND, **self._agree, **card}, arrays)
            self._forget()
            self._written = path

    def close(self) -> str | None:
        """The name of the last checkpoint, which helps nobody once all rows of the pool are stored; None without one.

        It stays until then: whoever stores the rows removes it.
        """
        written, self._written = self._written, None
        return None if written is None else written.name

    def _forget(self) -> None:
        if self._written is not None:
            shutil.rmtree(self._written, ignore_errors=True)
            self._written = None


class Saved:
    """Runs that were under way, by their cells.

    Args:
        folder: `OUT/checkpoints`.
        say: takes a line for the person.
    """

    def __init__(self, folder: Path | None, say: Callable[[str], None]):
        self._folder, self._say = folder, say
        self._places: dict[Cell, Place] = {}
        self._read: dict[str, tuple[list[Snapshot], list[list[KeptRow]]]] = {}

    def add(self, places: Mapping[Cell, Place]) -> None:
        """Where some of them are."""
        self._places |= places

    def go_on(self, cell: Cell, pool: Pool) -> tuple[Resumed, list[KeptRow]] | None:
        """The run of a cell, for `Pool.run`, and what had been kept of it; None where it begins anew."""
        place = self._places.get(cell)
        if place is None or self._folder is None:
            return None
        try:
            if place.folder not in self._read:
                self._read[place.folder] = _unpacked(self._folder / place.folder, pool)
            snapshots, kept = self._read[place.folder]
            return pool.resume(snapshots[place.index]), kept[place.index]
        except (NotResumed, UserError, KeyError, IndexError, TypeError, ValueError) as error:
            text = next(iter(str(error).splitlines()), type(error).__name__)
            self._say(f"a run of {cell.algo} with seed {cell.seed} begins anew ({text})")
            return None


def _packed(snapshots: Iterable[Snapshot], kept: Kept) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Card and arrays. The card stays small, however many runs there are and however much is kept of each."""
    snapshots = list(snapshots)
    arrays, lanes = pack(snapshots)
    runs = [
        (snapshot.name, int(np.asarray(snapshot.lane.rows.length).sum()) + int(snapshot.lane.env.time))
        for snapshot in snapshots
    ]
    return {"runs": runs_as_json(runs), "lanes": lanes}, arrays | _kept_arrays(
        [kept.get(snapshot.name, []) for snapshot in snapshots]
    )


def _kept_arrays(kept: Sequence[Sequence[KeptRow]]) -> dict[str, np.ndarray]:
    """What is kept of each run as arrays of bytes: what the rows are, then their arrays, one behind the other."""
    every = [row for rows in kept for row in rows]
    if not every:  # a checkpoint takes no array without entries
        return {}
    cards = {card: place for place, card in enumerate(dict.fromkeys(row.card for row in every))}
    rows = [
        [[row.episode, row.returns, row.kind, cards[row.card], len(row.arrays)] for row in rows]
        for rows in kept
    ]
    content = np.frombuffer(b"".join(row.arrays for row in every), np.uint8)
    pieces = [content[first : first + PIECE] for first in range(0, len(content), PIECE)]
    told = np.frombuffer(compressed({"cards": list(cards), "rows": rows}), np.uint8)
    return {KEPT: told, **{f"{KEPT}.{place}": piece for place, piece in enumerate(pieces)}}


def _kept_rows(arrays: dict[str, np.ndarray], runs: int) -> list[list[KeptRow]]:
    """What `_kept_arrays` was given, out of all arrays, which are without it then. Raises KeyError or ValueError."""
    told = arrays.pop(KEPT, None)
    if told is None:
        return [[] for _ in range(runs)]
    names = [name for name in arrays if name.startswith(f"{KEPT}.")]
    pieces = [arrays.pop(f"{KEPT}.{place}") for place in range(len(names))]
    content, first, found = b"".join(piece.tobytes() for piece in pieces), 0, []
    known = expanded(told.tobytes())
    for rows in known["rows"]:
        found.append([])
        for episode, returns, kind, card, size in rows:
            row = KeptRow(episode, returns, kind, known["cards"][card], content[first : first + size])
            found[-1].append(row)
            first += size
    if first != len(content) or len(found) != runs:
        raise ValueError("what is kept is not what the card says")
    return found


def _unpacked(path: Path, pool: Pool) -> tuple[list[Snapshot], list[list[KeptRow]]]:
    """Raises UserError, NotResumed, KeyError, IndexError, TypeError or ValueError."""
    card = read_card(path, KIND)
    arrays = read_arrays(path, card, KIND)
    cells = [cell for cell, _ in runs_of(card)]
    rows = _kept_rows(arrays, len(cells))
    return unpack(arrays, card["lanes"], cells, pool.shapes), rows
