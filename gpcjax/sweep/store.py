"""The rows of a sweep in its run folder: written once, atomically, and read back as pandas frames. Loads no jax.

A part holds the rows of some finished cells: `episodes/NAME.parquet` and `corrections/NAME.parquet` of the same
name. The corrections are written first; a part without episodes was interrupted, and is removed when the sweep goes on.
"""

import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gpcjax.allowed import checked_path
from gpcjax.learners.hyperparameters import ALGORITHMS
from gpcjax.sweep.atomic import atomic_path
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.runfolder import CORRECTIONS, EPISODES, check_report, read_manifest

__all__ = ["CellRows", "Store", "load", "read_corrections", "read_episodes", "read_manifest"]

IDENTITY = ("env", "algo", "oracle", "error", "seed")
"""Columns that every table begins with; those that vary come last."""


class CellRows(NamedTuple):
    """What one finished cell leaves, on its way to the store."""

    cell: Cell
    episode: np.ndarray
    """[e], from 1."""
    status: list[str]
    """[e]"""
    episodes: dict[str, np.ndarray]
    """The measurements of `gpcjax.engine.lanes.EpisodeRows`, [e] each."""
    corrections: dict[str, np.ndarray]
    """`where`, `values` and `outcome` of `gpcjax.engine.lanes.CorrectionLog`, [n, 3] each."""


class Store:
    """The parts of one run folder.

    Args:
        out: the run folder; it exists.
        varying: columns beside `IDENTITY` that tell cells apart.
    """

    def __init__(self, out: Path, varying: Sequence[str]):
        self._varying = tuple(varying)
        self._episodes, self._corrections = out / EPISODES, out / CORRECTIONS
        for folder in (self._episodes, self._corrections):
            folder.mkdir(exist_ok=True)

    def missing(self, cells: Iterable[Cell]) -> list[Cell]:
        """The cells that have no rows yet; what an interruption left behind is removed."""
        whole = {path.name for path in self._episodes.glob("*.parquet")}
        for folder in (self._episodes, self._corrections):
            for path in folder.iterdir():
                if path.name not in whole:
                    path.unlink()
        columns = [*IDENTITY, *self._varying]
        stored: set[tuple[Any, ...]] = set()
        for path in self._episodes.glob("*.parquet"):
            table = pq.read_table(path, columns=columns)
            stored |= set(zip(*(table.column(name).to_pylist() for name in columns), strict=True))
        return [cell for cell in cells if self._key(cell) not in stored]

    def append(self, rows: Sequence[CellRows]) -> None:
        """Writes the rows of some cells as one part."""
        if not rows:
            return
        name = f"part-{len(list(self._episodes.glob('*.parquet'))):05d}-{uuid.uuid4().hex[:12]}.parquet"
        for folder, table in (
            (self._corrections, self._correction_table(rows)),
            (self._episodes, self._episode_table(rows)),
        ):
            with atomic_path(folder / name) as path:
                pq.write_table(table, path)

    def _key(self, cell: Cell) -> tuple[Any, ...]:
        return (
            *(getattr(cell, name) for name in IDENTITY),
            *(_setting(cell, name) for name in self._varying),
        )

    def _episode_table(self, rows: Sequence[CellRows]) -> pa.Table:
        parts = [row.episodes for row in rows]
        joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        corrections = joined["corrections"]
        coach = np.repeat([row.cell.algo == "coach" for row in rows], [len(row.episode) for row in rows])
        none = np.zeros(len(coach), bool)
        asked = joined["asked"]
        columns = {
            "episode": pa.array(np.concatenate([row.episode for row in rows]).astype(np.int32)),
            "return": pa.array(joined["returns"]),
            "length": _integers(joined["length"], none),
            "corrections": _integers(corrections, none),
            "mean_rate": _mean(joined["rate_sum"], corrections),
            "asked": _integers(asked, none),
            "chance": _mean(joined["chance_sum"], asked),
            "policy_points": _integers(joined["policy_points"], coach),
            "human_points": _integers(joined["human_points"], coach),
            "clipped": _integers(joined["clipped"], none),
            "full": _integers(joined["full"], none),
            "status": pa.array([status for row in rows for status in row.status]),
        }
        return self._table(rows, [len(row.episode) for row in rows], columns)

    def _correction_table(self, rows: Sequence[CellRows]) -> pa.Table:
        counts = [len(row.corrections["where"]) for row in rows]
        joined = {
            name: np.concatenate([row.corrections[name] for row in rows]) for name in rows[0].corrections
        }
        where, values, outcome = joined["where"], joined["values"], joined["outcome"]
        columns = {
            "episode": pa.array((where[:, 0] + 1).astype(np.int32)),
            "step": pa.array(where[:, 1].astype(np.int32)),
            "action_dim": pa.array(where[:, 2].astype(np.int32)),
            "rate": pa.array(values[:, 0]),
            "sigma_policy": pa.array(values[:, 1], mask=np.isnan(values[:, 1])),
            "sigma_human": pa.array(values[:, 2], mask=np.isnan(values[:, 2])),
            **{name: pa.array(outcome[:, i]) for i, name in enumerate(("appended", "replaced", "full"))},
        }
        return self._table(rows, counts, columns)

    def _table(self, rows: Sequence[CellRows], counts: list[int], columns: dict[str, pa.Array]) -> pa.Table:
        def repeated(values: list[Any], kind: pa.DataType) -> pa.Array:
            return pa.array(
                [value for value, count in zip(values, counts, strict=True) for _ in range(count)], kind
            )

        kinds = (pa.string(), pa.string(), pa.string(), pa.float64(), pa.int64())
        identity = {
            name: repeated([getattr(row.cell, name) for row in rows], kind)
            for name, kind in zip(IDENTITY, kinds, strict=True)
        }
        # A correction's `rate` is the learning rate; the chance of advice stands beside it under another name.
        varying = {
            "advice_rate" if name in columns else name: repeated(
                [_setting(row.cell, name) for row in rows], pa.float64()
            )
            for name in self._varying
        }
        return pa.table(identity | columns | varying)


def read_episodes(out: Path) -> pd.DataFrame:
    """One row for each cell and episode, in the order algo, error, the varying columns, seed, episode."""
    return _read(out / EPISODES, ["episode"])


def read_corrections(out: Path) -> pd.DataFrame:
    """One row for each of the first corrections of each cell, in the order of `read_episodes`, then by step."""
    return _read(out / CORRECTIONS, ["episode", "step", "action_dim"])


def load(out: Any) -> pd.DataFrame:
    """The episodes of a run folder as a pandas frame: see `read_episodes`.

    Raises:
        ValueError: `out` is no run folder, or holds no episodes yet.
    """
    folder = checked_path("out", out)
    check_report(folder)
    return read_episodes(folder)


def _read(folder: Path, order: list[str]) -> pd.DataFrame:
    paths = sorted(folder.glob("*.parquet"))
    if not paths:
        return pd.DataFrame()
    frame = pa.concat_tables([pq.read_table(path) for path in paths]).to_pandas()
    ranks = {name: rank for rank, name in enumerate(ALGORITHMS)}
    after = list(frame.columns)[list(frame.columns).index("status" if "status" in frame else "full") + 1 :]
    keys = ["algo", "oracle", "error", *after, "seed", *order]
    return frame.sort_values(
        keys, key=lambda column: column.map(ranks) if column.name == "algo" else column, kind="stable"
    ).reset_index(drop=True)


def _setting(cell: Cell, name: str) -> float | None:
    """The value of a varying column, None where it does not concern the cell's learner."""
    return getattr(cell, name) if name in ("delta", "rate") else dict(cell.hyperparameters).get(name)


def _mean(sums: np.ndarray, counts: np.ndarray) -> pa.Array:
    return pa.array(sums / np.maximum(counts, 1), mask=counts == 0)


def _integers(values: np.ndarray, mask: np.ndarray) -> pa.Array:
    return pa.array(values.astype(np.int32), mask=mask)
