"""A worker's checkpoints: it saves the runs that it has every now and then, and goes on with saved ones.

See `gpcjax.sweep.checkpoints` for the folders, and for which runs go on from where.
"""

import itertools
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.engine.pool import Pool, Resumed
from gpcjax.engine.snapshots import NotResumed, Snapshot, pack, unpack
from gpcjax.errors import UserError
from gpcjax.policies.folder import read_arrays, read_card, write_folder
from gpcjax.sweep.checkpoints import KIND, Place, cell_as_json, cell_of
from gpcjax.sweep.keeping import KeptRow
from gpcjax.sweep.plan import Cell

SHARE = 0.02
"""Of its time that a worker may spend on checkpoints: large ones are written less often."""

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
    snapshots = list(snapshots)
    arrays, lanes = pack(snapshots)
    runs = []
    for index, snapshot in enumerate(snapshots):
        lane, rows = snapshot.lane, kept.get(snapshot.name, [])
        steps = int(np.asarray(lane.rows.length).sum()) + int(lane.env.time)
        told = [
            {"episode": row.episode, "returns": row.returns, "kind": row.kind, "card": row.card}
            for row in rows
        ]
        runs.append({"cell": cell_as_json(snapshot.name), "steps": steps, "kept": told})
        for number, row in enumerate(rows):
            arrays[f"kept.{index}.{number}"] = np.frombuffer(row.arrays, np.uint8)
    return {"runs": runs, "lanes": lanes}, arrays


def _unpacked(path: Path, pool: Pool) -> tuple[list[Snapshot], list[list[KeptRow]]]:
    """Raises UserError or NotResumed."""
    card = read_card(path, KIND)
    arrays = read_arrays(path, card, KIND)
    rows = [
        [
            KeptRow(**row, arrays=arrays.pop(f"kept.{index}.{number}").tobytes())
            for number, row in enumerate(run["kept"])
        ]
        for index, run in enumerate(card["runs"])
    ]
    names = [cell_of(run["cell"]) for run in card["runs"]]
    return unpack(arrays, card["lanes"], names, pool.shapes), rows
