"""The rows of a sweep on their way into its run folder: written once, atomically. Loads no jax.

A part holds the rows of some finished cells: `episodes/NAME.parquet` and `corrections/NAME.parquet` of the same
name. What lies beside the episodes is written first; a part without episodes was interrupted, and is removed when the
sweep goes on. What makes a part whole, and one of this sweep, is in `gpcjax.sweep.parts`.

Many small parts become one as they come: the new one says which it replaces, and only then do these go. Whoever is
killed in between leaves both, and the rows count once.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.blocks import Block
from gpcjax.sweep.digests import ENTRY as DIGESTS
from gpcjax.sweep.growth import algos_of, hashes, requests
from gpcjax.sweep.keeping import ENTRY as KEEPING
from gpcjax.sweep.layout import (
    BESIDE,
    DAMAGED,
    EPISODES,
    Say,
    parse_part,
    part_name,
    sha256,
    tell,
)
from gpcjax.sweep.parts import Found, is_ours, names_in, orphans, part_of, whole_parts
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.rows import IDENTITY, CellRows, cells_of, key_of, of_cells, tables_of
from gpcjax.sweep.runfolder import clean_parts, set_aside
from gpcjax.sweep.sealing import Damage, Origin, sealed
from gpcjax.sweep.unsealed import may_hold_unsealed

TOGETHER = 16
"""So many parts of about one size become one."""

LARGEST_PART = 1 << 26
"""Bytes from which a part stays as it is, and parts are put together, however few: they go through memory."""

SEALED = (KEEPING, DIGESTS)
"""Entries of a manifest that its parts have, too."""


class Store:
    """The parts of one run folder, for the one process that writes there (`gpcjax.sweep.lock.held`).

    Args:
        out: the run folder; it exists.
        manifest: what it says of the sweep.
        machine: `gpcjax.sweep.machine.kind_of` the machine that computes what will be appended, where its rows do not
            name another one.
        say: takes a line for the person.
        request: the hash of the specification that asked for what will be appended, the first one's by default. Rows of
            a learner whom it does not name go under the last one that does.
    """

    def __init__(
        self, out: Path, manifest: Mapping[str, Any], machine: str = "", say: Say = tell, request: str = ""
    ):
        self._out, self._manifest, self._say = out, manifest, say
        self._varying = tuple(manifest["varying"])
        asked = requests(manifest)
        self._asked = {each["hash"]: each["specification"] for each in asked}
        self._origin = Origin(
            request or asked[0]["hash"],
            manifest["versions"],
            machine,
            order=list(self._asked),
        )
        self._algos = {each: algos_of(manifest, each) for each in self._asked}
        """The learners of each request: what its parts lack is known of these alone."""
        self._named: dict[str, Sequence[str]] = {}
        """By part: the requests that it tells of."""
        for folder in (EPISODES, *BESIDE):
            (out / folder).mkdir(exist_ok=True)
        numbers = [part.number for name in names_in(out / EPISODES) if (part := parse_part(name))]
        self._next = max(numbers, default=-1) + 1
        self._small: dict[tuple[str, tuple[str, ...], int], dict[str, int]] = {}
        """Parts that could become one with others, and their bytes: by their kind of machine, the learners of their
        request and about how large. What such parts lack has the same values for all of them."""
        self._stored: set[tuple[Any, ...]] = set()
        self.machines: set[str] = set()
        """Kinds of machines that have computed what is stored; known once it was asked what is `missing`."""

    def missing(self, cells: Iterable[Cell]) -> list[Cell]:
        """The cells that have no rows yet.

        What is damaged is moved to `OUT/damaged`, with a line, and its cells are missing; what an interruption left
        behind is removed. What is not ours stays as it is.
        """
        clean_parts(self._out)
        columns, found = [*IDENTITY, *self._varying], Found()
        stored = self._stored = set[tuple[Any, ...]]()
        for part in whole_parts(self._out, self._manifest, found, {EPISODES: columns}):
            held = cells_of(part.tables[EPISODES], columns)
            found.repeated += len(held & stored)
            stored |= held
            self.machines.add("" if part.origin is None else part.origin.machine)
            if part.origin is not None:
                self._named[part.name] = part.origin.named
                # Of others nothing is known by their request: they stay as they are.
                if self._algos[part.origin.hash].issuperset(_algos(part.tables)):
                    self._note(part.name, part.size, part.origin.machine, part.origin.hash)
        self._remove(found.replaced)
        for folder, name in orphans(self._out):
            part = parse_part(name)
            unsealed = may_hold_unsealed(self._manifest) and not getattr(part, "hash", "")
            if part is not None and not unsealed and part.hash not in hashes(self._manifest):
                found.foreign.append(f"{folder}/{name}")
            elif is_ours(self._out, folder, name, self._manifest):
                (self._out / folder / name).unlink(missing_ok=True)
            else:
                found.damaged[f"{folder}/{name}"] = "it belongs to no episodes"
        for name in found.parts:
            set_aside(self._out, *(self._out / folder / name for folder in (EPISODES, *BESIDE)))
        missing = [cell for cell in cells if not self.holds(cell)]
        again = ", what is missing runs again" if missing else ""
        if not missing and self.cells < self._manifest["cells"]:
            again = ", what is missing runs again by the command that asked for it (gpcjax show)"
        found.speak(self._out, self._say, f"moved to {self._out / DAMAGED}{again}")
        return missing

    def holds(self, cell: Cell) -> bool:
        """Whether a cell has rows; known once it was asked what is `missing`."""
        return key_of(cell, self._varying) in self._stored

    @property
    def cells(self) -> int:
        """Cells that are stored."""
        return len(self._stored)

    def append(self, rows: Sequence[CellRows | Block]) -> None:
        """Writes the rows of some cells, and puts many parts together as one.

        They become a part for each kind of machine; more where no request has asked for all of their learners.
        """
        apart: dict[tuple[str, str], list[CellRows | Block]] = {}
        for request, row in itertools.chain.from_iterable(map(self._by_request, rows)):
            apart.setdefault((row.machine or self._origin.machine, request), []).append(row)
        for (machine, request), theirs in apart.items():
            alone = [each for each in theirs if isinstance(each, CellRows)]
            tables = [each.tables for each in theirs if isinstance(each, Block)]
            self._write(
                _joined([*([tables_of(alone, self._varying)] if alone else []), *tables]), machine, request
            )
            self.machines.add(machine)
            self._stored |= {key_of(cell, self._varying) for each in theirs for cell in each.cells}
        for key in sorted(self._small):
            sizes, (machine, algos, _) = self._small[key], key
            if len(sizes) >= TOGETHER or (len(sizes) > 1 and sum(sizes.values()) >= LARGEST_PART):
                self._put_together(
                    list(self._small.pop(key)), machine, self._request_of(algos) or self._origin.hash
                )

    def _by_request(self, row: CellRows | Block) -> Iterator[tuple[str, CellRows | Block]]:
        """The same rows with the hash of the request that they go under: apart by learners where these share none."""
        algos = {cell.algo for cell in row.cells}
        request = self._request_of(algos)
        if request is None and isinstance(row, Block) and len(algos) > 1:
            for algo in sorted(algos):
                mine = row.chosen([place for place, cell in enumerate(row.cells) if cell.algo == algo])
                yield from self._by_request(mine)
        else:
            yield request or self._origin.hash, row

    def _request_of(self, algos: Iterable[str]) -> str | None:
        """The hash of the request of what is appended, or of the last one that asked for all of these learners."""
        wanted = frozenset(algos)
        every = (self._origin.hash, *reversed(self._asked))
        return next((each for each in every if wanted <= self._algos.get(each, frozenset())), None)

    def put(self, tables: Mapping[str, pa.Table], machine: str = "") -> None:
        """Writes rows that are tables already, as `gpcjax.sweep.rows.tables_of` makes them: one part, as it is."""
        self._write(tables, machine or self._origin.machine, self._origin.hash)

    def _write(
        self, tables: Mapping[str, pa.Table], machine: str, request: str, replaces: Sequence[str] = ()
    ) -> None:
        known = set(itertools.chain.from_iterable(self._named.values()))
        new = {request, *(each for name in replaces for each in self._named.get(name, ()))}
        asked = {hash_: each for hash_, each in self._asked.items() if hash_ in new or hash_ not in known}
        origin = self._origin._replace(
            hash=request,
            machine=machine,
            asked=list(asked.values()),
            named=list(asked),
            manifest={name: self._manifest[name] for name in SEALED if name in self._manifest},
        )
        files = {folder: sealed(tables[folder], folder, origin) for folder in BESIDE if folder in tables}
        sums = {folder: sha256(data) for folder, data in files.items()}
        episodes = sealed(tables[EPISODES], EPISODES, origin, sums, replaces)
        name = part_name(self._next, request, episodes)
        for folder, data in files.items():
            write_atomic(self._out / folder / name, data)
        write_atomic(self._out / EPISODES / name, episodes)
        self._next += 1
        self._named[name] = list(asked)
        self._note(name, len(episodes) + sum(map(len, files.values())), machine, request)

    def _note(self, name: str, size: int, machine: str, request: str) -> None:
        if size < LARGEST_PART:
            algos, about = self._algos.get(request, frozenset()), int(math.log(size, TOGETHER / 2))
            self._small.setdefault((machine, tuple(sorted(algos)), about), {})[name] = size

    def _put_together(self, names: Sequence[str], machine: str, request: str) -> None:
        """Writes the rows of some parts as one, then removes them. Leaves them where one is damaged by now."""
        wanted: dict[str, Sequence[str] | None] = dict.fromkeys((EPISODES, *BESIDE))
        try:
            parts = [part_of(self._out, name, self._manifest, wanted) for name in names]
        except Damage:
            return
        found = list[Mapping[str, pa.Table]]()
        keys, seen = [*IDENTITY, *self._varying], set[tuple[Any, ...]]()
        for part in parts:
            if part is None:
                return
            cells = cells_of(part.tables[EPISODES], keys)
            # Whatever came twice: within a part nobody would find it again.
            found.append(of_cells(part.tables, keys, cells - seen) if cells & seen else part.tables)
            seen |= cells
        self._write(_joined(found), machine, request, replaces=names)
        self._remove(names)

    def _remove(self, names: Iterable[str]) -> None:
        """Removes parts whose rows are in another one."""
        for name in names:
            self._named.pop(name, None)
            for folder in (EPISODES, *BESIDE):
                (self._out / folder / name).unlink(missing_ok=True)


def _algos(tables: Mapping[str, pa.Table]) -> set[str]:
    """The learners of a part."""
    return set(tables[EPISODES].column("algo").unique().to_pylist())


def _joined(parts: Sequence[Mapping[str, pa.Table]]) -> Mapping[str, pa.Table]:
    """The tables of some parts as those of one."""
    if len(parts) == 1:
        return parts[0]
    found = {folder: [part[folder] for part in parts if folder in part] for folder in (EPISODES, *BESIDE)}
    return {
        folder: pa.concat_tables(tables, promote_options="permissive").combine_chunks()
        for folder, tables in found.items()
        if tables
    }
