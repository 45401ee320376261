"""The rows of a run folder as its report takes them: what is counted, in arrays, part by part. Loads no jax.

A frame of all columns holds the settings of a cell in each of its rows, and a text of its own in each field. Here a
cell is told once, and a row has 22 bytes.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from gpcjax.errors import UserError
from gpcjax.recording import CUT
from gpcjax.sweep.chosen import Places
from gpcjax.sweep.coded import Coded, Values, joint
from gpcjax.sweep.layout import EPISODES, Say
from gpcjax.sweep.parts import Found, whole_parts
from gpcjax.sweep.rows import IDENTITY
from gpcjax.sweep.steady import steadily

OK = "ok"
_TOTALS = ("length", "clipped", "full")
_MEASURED = ("episode", "return", "corrections", *_TOTALS, "status")


@dataclass(frozen=True, eq=False)
class Episodes:
    """Cells, and what is counted of their episodes.

    | Field         | Shape           | What                                                                  |
    |---------------|-----------------|-----------------------------------------------------------------------|
    | `env`         |                 | the task                                                              |
    | `settings`    | [cells] each    | algo, oracle, error and the settings that vary                        |
    | `seeds`       | [cells]         | of the cells                                                          |
    | `totals`      | [cells] each    | sums over the episodes of a cell that were not cut: length, clipped, full |
    | `cell`        | [rows]          | the cell of each episode                                              |
    | `episode`     | [rows]          | from 1                                                                |
    | `returns`     | [rows]          | sums of rewards                                                       |
    | `corrections` | [rows]          | that the learner took                                                 |
    | `status`      | [rows]          | "ok", or why the run ended after this episode                         |
    | `part`        | [cells]         | the place in `parts` of the part that holds a cell; None of a frame   |
    """

    env: str
    settings: Mapping[str, Coded]
    seeds: Int[np.ndarray, "cells"]
    totals: Mapping[str, Int[np.ndarray, "cells"]]
    cell: Int[np.ndarray, "rows"]
    episode: Int[np.ndarray, "rows"]
    returns: Float[np.ndarray, "rows"]
    corrections: Int[np.ndarray, "rows"]
    status: Coded
    part: Int[np.ndarray, "cells"] | None = None
    parts: tuple[str, ...] = ()

    @property
    def places(self) -> Places:
        """What is needed to find a cell's part again, when the rows are no longer."""
        return Places(self.settings, self.seeds, self.part, self.parts)

    def of_cells(self, kept: Bool[np.ndarray, "cells"]) -> "Episodes":
        """Those of some cells alone."""
        rows = kept[self.cell]
        return replace(
            self,
            settings={
                name: Coded(column.codes[kept], column.values) for name, column in self.settings.items()
            },
            seeds=self.seeds[kept],
            totals={name: total[kept] for name, total in self.totals.items()},
            cell=(np.cumsum(kept) - 1)[self.cell[rows]].astype(np.int32),
            episode=self.episode[rows],
            returns=self.returns[rows],
            corrections=self.corrections[rows],
            status=Coded(self.status.codes[rows], self.status.values),
            part=None if self.part is None else self.part[kept],
        )

    @staticmethod
    def of(frame: pd.DataFrame, varying: Iterable[str]) -> "Episodes":
        """The same of a frame as `gpcjax.load` gives it, which has at least one row."""
        part = _Part.of(
            {name: _coded(frame, name) for name in ("algo", "oracle", "error", *varying)},
            {name: frame[name].to_numpy() for name in ("seed", *_MEASURED[:-1])},
            _coded(frame, "status"),
        )
        return _joined(str(frame["env"].iloc[0]), [part], [], [False])[0]


def read_counted(out: Path, say: Say) -> tuple[Episodes | None, dict[str, Any]]:
    """The episodes of a run folder and its manifest; None if there are none. As `gpcjax.sweep.reading.read`.

    Raises:
        UserError: `out` is no run folder, its manifest is damaged, or none of its rows is whole.
    """

    def read(manifest: Mapping[str, Any], found: Found) -> Episodes | None:
        varying, values = tuple(manifest["varying"]), Values()
        env, parts, names, again = "", [], [], []
        for part in whole_parts(out, manifest, found, {EPISODES: [*IDENTITY, *varying, *_MEASURED]}):
            table = part.tables[EPISODES]
            if len(table):
                env = env or str(table.column("env")[0])
                parts.append(_of_table(table, varying, values))
                names.append(part.name)
                again.append(part.again)
        episodes, found.repeated = _joined(env, parts, names, again) if parts else (None, 0)
        return episodes

    episodes, manifest, found = steadily(out, read)
    if found.damaged and episodes is None:
        path, what = next(iter(found.damaged.items()))
        raise UserError(
            f"{out}: none of its rows is whole ({path}: {what}), the same sweep computes them again"
        )
    found.speak(out, say, "left out, the same sweep computes what is missing again")
    return episodes, manifest


class _Part(NamedTuple):
    """What `Episodes` holds, of one part."""

    settings: dict[str, Coded]
    seeds: np.ndarray
    totals: dict[str, np.ndarray]
    cell: np.ndarray
    episode: np.ndarray
    returns: np.ndarray
    corrections: np.ndarray
    status: Coded

    @staticmethod
    def of(settings: Mapping[str, Coded], columns: Mapping[str, np.ndarray], status: Coded) -> "_Part":
        """Of columns that have a value in each row."""
        seeds = columns["seed"].astype(np.int64)
        codes = [column.codes for column in settings.values()]
        starts = np.ones(len(seeds), bool)
        starts[1:] = np.any([each[1:] != each[:-1] for each in (seeds, *codes)], axis=0)
        first = np.flatnonzero(starts)
        known, once, which = np.unique(
            joint([_dense(seeds[first]), *(each[first] for each in codes)]),
            return_index=True,
            return_inverse=True,
        )
        # The rows of a cell usually follow each other; wherever they are, cells keep the order of their first rows.
        order = np.argsort(once)
        rank = np.empty(len(known), np.int32)
        rank[order] = np.arange(len(known))
        cell, first = rank[which][np.cumsum(starts) - 1], first[once[order]]
        cut = status.values.index(CUT) if CUT in status.values else None
        whole = slice(None) if cut is None else status.codes != cut
        return _Part(
            {name: column._replace(codes=column.codes[first]) for name, column in settings.items()},
            seeds[first],
            {name: _sums(cell[whole], columns[name][whole], len(first)) for name in _TOTALS},
            cell,
            columns["episode"].astype(np.int32),
            columns["return"].astype(np.float64),
            columns["corrections"].astype(np.int32),
            status._replace(codes=status.codes.astype(np.int16)),
        )


def _of_table(table: pa.Table, varying: Sequence[str], values: Values) -> _Part:
    return _Part.of(
        {name: values.coded(name, table.column(name)) for name in ("algo", "oracle", "error", *varying)},
        {name: table.column(name).to_numpy() for name in ("seed", *_MEASURED[:-1])},
        values.coded("status", table.column("status")),
    )


def _joined(
    env: str, parts: list[_Part], names: Sequence[str], again: Sequence[bool]
) -> tuple[Episodes, int]:
    """All parts, whose codes mean the same, and how many cells are there twice: those of an earlier part count.

    No wonder is what comes `again`, by part: of those that came while the others were read.
    The list is emptied on the way: of what it held nothing stays twice in memory.
    """
    *_, latest = parts
    settings = {
        name: Coded(np.concatenate([part.settings[name].codes for part in parts]), values)
        for name, (_, values) in latest.settings.items()
    }
    seeds = np.concatenate([part.seeds for part in parts])
    totals = {name: np.concatenate([part.totals[name] for part in parts]) for name in _TOTALS}
    before = np.cumsum([0, *(len(part.seeds) for part in parts)])
    cell = np.concatenate([part.cell + int(start) for part, start in zip(parts, before, strict=False)])
    part = np.repeat(np.arange(len(parts)), np.diff(before))
    columns = {
        "episode": np.concatenate([part.episode for part in parts]),
        "returns": np.concatenate([part.returns for part in parts]),
        "corrections": np.concatenate([part.corrections for part in parts]),
    }
    status = np.concatenate([part.status.codes for part in parts])
    parts.clear()
    _, once = np.unique(
        joint([_dense(seeds), *(column.codes for column in settings.values())]), return_index=True
    )
    made = Episodes(
        env=env,
        settings=settings,
        seeds=seeds,
        totals=totals,
        cell=cell.astype(np.int32),
        status=Coded(status, latest.status.values),
        part=part if names else None,
        parts=tuple(names),
        **columns,
    )
    if len(once) == len(seeds):
        return made, 0
    kept = np.zeros(len(seeds), bool)
    kept[once] = True
    return made.of_cells(kept), int(np.sum(~kept & ~np.asarray(again)[part]))


def _coded(frame: pd.DataFrame, name: str) -> Coded:
    codes, values = pd.factorize(frame[name])
    return Coded(codes, tuple(values.tolist()))


def _dense(seeds: np.ndarray) -> np.ndarray:
    """Numbers from 0 on, which may be as large as a seed: a code of which few bits are left."""
    least, most = (int(seeds.min()), int(seeds.max())) if len(seeds) else (0, 0)
    return seeds - least if most - least < 1 << 40 else np.unique(seeds, return_inverse=True)[1]


def _sums(cell: np.ndarray, values: np.ndarray, cells: int) -> np.ndarray:
    """Exact below 2^53."""
    return np.bincount(cell, weights=values, minlength=cells).astype(np.int64)
