"""The parts of a run folder on disk: which belong to its sweep, and which of them are whole. Loads no jax.

A part is a set of Parquet files of one name, see `gpcjax.sweep.layout`.
"""

import contextlib
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from gpcjax.errors import UserError
from gpcjax.sweep.atomic import target_of
from gpcjax.sweep.growth import algos_of, filled_in_order, hashes, requests
from gpcjax.sweep.layout import BESIDE, CORRECTIONS, EPISODES, Say, parse_part
from gpcjax.sweep.rows import correction_column
from gpcjax.sweep.sealing import Damage, Origin, beside, columns_of, decoded, opened, replaced_by, seal_of
from gpcjax.sweep.unsealed import are_corrections, may_hold_unsealed, unsealed_tables


class Part(NamedTuple):
    """A whole part, in memory."""

    name: str
    tables: dict[str, pa.Table]
    """By folder; those that were asked for."""
    origin: Origin | None
    """None in format 2."""
    size: int
    """Bytes of all its files."""
    again: bool = False
    """Whether it came while the others were read: it may hold the rows of some that were given already."""


@dataclass
class Found:
    """What else lies where parts are, each by its path below the run folder."""

    damaged: dict[str, str] = field(default_factory=dict)
    """What is wrong with it, by the path of the file."""
    foreign: list[str] = field(default_factory=list)
    """Not of this sweep: never read, never touched."""
    replaced: list[str] = field(default_factory=list)
    """Names of parts whose rows are in another one, which was made of them."""
    repeated: int = 0
    """Cells that an earlier part holds too."""
    gone: bool = False
    """Whether a part went while the others were read."""

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


def whole_parts(
    out: Path,
    manifest: Mapping[str, Any],
    found: Found,
    wanted: Mapping[str, Sequence[str] | None],
    skip: Container[str] = (),
) -> Iterator[Part]:
    """Every part of the sweep in `out` that is whole, in the order of their names; the rest goes into `found`.

    A part counts as whole if each of its files is, whichever of them are wanted. Parts that hold the rows of others
    come first, the newest of them before those that it was made of. Where a part goes meanwhile, those that have come
    since are read too.

    Args:
        out: the run folder. A sweep may be writing there.
        manifest: says which sweep it is, and with which versions its rows are made.
        found: is filled on the way.
        wanted: the folders whose tables are given, with the columns of each, None for all.
        skip: names of parts that are known to be whole, and are neither opened nor given.

    Raises:
        UserError: a file cannot be read, whatever it holds.
    """
    listed: set[str] = set()
    replaced: set[str] = set()
    again = gone = False
    while names := [name for name in names_in(out / EPISODES) if name not in listed]:
        listed.update(names)
        replacing = {
            name: others for name in names if parse_part(name) and (others := replaced_by(out, name))
        }
        for name in sorted(names, key=lambda name: _rank(name, replacing)):
            path = out / EPISODES / name
            if name in replaced and path.is_file():
                found.replaced.append(name)
                replaced.update(replacing.get(name, ()))
                continue
            if name in skip:
                replaced.update(replacing.get(name, ()))
                continue
            try:
                if not path.is_file():
                    if path.is_symlink() or path.exists():
                        found.foreign.append(f"{EPISODES}/{name}")
                    else:
                        gone = True
                    continue
                part = part_of(out, name, manifest, wanted)
            except Damage as damage:
                if path.is_symlink() or path.exists():
                    found.damaged[f"{damage.folder}/{name}"] = str(damage)
                else:
                    gone = True
                continue
            if part is None:
                found.foreign.append(f"{EPISODES}/{name}")
                continue
            replaced.update(replacing.get(name, ()))
            yield part._replace(again=again)
        if not gone:
            break
        found.gone = True
        # It was set aside just now, or its rows are in a part that was not there yet when the names were read.
        again, gone = True, False
    old = listed if may_hold_unsealed(manifest) else set()
    found.foreign += [
        f"{folder}/{name}"
        for folder in BESIDE
        for name in names_in(out / folder)
        if parse_part(name) is None and name not in old
    ]


def _rank(name: str, replacing: Container[str]) -> tuple[int, str]:
    """The newest of those that hold the rows of others first, then the rest by their names."""
    named = parse_part(name)
    return (0 if named is None or name not in replacing else -1 - named.number, name)


def origins_of(out: Path) -> list[Origin]:
    """What the whole parts in `out` say that they come from, in the order of their names.

    Raises:
        UserError: a file cannot be read, whatever it holds.
    """
    found = []
    for name in names_in(out / EPISODES):
        with contextlib.suppress(Damage):
            if part := opened(out, name):
                found.append(part.origin)
    return found


def refuse_measured(out: Path, manifest: Mapping[str, Any], names: Container[str]) -> None:
    """Refuse a folder whose rows have one of these settings as a column already: what a learner of one's own measured.

    Raises:
        UserError: they have, and what was measured would be taken for the setting.
    """
    for part in names_in(out / EPISODES):
        named = parse_part(part)
        if named is not None and named.hash in hashes(manifest):
            for column in columns_of(out, part):
                if column in names:
                    raise UserError(
                        f"{out}: {column} varies now, and a learner has measured a {column} there: give a new folder "
                        "(--out)"
                    )


def orphans(out: Path) -> list[tuple[str, str]]:
    """Folder and name of files beside episodes that are gone: a part's whose writing or removal was interrupted."""
    whole = set(names_in(out / EPISODES))
    return [
        (folder, name)
        for folder in BESIDE
        for name in names_in(out / folder)
        if parse_part(name) and name not in whole
    ]


def is_ours(out: Path, folder: str, name: str, manifest: Mapping[str, Any]) -> bool:
    """Whether a file beside episodes that are gone is of this sweep, by what it says. Raises OSError."""
    try:
        data = (out / folder / name).read_bytes()
        seal = seal_of(data)
        if seal is None:
            return folder == CORRECTIONS and may_hold_unsealed(manifest) and are_corrections(data)
        return seal["table"] == folder and seal["hash"] in hashes(manifest)
    except (Damage, IsADirectoryError, FileNotFoundError):
        return False


def names_in(folder: Path) -> list[str]:
    """What lies there but for temporary files, sorted; nothing if there is no such folder."""
    try:
        return sorted(path.name for path in folder.iterdir() if target_of(path.name) is None)
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror})") from None


def part_of(
    out: Path, name: str, manifest: Mapping[str, Any], wanted: Mapping[str, Sequence[str] | None]
) -> Part | None:
    """A part by its name, None if it is another sweep's. Raises `Damage`, and `UserError` for what cannot be read."""
    named = parse_part(name)
    if named is not None and named.hash:
        part = _sealed_part(out, name, manifest, wanted)
    elif may_hold_unsealed(manifest) and name.endswith(".parquet"):
        tables = unsealed_tables(out, name, manifest)
        part = tables and Part(name, dict(zip((EPISODES, CORRECTIONS), tables, strict=True)), None, 0)
    else:
        return None
    if part is None:
        return None
    tables = {
        folder: _chosen(_completed(part.tables[folder], folder, part, manifest, columns), columns)
        for folder, columns in wanted.items()
        if folder in part.tables
    }
    return part._replace(tables=tables)


def _sealed_part(
    out: Path, name: str, manifest: Mapping[str, Any], wanted: Mapping[str, Sequence[str] | None]
) -> Part | None:
    named = parse_part(name)
    if named is None or named.hash not in hashes(manifest):
        return None
    part = opened(out, name)
    if part is None or part.origin.versions != manifest["versions"]:
        return None
    data = {EPISODES: part.data} | {folder: beside(out, folder, name, part) for folder in part.sums}
    tables = {
        folder: decoded(data[folder], columns and list(dict.fromkeys([*columns, "algo"])), folder)
        for folder, columns in wanted.items()
        if folder in data
    }
    return Part(name, tables, part.origin, sum(map(len, data.values())))


def _completed(
    table: pa.Table, folder: str, part: Part, manifest: Mapping[str, Any], columns: Sequence[str] | None
) -> pa.Table:
    """The table with those of `columns` that vary in the folder by now, and had one value when it was written.

    Raises:
        Damage: it has rows of a learner whom nobody has asked for.
    """
    asked = requests(manifest)
    if len(asked) < 2:
        return table
    algo = table.column("algo").combine_chunks().dictionary_encode()
    learners = algo.dictionary.to_pylist()
    own = asked[0]["hash"] if part.origin is None else part.origin.hash
    filled, mixed = hashes(manifest)[own], not algos_of(manifest, own).issuperset(learners)
    if mixed:
        filled = filled_in_order(manifest, [own, *(part.origin.before if part.origin else ())])
    for name, by_learner in filled.items():
        column = correction_column(name) if folder == CORRECTIONS else name
        there = column in table.column_names
        if (there and not mixed) or (columns is not None and column not in columns):
            continue
        if not there and (strange := [learner for learner in learners if learner not in by_learner]):
            raise Damage(folder, f"it has rows of {strange[0]}, which nobody has asked for")
        values = pa.array(map(by_learner.get, learners), pa.float64()).take(algo.indices)
        if there:  # put together with others by a version that did not know the value
            place = table.column_names.index(column)
            table = table.set_column(place, column, table.column(place).fill_null(values))
        else:
            table = table.append_column(column, values)
    return table


def _chosen(table: pa.Table, columns: Sequence[str] | None) -> pa.Table:
    return (
        table if columns is None else table.select([name for name in columns if name in table.column_names])
    )
