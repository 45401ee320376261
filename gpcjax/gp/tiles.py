"""How roots (`gpcjax.gp.factor`) are kept: in tiles of `ROWS` times up to `COLUMNS` numbers.

A root is a square that is padded to whole tiles, or `lower`, of points that are only appended: the tiles up to the
diagonal, panel by panel. Arrays are read and written where they are: the first axes of one are places, and `place`, an
index for each of them, is the place that is meant.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

Roots = Float[Array, "..."]
"""One or many: (*places, rows, columns), or `lower` ones (*places, tiles, rows, columns)."""

Vector = Float[Array, " n"]
Places = tuple[Int[Array, ""], ...]

ROWS, COLUMNS = 8, 128
"""Numbers of a tile. Smaller roots have tiles as wide as they are (`benchmarks/README.md`)."""

LANES = 16
"""Sums in which a row's product with a vector is taken at once: two of the widest vectors (`benchmarks/README.md`)."""


class Panel:
    """A row of tiles of the root at `place`: rows `index * ROWS` and following."""

    def __init__(
        self,
        roots: Roots,
        place: Places,
        count: Int[Array, ""],
        index: Int[Array, ""],
        size: int,
        lower: bool,
    ):
        self._roots, self._where, self._index, self._lower = roots, place, index, lower
        self.width = width(size)
        self.first = first_tile(index, self.width)
        self.tiles = index * ROWS // self.width + 1 if lower else whole(count, self.width)
        """How many of its tiles are not all zeros."""

    def tile(self, j: Int[Array, ""]) -> Float[Array, "rows columns"]:
        """Tile `j` of the row."""
        if self._lower:
            return cut(self._roots, self._where, (self.first + j, 0, 0), (1, ROWS, self.width))[0]
        return cut(self._roots, self._where, (self._index * ROWS, j * self.width), (ROWS, self.width))

    def product(self, vector: Vector) -> Float[Array, " rows"]:
        """Its rows times a vector.

        Written out as sums of vectors, which are added up in the end: so XLA reads the tiles where they are. For
        `jnp.dot` it takes a copy of each first, and twice as long.
        """
        width = self.width
        lanes = LANES if width % LANES == 0 else ROWS

        def add(j: Int[Array, ""], sums: Float[Array, "rows lanes"]) -> Float[Array, "rows lanes"]:
            tile, part = self.tile(j), lax.dynamic_slice(vector, (j * width,), (width,))
            for first in range(0, width, lanes):
                sums += tile[:, first : first + lanes] * part[None, first : first + lanes]
            return sums

        return lax.fori_loop(0, self.tiles, add, jnp.zeros((ROWS, lanes))).sum(1)

    def add(self, j: Int[Array, ""], weights: Float[Array, " rows"], total: Vector) -> Vector:
        """`total` and, where tile `j` is, the weighted sum of its rows; written out for the same reason."""
        tile, start = self.tile(j), (j * self.width,)
        part = lax.dynamic_slice(total, start, (self.width,))
        for row in range(ROWS):
            part += weights[row] * tile[row]
        return lax.dynamic_update_slice(total, part, start)

    def column(self, point: Int[Array, ""]) -> Float[Array, " rows"]:
        """Its part of column `point`, of a root that is not `lower`."""
        return cut(self._roots, self._where, (self._index * ROWS, point), (ROWS, 1))[:, 0]


def padded(n: int) -> int:
    """Numbers of a vector that covers whole tiles."""
    multiple = ROWS if n <= COLUMNS else COLUMNS
    return -(-n // multiple) * multiple


def width(n: int) -> int:
    """Columns of a tile."""
    return min(padded(n), COLUMNS)


def first_tile(panel: Int[Array, ""] | int, width: int) -> Int[Array, ""] | int:
    """The first tile of a `lower` root's panel: their number in all before, each as wide as its last row needs."""
    each = width // ROWS
    groups = panel // each
    return each * groups * (groups + 1) // 2 + (panel - each * groups) * (groups + 1)


def whole(count: Int[Array, ""], size: int) -> Int[Array, ""]:
    """Panels or tiles that hold `count` rows or columns."""
    return (jnp.asarray(count, jnp.int32) + size - 1) // size


def pad(vector: Vector) -> Float[Array, " padded"]:
    """The vector with zeros up to whole tiles."""
    n = vector.shape[0]
    return jnp.pad(vector, (0, padded(n) - n))


def cut(
    array: Array, place: Places, starts: tuple[Int[Array, ""] | int, ...], shape: tuple[int, ...]
) -> Array:
    """The block of this shape that begins at `starts`, of the array at `place`."""
    return lax.dynamic_slice(array, _starts((*place, *starts)), (1,) * len(place) + shape).reshape(shape)


def put(roots: Roots, place: Places, starts: tuple[Int[Array, ""] | int, ...], part: Array) -> Roots:
    """The roots with a block that begins at `starts`, of the one at `place`; its first axes of one may be left out."""
    part = part.reshape((1,) * (roots.ndim - part.ndim) + part.shape)
    return lax.dynamic_update_slice(roots, part, _starts((*place, *starts)))


def take(array: Array, place: Places) -> Array:
    """`array[*where]` in one slice."""
    shape = array.shape[len(place) :]
    return cut(array, place, (0,) * len(shape), shape)


def _starts(indices: tuple[Int[Array, ""] | int, ...]) -> list[Int[Array, ""]]:
    return [jnp.asarray(index, jnp.int32) for index in indices]
