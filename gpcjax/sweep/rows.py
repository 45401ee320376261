"""What a finished cell leaves, and the tables that are made of it: each column is named here. Loads no jax."""

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from gpcjax.registry import find
from gpcjax.sweep.boxes import setting_of
from gpcjax.sweep.keeping import KeptRow
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, KEPT
from gpcjax.sweep.plan import Cell

IDENTITY = ("env", "algo", "oracle", "error", "seed")
"""Columns that every table begins with; those that vary come last."""

_KINDS = (pa.string(), pa.string(), pa.string(), pa.float64(), pa.int64())


class Run(NamedTuple):
    """What is told of a finished cell to whoever watches."""

    cell: Cell
    returns: Float[np.ndarray, "episodes"]
    lengths: Int[np.ndarray, "episodes"]
    """Steps."""


@dataclass(frozen=True, eq=False)
class CellRows:
    """What one finished cell leaves, on its way to the store."""

    cell: Cell
    episode: np.ndarray
    """[e], from 1."""
    status: list[str]
    """[e]"""
    episodes: dict[str, np.ndarray]
    """The measurements of `gpcjax.engine.lanes.EpisodeRows`, [e] each."""
    corrections: dict[str, np.ndarray]
    """`moments`, `values` and `outcome` of `gpcjax.engine.lanes.CorrectionLog`, [n, 3] each."""
    own: Mapping[str, np.ndarray] = field(default_factory=dict)
    """What the learner measures besides, [e] each."""
    kept: tuple[KeptRow, ...] = ()
    """What was learned, where that is to be kept, in the order of episodes."""
    machine: str = ""
    """`gpcjax.sweep.machine.kind_of` the machine that computed it; empty for the one that stores it."""

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The one cell; see `gpcjax.sweep.blocks.Block`, which has several."""
        return (self.cell,)

    @property
    def runs(self) -> tuple[Run, ...]:
        """The one run."""
        return (Run(self.cell, self.episodes["returns"], self.episodes["length"]),)


def tables_of(rows: Sequence[CellRows], varying: Sequence[str]) -> dict[str, pa.Table]:
    """The tables of a part with the rows of some cells, by the folder that each goes to."""
    makers: dict[str, Callable[[Sequence[CellRows]], tuple[list[int], dict[str, pa.Array]]]] = {
        EPISODES: _episodes,
        CORRECTIONS: _corrections,
    }
    if any(row.kept for row in rows):
        makers[KEPT] = _kept
    return {folder: _table(rows, varying, *make(rows)) for folder, make in makers.items()}


def counts_of(rows: Sequence[CellRows]) -> dict[str, tuple[int, ...]]:
    """How many rows of each of these tables are of each cell."""
    counts = {
        EPISODES: tuple(len(row.episode) for row in rows),
        CORRECTIONS: tuple(len(row.corrections["moments"]) for row in rows),
        KEPT: tuple(len(row.kept) for row in rows),
    }
    return {folder: each for folder, each in counts.items() if folder != KEPT or any(each)}


def correction_column(name: str) -> str:
    """The column of a varying setting beside corrections, whose `rate` is the learning rate."""
    return "advice_rate" if name == "rate" else name


def key_of(cell: Cell, varying: Sequence[str]) -> tuple[Any, ...]:
    """The values of the columns that tell this cell from all others."""
    return *(getattr(cell, name) for name in IDENTITY), *(setting_of(cell, name) for name in varying)


def cells_of(table: pa.Table, columns: Sequence[str]) -> set[tuple[Any, ...]]:
    """The values of the key columns that occur, each once."""
    unique = table.select(list(columns)).group_by(list(columns), use_threads=False).aggregate([])
    return set(zip(*(unique.column(name).to_pylist() for name in columns), strict=True))


def of_cells(
    tables: Mapping[str, pa.Table], keys: Sequence[str], cells: Container[tuple[Any, ...]]
) -> dict[str, pa.Table]:
    """The rows of these cells alone of the tables of a part, by their folder; `keys` are the key columns."""
    found = {}
    for folder, table in tables.items():
        names = list(map(correction_column, keys)) if folder == CORRECTIONS else keys
        each = zip(*(table.column(name).to_pylist() for name in names), strict=True)
        found[folder] = table.filter(pa.array([key in cells for key in each], pa.bool_()))
    return found


def _episodes(rows: Sequence[CellRows]) -> tuple[list[int], dict[str, pa.Array]]:
    joined = _joined([row.episodes for row in rows])
    corrections = joined["corrections"]
    lengths = [len(row.episode) for row in rows]
    without = np.repeat([not find("learner", row.cell.algo).dictionary for row in rows], lengths)
    none = np.zeros(len(without), bool)
    asked = joined["asked"]
    columns = {
        "episode": pa.array(np.concatenate([row.episode for row in rows]).astype(np.int32)),
        "return": pa.array(joined["returns"]),
        "length": _integers(joined["length"], none),
        "corrections": _integers(corrections, none),
        "mean_rate": _mean(joined["rate_sum"], corrections),
        "asked": _integers(asked, none),
        "chance": _mean(joined["chance_sum"], asked),
        "policy_points": _integers(joined["policy_points"], without),
        "human_points": _integers(joined["human_points"], without),
        "clipped": _integers(joined["clipped"], none),
        "full": _integers(joined["full"], none),
        "status": pa.array([status for row in rows for status in row.status]),
    }
    for name in sorted({name for row in rows for name in row.own} - columns.keys()):
        none_of_it = [np.full(length, np.nan) for length in lengths]
        values = np.concatenate([row.own.get(name, none) for row, none in zip(rows, none_of_it, strict=True)])
        absent = np.repeat([name not in row.own for row in rows], lengths)
        columns[name] = pa.array(values, mask=absent)
    return lengths, columns


def _corrections(rows: Sequence[CellRows]) -> tuple[list[int], dict[str, pa.Array]]:
    joined = _joined([row.corrections for row in rows])
    moments, values, outcome = joined["moments"], joined["values"], joined["outcome"]
    columns = {
        "episode": pa.array((moments[:, 0] + 1).astype(np.int32)),
        "step": pa.array(moments[:, 1].astype(np.int32)),
        "action_dim": pa.array(moments[:, 2].astype(np.int32)),
        "rate": pa.array(values[:, 0]),
        "sigma_policy": pa.array(values[:, 1], mask=np.isnan(values[:, 1])),
        "sigma_human": pa.array(values[:, 2], mask=np.isnan(values[:, 2])),
        **{name: pa.array(outcome[:, i]) for i, name in enumerate(("appended", "replaced", "full"))},
    }
    return [len(row.corrections["moments"]) for row in rows], columns


def _kept(rows: Sequence[CellRows]) -> tuple[list[int], dict[str, pa.Array]]:
    kept = [each for row in rows for each in row.kept]
    columns = {
        "episode": pa.array([each.episode for each in kept], pa.int32()),
        "return": pa.array([each.returns for each in kept], pa.float64()),
        "kind": pa.array([each.kind for each in kept], pa.string()),
        "card": pa.array([each.card for each in kept], pa.large_string()),
        "arrays": pa.array([each.arrays for each in kept], pa.large_binary()),
    }
    return [len(row.kept) for row in rows], columns


def _table(
    rows: Sequence[CellRows], varying: Sequence[str], counts: Sequence[int], columns: Mapping[str, pa.Array]
) -> pa.Table:
    """The columns between those that tell the cells apart, whose values are repeated `counts` times."""
    place = pa.array(np.repeat(np.arange(len(rows)), counts))

    def repeated(values: list[Any], kind: pa.DataType) -> pa.Array:
        return pa.array(values, kind).take(place)

    identity = {
        name: repeated([getattr(row.cell, name) for row in rows], kind)
        for name, kind in zip(IDENTITY, _KINDS, strict=True)
    }
    settings = {
        correction_column(name) if name in columns else name: repeated(
            [setting_of(row.cell, name) for row in rows], pa.float64()
        )
        for name in varying
    }
    return pa.table(identity | dict(columns) | settings)


def _joined(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _mean(sums: np.ndarray, counts: np.ndarray) -> pa.Array:
    return pa.array(sums / np.maximum(counts, 1), mask=counts == 0)


def _integers(values: np.ndarray, mask: np.ndarray) -> pa.Array:
    return pa.array(values.astype(np.int32), mask=mask)
