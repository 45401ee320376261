"""The rows of a sweep in its run folder: written once, atomically, and read back as pandas frames. Loads no jax.

A part holds the rows of some finished cells: `episodes/NAME.parquet` and `corrections/NAME.parquet` of the same
name. The corrections are written first; a part without episodes was interrupted, and is removed when the sweep goes on.
What makes a part whole, and one of this sweep, is in `gpcjax.sweep.parts`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa

from gpcjax.allowed import checked_path
from gpcjax.errors import UserError
from gpcjax.registry import built_in, find
from gpcjax.sweep.atomic import clean, write_atomic
from gpcjax.sweep.parts import IDENTITY, Found, Origin, cells_of, is_ours, orphans, sealed, whole_parts
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.runfolder import (
    CORRECTIONS,
    DAMAGED,
    EPISODES,
    MANIFEST,
    UNSEALED,
    Say,
    check_report,
    parse_part,
    part_name,
    read_manifest,
    set_aside,
    sha256,
    tell,
    warn,
)

__all__ = [
    "IDENTITY",
    "CellRows",
    "Rows",
    "Store",
    "load",
    "load_corrections",
    "read",
    "read_corrections",
    "read_episodes",
    "read_manifest",
]


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
    own: Mapping[str, np.ndarray] = {}
    """What the learner measures besides, [e] each."""


class Store:
    """The parts of one run folder, for the one process that writes there (`gpcjax.sweep.lock.held`).

    Args:
        out: the run folder; it exists.
        manifest: what it says of the sweep.
        machine: `gpcjax.sweep.machine.kind_of` the machine that computes what will be appended.
        say: takes a line for the person.
    """

    def __init__(self, out: Path, manifest: Mapping[str, Any], machine: str = "", say: Say = tell):
        self._out, self._manifest, self._say = out, manifest, say
        self._varying = tuple(manifest["varying"])
        self._origin = Origin(manifest["hash"], manifest["versions"], machine)
        self._episodes, self._corrections = out / EPISODES, out / CORRECTIONS
        for folder in (self._episodes, self._corrections):
            folder.mkdir(exist_ok=True)
        numbers = [part.number for path in self._episodes.iterdir() if (part := parse_part(path.name))]
        self._next = max(numbers, default=-1) + 1

    def missing(self, cells: Iterable[Cell]) -> list[Cell]:
        """The cells that have no rows yet.

        What is damaged is moved to `OUT/damaged`, with a line, and its cells are missing; what an interruption left
        behind is removed. What is not ours stays as it is.
        """
        self._clean()
        columns, found = [*IDENTITY, *self._varying], Found()
        stored: set[tuple[Any, ...]] = set()
        for part in whole_parts(self._out, self._manifest, found, columns):
            held = cells_of(part.episodes, columns)
            found.repeated += len(held & stored)
            stored |= held
        for name in orphans(self._out):
            part = parse_part(name)
            unsealed = self._manifest["format"] == UNSEALED and not getattr(part, "hash", "")
            if part is not None and not unsealed and part.hash != self._manifest["hash"]:
                found.foreign.append(f"{CORRECTIONS}/{name}")
            elif is_ours(self._out, name, self._manifest):
                (self._corrections / name).unlink(missing_ok=True)
            else:
                found.damaged[f"{CORRECTIONS}/{name}"] = "it belongs to no episodes"
        for name in found.parts:
            set_aside(self._out, self._episodes / name, self._corrections / name)
        fate = f"moved to {self._out / DAMAGED}, what is missing runs again"
        found.speak(self._out, self._say, fate)
        return [cell for cell in cells if self._key(cell) not in stored]

    def append(self, rows: Sequence[CellRows]) -> None:
        """Writes the rows of some cells as one part."""
        if not rows:
            return
        corrections = sealed(self._correction_table(rows), CORRECTIONS, self._origin)
        episodes = sealed(self._episode_table(rows), EPISODES, self._origin, corrections=sha256(corrections))
        name = part_name(self._next, self._origin.hash, episodes)
        write_atomic(self._corrections / name, corrections)
        write_atomic(self._episodes / name, episodes)
        self._next += 1

    def _clean(self) -> None:
        """Temporary files that a kill has left: nobody but the writer of this folder makes them."""
        clean(self._out, lambda target: target == MANIFEST)
        for folder in (self._episodes, self._corrections):
            clean(folder, lambda target: parse_part(target) is not None)

    def _key(self, cell: Cell) -> tuple[Any, ...]:
        return (
            *(getattr(cell, name) for name in IDENTITY),
            *(_setting(cell, name) for name in self._varying),
        )

    def _episode_table(self, rows: Sequence[CellRows]) -> pa.Table:
        parts = [row.episodes for row in rows]
        joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
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
            values = np.concatenate(
                [row.own.get(name, none) for row, none in zip(rows, none_of_it, strict=True)]
            )
            absent = np.repeat([name not in row.own for row in rows], lengths)
            columns[name] = pa.array(values, mask=absent)
        return self._table(rows, lengths, columns)

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
        varying = {
            _correction_column(name) if name in columns else name: repeated(
                [_setting(row.cell, name) for row in rows], pa.float64()
            )
            for name in self._varying
        }
        return pa.table(identity | columns | varying)


class Rows(NamedTuple):
    """What a run folder holds."""

    episodes: pd.DataFrame
    corrections: pd.DataFrame
    manifest: dict[str, Any]


def read(out: Path, say: Say = warn) -> Rows:
    """All rows of a run folder that are whole and of its sweep, while a sweep may be writing there.

    What is damaged is left out, and what is not of this sweep is not read: `say` gets a line for each, if there is any.
    No row is read twice.

    Raises:
        UserError: `out` is no run folder, its manifest is damaged, or none of its rows is whole.
    """
    manifest = read_manifest(out)
    varying, found, seen = manifest["varying"], Found(), set()
    episodes, corrections = [], []
    keys = [*IDENTITY, *varying]
    for part in whole_parts(out, manifest, found):
        cells = cells_of(part.episodes, keys)
        new, old = cells - seen, cells & seen
        found.repeated += len(old)
        seen |= new
        episodes.append(_of_cells(part.episodes, keys, new) if old else part.episodes)
        names = [*IDENTITY, *map(_correction_column, varying)]
        corrections.append(_of_cells(part.corrections, names, new) if old else part.corrections)
    if found.damaged and not episodes:
        path, what = next(iter(found.damaged.items()))
        raise UserError(
            f"{out}: none of its rows is whole ({path}: {what}), the same sweep computes them again"
        )
    found.speak(out, say, "left out, the same sweep computes what is missing again")
    return Rows(
        _frame(episodes, varying, ["episode"]),
        _frame(corrections, [*map(_correction_column, varying)], ["episode", "step", "action_dim"]),
        manifest,
    )


def read_episodes(out: Path, say: Say = warn) -> pd.DataFrame:
    """One row for each cell and episode, in the order algo, error, the varying columns, seed, episode: see `read`."""
    return read(out, say).episodes


def read_corrections(out: Path, say: Say = warn) -> pd.DataFrame:
    """One row for each of the first corrections of each cell, in the order of `read_episodes`, then by step."""
    return read(out, say).corrections


def load(out: Any) -> pd.DataFrame:
    """The episodes of a run folder as a pandas frame: a row for each run and episode.

    Rows are ordered by algo, oracle, error, the settings that vary, seed, episode. Parts that are damaged are left out
    with a warning (`UserWarning`), and so is what is not of this sweep. A sweep may be writing there meanwhile.

    | column | type | unit | what |
    |---|---|---|---|
    | env, algo, oracle | str | | the task, who learned, whose actions the teacher aimed at |
    | error | float | | chance that an advice had the wrong sign |
    | seed | int | | of the run's random streams |
    | episode | int | | from 1 |
    | return | float | the task's reward | sum of rewards |
    | length | int | steps | until the episode ended |
    | corrections | int | | advices that the learner took |
    | mean_rate | float | normalised action | mean learning rate of these; null without any |
    | asked | int | steps | at which the teacher's coins allowed advice |
    | chance | float | | mean chance of advice at these; null without any |
    | policy_points, human_points | int | points | in the dictionaries at the episode's end; null for learners without |
    | clipped | int | steps | whose action was outside [-1, 1] |
    | full | int | | corrections that met a full dictionary |
    | status | str | | "ok", or why the run ended after this episode |
    | delta, rate, ... | float | as the setting | each setting with several values; null for learners without it |

    Raises:
        ValueError: `out` is no run folder, holds no episodes yet, or none that is whole.
    """
    return _read_some(checked_path("out", out)).episodes


def load_corrections(out: Any) -> pd.DataFrame:
    """The corrections of a run folder as a pandas frame: a row for each of the first 200 of each run.

    A correction of several action dimensions has a row for each. Rows are ordered as those of `load`, then by step and
    action dimension; what is damaged or foreign is treated as there.

    | column | type | unit | what |
    |---|---|---|---|
    | env, algo, oracle, error, seed, episode | | | as in `load` |
    | step | int | steps | of the episode, from 0 |
    | action_dim | int | | which dimension of the action was corrected |
    | rate | float | normalised action | learning rate: from the action to its target |
    | sigma_policy | float | normalised action | the policy's deviation before the correction, null without |
    | sigma_human | float | advice | the same of the human model; null for learners without |
    | appended, replaced, full | bool | | what became of the point in the policy's dictionary |
    | delta, advice_rate, ... | float | as the setting | as in `load`; `advice_rate` is the setting `rate` |

    Raises:
        ValueError: as `load`.
    """
    return _read_some(checked_path("out", out)).corrections


def _read_some(out: Path) -> Rows:
    check_report(out)
    rows = read(out)
    if rows.episodes.empty:
        raise UserError(f"{out}: it holds no episodes of its sweep")
    manifest = rows.manifest
    lost = manifest["cells"] - len(rows.episodes.drop_duplicates([*IDENTITY, *manifest["varying"]]))
    if manifest["complete"] and lost > 0:
        warn(f"{out}: {lost} of its {manifest['cells']} runs are lost, the same sweep computes them again")
    return rows


def _of_cells(table: pa.Table, keys: Sequence[str], cells: set[tuple[Any, ...]]) -> pa.Table:
    """The rows of these cells alone."""
    each = zip(*(table.column(name).to_pylist() for name in keys), strict=True)
    return table.filter(pa.array([key in cells for key in each], pa.bool_()))


def _frame(tables: Sequence[pa.Table], varying: Sequence[str], order: Sequence[str]) -> pd.DataFrame:
    """All rows; what a learner measures besides has no part in their order."""
    if not tables:
        return pd.DataFrame()
    frame = pa.concat_tables(tables, promote_options="permissive").to_pandas()
    others = sorted({*frame["algo"]} - {*built_in("learner")})
    ranks = {name: rank for rank, name in enumerate([*built_in("learner"), *others])}
    keys = ["algo", "oracle", "error", *varying, "seed", *order]
    return frame.sort_values(
        keys, key=lambda column: column.map(ranks) if column.name == "algo" else column, kind="stable"
    ).reset_index(drop=True)


def _correction_column(name: str) -> str:
    """The column of a varying setting beside corrections, whose `rate` is the learning rate."""
    return "advice_rate" if name == "rate" else name


def _setting(cell: Cell, name: str) -> float | None:
    """The value of a varying column, None where it does not concern the cell's learner."""
    return getattr(cell, name) if name in ("delta", "rate") else dict(cell.hyperparameters).get(name)


def _mean(sums: np.ndarray, counts: np.ndarray) -> pa.Array:
    return pa.array(sums / np.maximum(counts, 1), mask=counts == 0)


def _integers(values: np.ndarray, mask: np.ndarray) -> pa.Array:
    return pa.array(values.astype(np.int32), mask=mask)
