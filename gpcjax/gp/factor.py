r"""The inverse Cholesky factor of a Gram matrix, kept up to date in O(n^2).

A *root* is a square matrix S of fixed size with

    S^T S = (K + noise I)^-1        on the points in use, zero rows and columns elsewhere.

It starts as L^-1, the inverse of the Cholesky factor, and stays exactly that as long as points are appended: a new
point adds one row. A point is removed by a Householder reflection Q that turns column i of S into a multiple of one
unit vector; Q S has the same Gram matrix, its row i carries all that S knew of point i, and dropping that row leaves
the root of the remaining points. Row and column i are then free for the next point, in place. All that takes one pass
over S that reads and one, of rank one, that writes; and as Q is orthogonal, thousands of replacements lose no digits.

With k the covariances of an input with the points, |S k|^2 is the variance that they explain, and S^T S k are the
weights with which they do. Both, and a column of the precision matrix S^T S, come from one pass over the root.

A root is kept in tiles (`gpcjax.gp.tiles`). `roots` holds one or many, `place` is the place of the one that is meant,
and only tiles that its `count` points reach are touched; where lanes are computed together (`gpcjax.gp.batching`),
all of a root in one operation.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

import gpcjax._x64  # noqa: F401
from gpcjax.gp import cholesky, tiles
from gpcjax.gp.batching import together
from gpcjax.gp.tiles import ROWS, Places, Roots, Vector

Square = Float[Array, "n n"]


def empty(capacity: int, lower: bool = False) -> Roots:
    """The root of no points, with room for `capacity`."""
    size, width = tiles.padded(capacity), tiles.width(capacity)
    return jnp.zeros((tiles.first_tile(size // ROWS, width), ROWS, width) if lower else (size, size))


def grow(root: Roots, capacity: int, lower: bool = False) -> Roots:
    """The same root with room for `capacity` points, as many as it has or more."""
    room = empty(capacity, lower).shape
    return jnp.pad(root, [(0, new - old) for new, old in zip(room, root.shape, strict=True)])


def of_points(gram: Square, active: Bool[Array, " n"], noise: Float[Array, ""], lower: bool = False) -> Roots:
    """The root of points with this Gram matrix, computed anew in O(n^3): L^-1, where points are `active`."""
    inverse = cholesky.inverse(cholesky.factor(gram, active, noise))
    used = jnp.where(active[:, None] & active[None], inverse, 0.0)
    capacity = gram.shape[0]
    size, width = tiles.padded(capacity), tiles.width(capacity)
    square = jnp.pad(used, (0, size - capacity))
    if not lower:
        return square
    panels = []
    for panel in range(size // ROWS):
        count = tiles.first_tile(panel + 1, width) - tiles.first_tile(panel, width)
        rows = square[panel * ROWS : (panel + 1) * ROWS, : count * width]
        panels.append(jnp.moveaxis(rows.reshape(ROWS, count, width), 1, 0))
    return jnp.concatenate(panels)


def dense(root: Roots, capacity: int, lower: bool = False) -> Square:
    """S as a matrix."""
    if not lower:
        return root[:capacity, :capacity]
    size, width = tiles.padded(capacity), tiles.width(capacity)
    panels = []
    for panel in range(size // ROWS):
        first, end = tiles.first_tile(panel, width), tiles.first_tile(panel + 1, width)
        rows = jnp.moveaxis(root[first:end], 0, 1).reshape(ROWS, -1)
        panels.append(jnp.pad(rows, ((0, 0), (0, size - rows.shape[1]))))
    return jnp.concatenate(panels)[:capacity, :capacity]


class Reading(eqx.Module):
    """What a root tells of an input."""

    explained: Float[Array, ""]
    """|S k|^2: the part of the input's variance that the points explain."""
    solved: Vector
    """S^T S k = (K + noise I)^-1 k."""
    column: Vector
    """Of the precision matrix S^T S, for the point that was asked for."""
    entries: Vector
    """The column of S itself, for the same point."""


class Edit(eqx.Module):
    """What a new point changes in a root: a rank-one pass takes the old point out, then a row is written."""

    index: Int[Array, ""]
    replaces: Bool[Array, ""]
    """Whether row `index` holds an old point, which goes."""
    scaled: Vector
    image: Vector
    """S becomes S - scaled image^T, without column `index`."""
    row: Vector
    """Of the new point. The precision matrix grows by row row^T after the old point is gone."""


def explained(
    roots: Roots, place: Places, count: Int[Array, ""], covariances: Vector, lower: bool = False
) -> Float[Array, ""]:
    """|S k|^2; arguments as of `read`."""
    k = tiles.pad(covariances)
    if together():
        return jnp.square(_whole(roots, place, k.shape[0], lower) @ k).sum()

    def panel(index: Int[Array, ""], total: Float[Array, ""]) -> Float[Array, ""]:
        whitened = tiles.Panel(roots, place, count, index, k.shape[0], lower).product(k)
        return total + (whitened * whitened).sum()

    return lax.fori_loop(0, tiles.whole(count, ROWS), panel, jnp.zeros(()))


def read(
    roots: Roots,
    place: Places,
    count: Int[Array, ""],
    covariances: Vector,
    point: Int[Array, ""] | None = None,
    lower: bool = False,
) -> Reading:
    """What the root at `place` tells of an input, and the column of the precision matrix that belongs to a `point`.

    Args:
        roots, where, count: S.
        covariances: k, of the input with every point.
        point: whose column is wanted, of a root that is not `lower`; without it there is none (zeros).
        lower: how the root is kept. Static.
    """
    n, k = covariances.shape[0], tiles.pad(covariances)
    if together():
        root = _whole(roots, place, k.shape[0], lower)
        whitened = root @ k
        entries = jnp.zeros(k.shape[0]) if point is None else jnp.take(root, point, axis=1)
        column = entries @ root
        return Reading(jnp.square(whitened).sum(), (whitened @ root)[:n], column[:n], entries[:n])

    def panel(
        index: Int[Array, ""], sums: tuple[Array, tuple[Vector, ...], Vector]
    ) -> tuple[Array, tuple[Vector, ...], Vector]:
        total, products, entries = sums
        rows = tiles.Panel(roots, place, count, index, k.shape[0], lower)
        whitened = rows.product(k)
        factors = [whitened]
        if point is not None:
            here = rows.column(point)
            factors.append(here)
            entries = lax.dynamic_update_slice(entries, here, (index * ROWS,))

        def add(j: Int[Array, ""], products: tuple[Vector, ...]) -> tuple[Vector, ...]:
            return tuple(rows.add(j, part, product) for part, product in zip(factors, products, strict=True))

        return total + (whitened * whitened).sum(), lax.fori_loop(0, rows.tiles, add, products), entries

    nothing = jnp.zeros_like(k)
    sums = jnp.zeros(()), (nothing,) * (1 if point is None else 2), nothing
    total, products, entries = lax.fori_loop(0, tiles.whole(count, ROWS), panel, sums)
    column = nothing if point is None else products[1]
    return Reading(total, products[0][:n], column[:n], entries[:n])


def new_row(
    solved: Vector, explained: Float[Array, ""], index: Int[Array, ""], prior: Array, noise: Array
) -> tuple[Float[Array, ""], Vector]:
    """Deviation of an input, and the row that it adds to a root as point `index`, which the root knows nothing of yet.

    Args:
        solved, explained: of the input, as `read` gives them.
        index: of its row.
        prior: its variance before any data, with noise.
        noise: what its variance cannot fall below.
    """
    deviation = jnp.sqrt(jnp.maximum(prior - explained, noise))
    return deviation, row_of(solved, index, deviation)


def row_of(solved: Vector, index: Int[Array, ""], deviation: Float[Array, ""]) -> Vector:
    """The row that an input adds to a root as point `index`; arguments as of `new_row`."""
    return jnp.where(jnp.arange(solved.shape[0]) == index, 1.0, -solved) / deviation


def edit(
    roots: Roots,
    place: Places,
    count: Int[Array, ""],
    index: Int[Array, ""],
    reading: Reading,
    prior: Float[Array, ""],
    noise: Float[Array, ""],
) -> Edit:
    """What a new point changes that is put into row `index`: the first free one, or that of a point that goes.

    Args:
        roots, where, count: S.
        index: of the point, at most `count`.
        reading: of the new point. If it replaces one: with that one's column, and from covariances that know it too.
        prior, noise: see `new_row`.
    """
    n = reading.solved.shape[0]
    here, replaces = jnp.arange(n) == index, index < count
    column = reading.entries
    norm, pivot = jnp.sqrt((column * column).sum()), tiles.take(column, (index,))
    # The sign that adds to the pivot: the reflector is then never a difference of equals.
    shift = jnp.where(pivot < 0, -norm, norm)
    reflector = jnp.where(replaces, column + jnp.where(here, shift, 0.0), 0.0)
    # |reflector|^2 / 2 = norm^2 + |pivot| norm
    scaled = reflector / jnp.where(replaces, norm * (norm + jnp.abs(pivot)), 1.0)
    image = reading.column + shift * tiles.cut(roots, place, (index, 0), (1, n))[0]
    # Without the old point, whose row of Q S is column^T / norm: what it explained, and its part in the weights.
    part = jnp.where(replaces, tiles.take(reading.solved, (index,)) / norm, 0.0)
    share = part / jnp.where(replaces, norm, 1.0)
    solved = reading.solved - jnp.where(replaces, reading.column, 0.0) * share
    _, row = new_row(solved, reading.explained - part * part, index, prior, noise)
    return Edit(index, replaces, scaled, image, row)


def write(roots: Roots, place: Places, count: Int[Array, ""], edit: Edit, given: Bool[Array, ""]) -> Roots:
    """The roots with an edit of the one at `place`; as they were if it is not `given`. Not for a `lower` root."""
    scaled, image = tiles.pad(edit.scaled), tiles.pad(edit.image)
    size = scaled.shape[0]
    index = jnp.where(given, edit.index, size)
    if together():
        changes, rows = given & edit.replaces, jnp.arange(size)
        before = tiles.take(roots, place)
        after = jnp.where(rows[None] == edit.index, 0.0, before - scaled[:, None] * image[None])
        after = jnp.where(changes, after, before)
        row = tiles.pad(edit.row)[None]
        return tiles.put(roots, place, (0, 0), jnp.where(rows[:, None] == index, row, after))

    def panel(index: Int[Array, ""], roots: Roots) -> Roots:
        part = lax.dynamic_slice(scaled, (index * ROWS,), (ROWS,))

        def change(j: Int[Array, ""], roots: Roots) -> Roots:
            rows = tiles.Panel(roots, place, count, index, size, lower=False)
            start = j * rows.width
            columns = lax.dynamic_slice(image, (start,), (rows.width,))
            goes = start + jnp.arange(rows.width) == edit.index
            tile = jnp.where(goes[None], 0.0, rows.tile(j) - part[:, None] * columns[None])
            return tiles.put(roots, place, (index * ROWS, start), tile)

        return lax.fori_loop(0, tiles.whole(count, tiles.width(size)), change, roots)

    panels = jnp.where(given & edit.replaces, tiles.whole(count, ROWS), 0)
    roots = lax.fori_loop(0, panels, panel, roots)
    return roots.at[(*place, index)].set(tiles.pad(edit.row), mode="drop")


def append(roots: Roots, place: Places, index: Int[Array, ""], row: Vector) -> Roots:
    """The `lower` roots with a row for point `index` of the one at `place`; as they were if there is no such row."""
    n, row = row.shape[0], tiles.pad(row)
    width = tiles.width(n)
    panel = tiles.Panel(roots, place, index + 1, index // ROWS, n, lower=True)

    def put(j: Int[Array, ""], roots: Roots) -> Roots:
        part = lax.dynamic_slice(row, (j * width,), (width,))
        return tiles.put(roots, place, (panel.first + j, index % ROWS, 0), part)

    if together():
        tile = jnp.arange(row.shape[0] // width)
        written = jnp.where((index < n) & (tile < panel.tiles), panel.first + tile, roots.shape[len(place)])
        return roots.at[(*place, written, index % ROWS)].set(row.reshape(-1, width), mode="drop")
    return lax.fori_loop(0, jnp.where(index < n, panel.tiles, 0), put, roots)


def _whole(roots: Roots, place: Places, size: int, lower: bool) -> Square:
    """S of the one at `place` as a matrix, with its empty rows."""
    return dense(tiles.take(roots, place), size, lower)
