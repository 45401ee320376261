"""The parts of a run folder on disk: which belong to its sweep, and which of them are whole. Loads no jax.

A part is a pair of Parquet files of one name, see `gpcjax.sweep.runfolder`. Nothing in it is taken for rows before its
sums are right: a file is read into memory once, and what was checked there is what is decoded.
"""

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gpcjax.errors import UserError
from gpcjax.sweep.atomic import target_of
from gpcjax.sweep.runfolder import (
    CORRECTIONS,
    EPISODES,
    FORMAT,
    UNSEALED,
    Say,
    parse_part,
    sha256,
)

IDENTITY = ("env", "algo", "oracle", "error", "seed")
"""Columns that every table begins with; those that vary come last."""

_SEAL = b"gpcjax"
"""Key of the metadata in which a file says what it is, as JSON."""

_WORTH_THREADS = 1 << 20
"""Bytes from which threads decode faster than they start."""

_UNSEALED_EPISODES = (
    *IDENTITY, "episode", "return", "length", "corrections", "mean_rate", "asked", "chance", "policy_points",
    "human_points", "clipped", "full", "status",
)  # fmt: skip
_UNSEALED_CORRECTIONS = (
    *IDENTITY, "episode", "step", "action_dim", "rate", "sigma_policy", "sigma_human", "appended", "replaced", "full",
)  # fmt: skip
"""The columns of format 2."""


class Origin(NamedTuple):
    """What rows come from beside their cell: kept in each part."""

    hash: str
    """Of the specification."""
    versions: Mapping[str, str]
    machine: str
    """`gpcjax.sweep.machine.kind_of` the machine that computed them."""


class Part(NamedTuple):
    """A whole part, in memory."""

    name: str
    episodes: pa.Table
    corrections: pa.Table


@dataclass
class Found:
    """What else lies where parts are, each by its path below the run folder."""

    damaged: dict[str, str] = field(default_factory=dict)
    """What is wrong with it, by the path of the file."""
    foreign: list[str] = field(default_factory=list)
    """Not of this sweep: never read, never touched."""
    repeated: int = 0
    """Cells that an earlier part holds too."""

    @property
    def parts(self) -> list[str]:
        """Names of the damaged parts."""
        return sorted({Path(path).name for path in self.damaged})

    def speak(self, out: Path, say: Say, fate: str) -> None:
        """Say what was found, a line for each kind; `fate` is what becomes of what is damaged."""
        if self.damaged:
            first = next(iter(self.damaged))
            count = len(self.parts)
            parts = "1 damaged part" if count == 1 else f"{count} damaged parts"
            which = f"{first}: {self.damaged[first]}" + (", for one" if count > 1 else "")
            say(f"{out}: {parts} {fate} ({which})")
        if self.foreign:
            more = f" and {len(self.foreign) - 1} more" if len(self.foreign) > 1 else ""
            say(f"{out}: not rows of this sweep, so neither read nor touched: {self.foreign[0]!r}{more}")
        if self.repeated:
            say(f"{out}: {self.repeated} cells are there twice, the rows of the first part count")


class _Damage(Exception):
    """What is wrong with a file, and which of the two it is."""

    def __init__(self, folder: str, what: str):
        super().__init__(what)
        self.folder = folder


def sealed(table: pa.Table, kind: str, origin: Origin, **more: str) -> bytes:
    """The file of a part: rows, and what they are. `kind` is `EPISODES` or `CORRECTIONS`."""
    seal = {"format": FORMAT, "table": kind, **origin._asdict(), **more}
    sink = pa.BufferOutputStream()
    schema = {**(table.schema.metadata or {}), _SEAL: json.dumps(seal)}
    pq.write_table(table.replace_schema_metadata(schema), sink, write_page_checksum=True)
    return sink.getvalue().to_pybytes()


def whole_parts(
    out: Path, manifest: Mapping[str, Any], found: Found, columns: Sequence[str] | None = None
) -> Iterator[Part]:
    """Every part of the sweep in `out` that is whole, in the order of their names; the rest goes into `found`.

    Args:
        out: the run folder. A sweep may be writing there.
        manifest: says which sweep it is, and with which versions its rows are made.
        found: is filled on the way.
        columns: only these of the episodes, and no corrections.

    Raises:
        UserError: a file cannot be read, whatever it holds.
    """
    names = _names(out / EPISODES)
    for name in names:
        path = out / EPISODES / name
        try:
            if not path.is_file():
                if path.is_symlink() or path.exists():
                    found.foreign.append(f"{EPISODES}/{name}")
                continue  # or it was set aside just now
            part = parse_part(name)
            if part is not None and part.digest:
                tables = _sealed_tables(out, name, manifest, columns)
            elif manifest["format"] == UNSEALED and name.endswith(".parquet"):
                tables = _unsealed_tables(out, name, manifest, columns)
            else:
                tables = None
        except _Damage as damage:
            if path.is_symlink() or path.exists():
                found.damaged[f"{damage.folder}/{name}"] = str(damage)
            continue
        if tables is None:
            found.foreign.append(f"{EPISODES}/{name}")
        else:
            yield Part(name, *tables)
    beside = set(names) if manifest["format"] == UNSEALED else set()
    found.foreign += [
        f"{CORRECTIONS}/{name}"
        for name in _names(out / CORRECTIONS)
        if parse_part(name) is None and name not in beside
    ]


def origins_of(out: Path, hash_: str) -> list[Origin]:
    """What the whole parts of the sweep with this hash say that they come from, in the order of their names.

    Raises:
        UserError: a file cannot be read, whatever it holds.
    """
    found = []
    for name in _names(out / EPISODES):
        with contextlib.suppress(_Damage):
            if opened := _opened(out, name, hash_):
                seal = opened[0]
                found.append(Origin(hash_, seal["versions"], str(seal.get("machine", ""))))
    return found


def orphans(out: Path) -> list[str]:
    """Names of corrections without episodes: of a part whose writing was interrupted, or whose episodes were lost."""
    whole = set(_names(out / EPISODES))
    return [name for name in _names(out / CORRECTIONS) if parse_part(name) and name not in whole]


def is_ours(out: Path, name: str, manifest: Mapping[str, Any]) -> bool:
    """Whether corrections without episodes are rows of this sweep, by what they say. Raises OSError."""
    try:
        data = (out / CORRECTIONS / name).read_bytes()
        seal = _seal_of(data)
        if seal is None:
            return manifest["format"] == UNSEALED and _lacks(_decoded(data), _UNSEALED_CORRECTIONS) is None
        return seal["table"] == CORRECTIONS and seal["hash"] == manifest["hash"]
    except (_Damage, IsADirectoryError, FileNotFoundError):
        return False


def cells_of(table: pa.Table, columns: Sequence[str]) -> set[tuple[Any, ...]]:
    """The values of the key columns that occur, each once."""
    unique = table.select(list(columns)).group_by(list(columns), use_threads=False).aggregate([])
    return set(zip(*(unique.column(name).to_pylist() for name in columns), strict=True))


def _names(folder: Path) -> list[str]:
    """What lies there but for temporary files, sorted; nothing if there is no such folder."""
    try:
        return sorted(path.name for path in folder.iterdir() if target_of(path.name) is None)
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror})") from None


def _sealed_tables(
    out: Path, name: str, manifest: Mapping[str, Any], columns: Sequence[str] | None
) -> tuple[pa.Table, pa.Table] | None:
    """The tables of a part that says what it is; None if it is another sweep's."""
    opened = _opened(out, name, manifest["hash"])
    if opened is None or opened[0]["versions"] != manifest["versions"]:
        return None
    seal, episodes = opened
    corrections = _bytes(out, CORRECTIONS, name)
    if sha256(corrections) != seal["corrections"]:
        raise _Damage(CORRECTIONS, "its checksum differs")
    return _decoded(episodes, columns), _decoded(corrections) if columns is None else pa.table({})


def _opened(out: Path, name: str, hash_: str) -> tuple[dict[str, Any], bytes] | None:
    """What the episodes of a part say that they are, and their file; None if they are another sweep's."""
    part = parse_part(name)
    if part is None or part.hash != hash_:
        return None
    data = _bytes(out, EPISODES, name)
    if sha256(data)[: len(part.digest)] != part.digest:
        raise _Damage(EPISODES, "its checksum differs")
    match seal := _seal_of(data):
        case {"format": version, "table": table, "hash": told, "versions": dict(), "corrections": str()}:
            return (seal, data) if (version, table, told) == (FORMAT, EPISODES, hash_) else None
    return None  # whole, and not written by this version


def _unsealed_tables(
    out: Path, name: str, manifest: Mapping[str, Any], columns: Sequence[str] | None
) -> tuple[pa.Table, pa.Table] | None:
    """The tables of a part of format 2; None for a file that is none, by its columns or its name."""
    named = parse_part(name) is not None
    try:
        episodes = _decoded(_bytes(out, EPISODES, name))
        if what := _lacks(episodes, (*_UNSEALED_EPISODES, *manifest["varying"])) or _contradiction(
            episodes, manifest
        ):
            raise _Damage(EPISODES, what)
    except _Damage:
        if named:
            raise
        return None
    corrections = _decoded(_bytes(out, CORRECTIONS, name), folder=CORRECTIONS)
    varying = ["advice_rate" if column == "rate" else column for column in manifest["varying"]]
    if what := _lacks(corrections, (*_UNSEALED_CORRECTIONS, *varying)):
        raise _Damage(CORRECTIONS, what)
    keys = [*IDENTITY, *manifest["varying"]]
    if not cells_of(corrections, [*IDENTITY, *varying]) <= cells_of(episodes, keys):
        raise _Damage(CORRECTIONS, "it has corrections of cells that its episodes have not")
    return (episodes, corrections) if columns is None else (episodes.select(list(columns)), pa.table({}))


def _bytes(out: Path, folder: str, name: str) -> bytes:
    try:
        return (out / folder / name).read_bytes()
    except PermissionError as error:
        raise UserError(f"{error.filename}: cannot be read ({error.strerror})") from None
    except OSError as error:
        raise _Damage(folder, f"it cannot be read, {error.strerror}") from None


def _seal_of(data: bytes) -> dict[str, Any] | None:
    """What a file says it is, None if it says nothing."""
    try:
        seal = (pq.read_schema(pa.BufferReader(data)).metadata or {}).get(_SEAL)
        told = None if seal is None else json.loads(seal)
    except Exception as error:  # whatever Parquet's readers make of bytes that are none of theirs
        raise _Damage(CORRECTIONS, f"it is no Parquet file, {_brief(error)}") from None
    return told if isinstance(told, dict) else None


def _decoded(data: bytes, columns: Sequence[str] | None = None, folder: str = EPISODES) -> pa.Table:
    threads = len(data) > _WORTH_THREADS
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        table = file.read(None if columns is None else list(columns), use_threads=threads)
        table.validate(full=True)
    except Exception as error:  # as above
        raise _Damage(folder, f"it cannot be decoded, {_brief(error)}") from None
    return table.replace_schema_metadata(None)


def _lacks(table: pa.Table, columns: Iterable[str]) -> str | None:
    missing = [name for name in columns if name not in table.column_names]
    return f"it has no column {missing[0]}" if missing else None


def _contradiction(episodes: pa.Table, manifest: Mapping[str, Any]) -> str | None:
    """What in the rows of format 2, which have no sums, cannot be of the manifest's sweep."""
    specification = manifest["specification"]
    axes = {**specification, **specification.get("hyperparameters", {})}
    for name in (*IDENTITY, *manifest["varying"]):
        found = set(episodes.column(name).unique().to_pylist())
        allowed = axes.get(name, ())
        if name == "seed":
            strange = [seed for seed in found if seed is None or not 0 <= seed < specification["seeds"]]
        else:
            # Of a setting that does not concern every learner a cell may have none.
            allowed = {allowed} if isinstance(allowed, str) else {*allowed}
            strange = found - allowed - ({None} if name in manifest["varying"] else set())
        if strange:
            return f"it has {name} {next(iter(strange))!r}, which is not in the specification"
    columns = [*IDENTITY, *manifest["varying"]]
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


def _brief(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:100]
