"""Some runs of a run folder, and their corrections: what a figure shows of a folder that holds many more.

Loads no jax.
"""

import itertools
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from gpcjax.sweep.coded import Coded, Values
from gpcjax.sweep.growth import Filled, filled_since
from gpcjax.sweep.layout import CORRECTIONS
from gpcjax.sweep.parts import Found, whole_parts
from gpcjax.sweep.rows import IDENTITY, correction_column
from gpcjax.sweep.steady import steadily

_SHOWN = ("episode", "step", "action_dim", "rate")


class Chosen(NamedTuple):
    """Runs whose corrections are read: those of these seeds (ascending) with these settings."""

    algo: str
    oracle: str
    error: float
    settings: Mapping[str, float]
    seeds: Int[np.ndarray, "runs"]


class Places(NamedTuple):
    """The part of each cell, as `Episodes` has them."""

    settings: Mapping[str, Coded]
    seeds: Int[np.ndarray, "cells"]
    part: Int[np.ndarray, "cells"] | None
    parts: tuple[str, ...]

    def without(self, chosen: Sequence[Chosen]) -> set[str]:
        """The parts that were read and hold no row of the chosen runs."""
        if self.part is None:
            return set()
        keys = [self.settings[name] for name in ("algo", "oracle", "error")]
        settings = {name: _numbers(column) for name, column in list(self.settings.items())[len(keys) :]}
        needed: set[int] = set()
        for which, cells in _by_place(_places(keys, chosen, settings)):
            mine = cells[np.isin(self.seeds[cells], chosen[which].seeds)]
            needed.update(self.part[mine].tolist())
        return {name for place, name in enumerate(self.parts) if place not in needed}


def corrections_of(
    out: Path, manifest: Mapping[str, Any], chosen: Sequence[Chosen], skip: Container[str] = ()
) -> pd.DataFrame:
    """The corrections of some runs, as `gpcjax.load_corrections` has them but for columns that no figure shows.

    Rows come in the order of the parts. Nothing is said of what is damaged: whoever chose the runs has read the folder.
    Parts named in `skip` are not opened.
    """
    columns = _columns(manifest)

    def read(now: Mapping[str, Any], found: Found) -> list[pd.DataFrame]:
        since = filled_since(manifest, now)
        return list(_frames(out, now, [_then(runs, since) for runs in chosen], skip, found))

    frames, _, _ = steadily(out, read, manifest)
    if not frames:
        return pd.DataFrame(columns=columns)
    every = pd.concat(frames, ignore_index=True)
    return every.drop(columns=[name for name in every.columns if name not in columns])


def _columns(manifest: Mapping[str, Any]) -> list[str]:
    return [*IDENTITY, *map(correction_column, manifest["varying"]), *_SHOWN]


def _then(runs: Chosen, since: Filled) -> Chosen:
    """The same runs where more settings vary now than when they were chosen."""
    before = {name: by_learner.get(runs.algo) for name, by_learner in since.items()}
    more = {name: value for name, value in before.items() if value is not None}
    return runs._replace(settings={**runs.settings, **more})


def _frames(
    out: Path,
    manifest: Mapping[str, Any],
    chosen: Sequence[Chosen],
    skip: Container[str],
    found: Found,
) -> Iterator[pd.DataFrame]:
    """The corrections of some runs by part."""
    seen = [np.zeros(0, np.int64)] * len(chosen)
    for part in whole_parts(out, manifest, found, {CORRECTIONS: _columns(manifest)}, skip):
        table, values = part.tables[CORRECTIONS], Values()
        keys = [values.coded(name, table.column(name)) for name in ("algo", "oracle", "error")]
        settings = {
            name: table.column(correction_column(name)).to_numpy()
            for name in manifest["varying"]
            if correction_column(name) in table.column_names
        }
        seeds = table.column("seed").to_numpy()
        for which, rows in _by_place(_places(keys, chosen, settings)):
            known = np.isin(seeds[rows], chosen[which].seeds) & ~np.isin(seeds[rows], seen[which])
            yield table.take(rows[known]).to_pandas()
            seen[which] = np.union1d(seen[which], seeds[rows[known]])


def _places(
    keys: Sequence[Coded], chosen: Sequence[Chosen], settings: Mapping[str, Float[np.ndarray, "rows"]]
) -> Int[np.ndarray, "rows"]:
    """The place in `chosen` of what each row belongs to by its settings; -1 for none.

    Of a learner with an oracle and an error (`keys`) there is one in `chosen`.
    """
    places = {(runs.algo, runs.oracle, runs.error): place for place, runs in enumerate(chosen)}
    every = itertools.product(*(column.values for column in keys))
    known = np.array([*(places.get(key, -1) for key in every), -1], np.int32)
    number = np.zeros(len(keys[0].codes), np.int64)
    for column in keys:
        number = number * len(column.values) + column.codes
    place = known[number]
    if (place < 0).all():
        return place
    for name, values in settings.items():
        wanted = np.array([*(runs.settings.get(name, np.nan) for runs in chosen), np.nan])[place]
        place[~np.isnan(wanted) & (values != wanted)] = -1
    return place


def _by_place(place: Int[np.ndarray, "rows"]) -> Iterator[tuple[int, Int[np.ndarray, "some"]]]:
    """Each place that is there but -1, and its rows in their order."""
    rows = np.flatnonzero(place >= 0)
    rows = rows[np.argsort(place[rows], kind="stable")]
    present, starts = np.unique(place[rows], return_index=True)
    yield from zip(present.tolist(), np.split(rows, starts[1:]), strict=False)


def _numbers(column: Coded) -> Float[np.ndarray, "cells"]:
    """The values of a setting, nan for none."""
    return np.array([*column.values, np.nan], np.float64)[column.codes]
