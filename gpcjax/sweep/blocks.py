"""The rows of some finished cells as tables, made where they were computed: on their way to the store. Loads no jax.

Whoever hands out cells to thousands of machines has no time to make tables of what comes back: it takes most of what
a row costs there. Tables travel as Arrow's own bytes, which are read without a copy.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from gpcjax.sweep.layout import EPISODES
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.rows import CellRows, Run, counts_of, tables_of


@dataclass(frozen=True, eq=False)
class Block:
    """What some finished cells leave.

    | Field     | Meaning                                                                   |
    |-----------|---------------------------------------------------------------------------|
    | `cells`   | which                                                                     |
    | `counts`  | rows of each in each table, where they follow each other in this order      |
    | `tables`  | as `gpcjax.sweep.rows.tables_of` makes them, by the folder that each goes to |
    | `machine` | the kind of machine that computed it; empty for the one that stores it     |
    """

    cells: tuple[Cell, ...]
    counts: Mapping[str, tuple[int, ...]]
    tables: Mapping[str, pa.Table]
    machine: str = ""

    @property
    def runs(self) -> Iterator[Run]:
        """Each cell."""
        episodes = self.tables[EPISODES]
        returns, lengths = (episodes.column(name).to_numpy() for name in ("return", "length"))
        first = 0
        for cell, count in zip(self.cells, self.counts[EPISODES], strict=True):
            last = first + count
            yield Run(cell, returns[first:last], lengths[first:last])
            first = last

    def chosen(self, places: Sequence[int]) -> "Block":
        """Of the cells in these places alone."""
        tables = {}
        for folder, table in self.tables.items():
            counts = self.counts[folder]
            starts = list(itertools.accumulate(counts, initial=0))
            tables[folder] = pa.concat_tables([table.slice(starts[place], counts[place]) for place in places])
        counts = {folder: tuple(each[place] for place in places) for folder, each in self.counts.items()}
        return dataclasses.replace(
            self, cells=tuple(self.cells[place] for place in places), counts=counts, tables=tables
        )

    def __reduce__(self) -> tuple[Any, ...]:
        packed = {folder: _packed(table) for folder, table in self.tables.items()}
        return _unpacked, (self.cells, self.counts, packed, self.machine)


def block_of(rows: Sequence[CellRows], varying: Sequence[str]) -> Block:
    """The rows of some cells of one machine as a block.

    Args:
        rows: of each cell.
        varying: settings with more than one value in the folder that they go to.
    """
    cells = tuple(row.cell for row in rows)
    return Block(cells, counts_of(rows), tables_of(rows, varying), rows[0].machine)


def _packed(table: pa.Table) -> pa.Buffer:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as stream:
        stream.write_table(table)
    return sink.getvalue()


def _unpacked(
    cells: tuple[Cell, ...],
    counts: Mapping[str, tuple[int, ...]],
    packed: Mapping[str, pa.Buffer],
    machine: str,
) -> Block:
    """Raises ValueError (also Arrow's) where these do not fit together."""
    tables = {folder: pa.ipc.open_stream(buffer).read_all() for folder, buffer in packed.items()}
    for folder, table in tables.items():
        told = counts[folder]
        if len(cells) != len(told) or table.num_rows != sum(told):
            raise ValueError(
                f"{folder} of a block of {len(cells)} cells: {table.num_rows} rows, not {sum(told)}"
            )
    return Block(cells, counts, tables, machine)
