"""Parts of format 2, which carry no sums: what in them cannot be rows of their sweep. Loads no jax."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gpcjax.sweep.growth import requests
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, UNSEALED, parse_part
from gpcjax.sweep.rows import IDENTITY, cells_of, correction_column
from gpcjax.sweep.sealing import Damage, bytes_of, decoded
from gpcjax.sweep.seeds import Seeds

_EPISODES = (
    *IDENTITY, "episode", "return", "length", "corrections", "mean_rate", "asked", "chance", "policy_points",
    "human_points", "clipped", "full", "status",
)  # fmt: skip
_CORRECTIONS = (
    *IDENTITY, "episode", "step", "action_dim", "rate", "sigma_policy", "sigma_human", "appended", "replaced", "full",
)  # fmt: skip


def may_hold_unsealed(manifest: Mapping[str, Any]) -> bool:
    """Whether a folder was begun in format 2."""
    return manifest["format"] == UNSEALED or bool(manifest.get("unsealed"))


def unsealed_tables(out: Path, name: str, manifest: Mapping[str, Any]) -> tuple[pa.Table, pa.Table] | None:
    """The tables of a part of format 2; None for a file that is none, by its columns or its name. Raises `Damage`."""
    named = parse_part(name) is not None
    specification = requests(manifest)[0]["specification"]
    varying = _varying(specification, manifest["varying"])
    try:
        episodes = decoded(bytes_of(out, EPISODES, name))
        if what := _lacks(episodes, (*_EPISODES, *varying)) or _contradiction(
            episodes, specification, varying
        ):
            raise Damage(EPISODES, what)
    except Damage:
        if named:
            raise
        return None
    corrections = decoded(bytes_of(out, CORRECTIONS, name), folder=CORRECTIONS)
    beside = [correction_column(column) for column in varying]
    if what := _lacks(corrections, (*_CORRECTIONS, *beside)):
        raise Damage(CORRECTIONS, what)
    if not cells_of(corrections, [*IDENTITY, *beside]) <= cells_of(episodes, [*IDENTITY, *varying]):
        raise Damage(CORRECTIONS, "it has corrections of cells that its episodes have not")
    return episodes, corrections


def are_corrections(data: bytes) -> bool:
    """Whether a file without a seal has the columns of corrections of format 2. Raises `Damage`."""
    return _lacks(decoded(data), _CORRECTIONS) is None


def _varying(specification: Mapping[str, Any], now: Iterable[str]) -> list[str]:
    """What varied when the parts were written, in the order of what varies `now`."""
    axes = {**specification, **specification.get("hyperparameters", {})}
    return [name for name in now if len(axes.get(name, ())) > 1]


def _lacks(table: pa.Table, columns: Iterable[str]) -> str | None:
    missing = [name for name in columns if name not in table.column_names]
    return f"it has no column {missing[0]}" if missing else None


def _contradiction(
    episodes: pa.Table, specification: Mapping[str, Any], varying: Iterable[str]
) -> str | None:
    """What in the rows cannot be of this specification."""
    axes = {**specification, **specification.get("hyperparameters", {})}
    columns, seeds = [*IDENTITY, *varying], Seeds.of(specification["seeds"])
    for name in columns:
        found = set(episodes.column(name).unique().to_pylist())
        allowed = axes.get(name, ())
        if name == "seed":
            strange = [seed for seed in found if seeds is None or seed not in seeds]
        else:
            # Of a setting that does not concern every learner a cell may have none.
            allowed = {allowed} if isinstance(allowed, str) else {*allowed}
            strange = found - allowed - ({None} if name not in IDENTITY else set())
        if strange:
            return f"it has {name} {next(iter(strange))!r}, which is not in the specification"
    if any(episodes.column(name).null_count for name in ("episode", "return", "length", "status")):
        return "it has rows without numbers"
    frame = episodes.select([*columns, "episode", "length", "status"]).to_pandas()
    if (frame["length"] < 1).any():
        return "it has episodes without a step"
    for _, rows in frame.groupby(columns, dropna=False, sort=False):
        order = np.argsort(rows["episode"].to_numpy(), kind="stable")
        episode, ok = rows["episode"].to_numpy()[order], (rows["status"] == "ok").to_numpy()[order]
        if not np.array_equal(episode, np.arange(1, len(episode) + 1)):
            return "it has a run whose episodes are not 1, 2, 3 and so on"
        if not ok[:-1].all() or len(episode) > specification["episodes"]:
            return "it has a run that goes on after its end"
        if ok[-1] and len(episode) < specification["episodes"]:
            return "it has a run without its last episodes"
    return None
