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

A root is kept in tiles of `ROWS` times up to `COLUMNS` numbers: as a square that is padded to whole tiles, or `lower`,
of points that are only appended, as the tiles up to the diagonal. Roots are read and written where they are: `roots`
holds one or many, `where` is the place of the one that is meant (the indices of the first axes), and only tiles that
its `count` points reach are touched.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree

import gpcjax._x64  # noqa: F401

Roots = Float[Array, "..."]
"""One or many: (*places, rows, columns), or `lower` ones (*places, tiles, rows, columns)."""

Square = Float[Array, "n n"]
Vector = Float[Array, " n"]
Places = tuple[Int[Array, ""], ...]

ROWS, COLUMNS = 8, 128
"""Of a tile. Smaller roots have tiles as wide as they are (`benchmarks/README.md`)."""


def empty(capacity: int, lower: bool = False) -> Roots:
    """The root of no points, with room for `capacity`."""
    size, width = _padded(capacity), _width(capacity)
    return jnp.zeros((_first_tile(size // ROWS, width), ROWS, width) if lower else (size, size))


def grow(root: Roots, capacity: int, lower: bool = False) -> Roots:
    """The same root with room for `capacity` points, as many as it has or more."""
    room = empty(capacity, lower).shape
    return jnp.pad(root, [(0, new - old) for new, old in zip(room, root.shape, strict=True)])


def dense(root: Roots, capacity: int, lower: bool = False) -> Square:
    """S as a matrix."""
    if not lower:
        return root[:capacity, :capacity]
    size, width = _padded(capacity), _width(capacity)
    panels = []
    for panel in range(size // ROWS):
        first, end = _first_tile(panel, width), _first_tile(panel + 1, width)
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
    roots: Roots, where: Places, count: Int[Array, ""], covariances: Vector, lower: bool = False
) -> Float[Array, ""]:
    """|S k|^2; arguments as of `read`."""
    k = _pad(covariances)

    def panel(index: Int[Array, ""], total: Float[Array, ""]) -> Float[Array, ""]:
        whitened = _whiten(_Panel(roots, where, count, index, k.shape[0], lower), k)
        return total + (whitened * whitened).sum()

    return lax.fori_loop(0, _whole(count, ROWS), panel, jnp.zeros(()))


def read(
    roots: Roots,
    where: Places,
    count: Int[Array, ""],
    covariances: Vector,
    point: Int[Array, ""] | None = None,
    lower: bool = False,
) -> Reading:
    """What the root at `where` tells of an input, and the column of the precision matrix that belongs to a `point`.

    Args:
        roots, where, count: S.
        covariances: k, of the input with every point.
        point: whose column is wanted, of a root that is not `lower`; without it there is none (zeros).
        lower: how the root is kept. Static.
    """
    n, k = covariances.shape[0], _pad(covariances)

    def panel(
        index: Int[Array, ""], sums: tuple[Array, tuple[Vector, ...]]
    ) -> tuple[Array, tuple[Vector, ...]]:
        total, products = sums
        rows = _Panel(roots, where, count, index, k.shape[0], lower)
        whitened = _whiten(rows, k)
        factors = [whitened] if point is None else [whitened, rows.column(point)]

        def add(j: Int[Array, ""], products: tuple[Vector, ...]) -> tuple[Vector, ...]:
            tile, start = rows.tile(j), j * rows.width
            sums = (
                lax.dynamic_slice(product, (start,), (rows.width,)) + part @ tile
                for part, product in zip(factors, products, strict=True)
            )
            return tuple(
                lax.dynamic_update_slice(product, total, (start,))
                for product, total in zip(products, sums, strict=True)
            )

        return total + (whitened * whitened).sum(), lax.fori_loop(0, rows.tiles, add, products)

    products = (jnp.zeros_like(k),) * (1 if point is None else 2)
    total, products = lax.fori_loop(0, _whole(count, ROWS), panel, (jnp.zeros(()), products))
    return Reading(total, products[0][:n], jnp.zeros(n) if point is None else products[1][:n])


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
    return deviation, jnp.where(jnp.arange(solved.shape[0]) == index, 1.0, -solved) / deviation


def edit(
    roots: Roots,
    where: Places,
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
    column = _slice(roots, where, (0, index), (n, 1))[:, 0]
    norm = jnp.sqrt((column * column).sum())
    pivot = jnp.where(here, column, 0.0).sum()
    # The sign that adds to the pivot: the reflector is then never a difference of equals.
    shift = jnp.where(pivot < 0, -norm, norm)
    reflector = jnp.where(replaces, column + jnp.where(here, shift, 0.0), 0.0)
    # |reflector|^2 / 2 = norm^2 + |pivot| norm
    scaled = reflector / jnp.where(replaces, norm * (norm + jnp.abs(pivot)), 1.0)
    image = reading.column + shift * _slice(roots, where, (index, 0), (1, n))[0]
    # Without the old point, whose row of Q S is column^T / norm: what it explained, and its part in the weights.
    part = jnp.where(replaces, jnp.where(here, reading.solved, 0.0).sum() / norm, 0.0)
    share = part / jnp.where(replaces, norm, 1.0)
    solved = reading.solved - jnp.where(replaces, reading.column, 0.0) * share
    _, row = new_row(solved, reading.explained - part * part, index, prior, noise)
    return Edit(index, replaces, scaled, image, row)


def write(roots: Roots, where: Places, count: Int[Array, ""], edit: Edit, given: Bool[Array, ""]) -> Roots:
    """The roots with an edit of the one at `where`; as they were if it is not `given`. Not for a `lower` root."""
    scaled, image = _pad(edit.scaled), _pad(edit.image)
    size = scaled.shape[0]

    def panel(index: Int[Array, ""], roots: Roots) -> Roots:
        part = lax.dynamic_slice(scaled, (index * ROWS,), (ROWS,))

        def change(j: Int[Array, ""], roots: Roots) -> Roots:
            rows = _Panel(roots, where, count, index, size, lower=False)
            start = j * rows.width
            columns = lax.dynamic_slice(image, (start,), (rows.width,))
            goes = start + jnp.arange(rows.width) == edit.index
            tile = jnp.where(goes[None], 0.0, rows.tile(j) - part[:, None] * columns[None])
            return _put(roots, where, (index * ROWS, start), tile)

        return lax.fori_loop(0, _whole(count, _width(size)), change, roots)

    panels = jnp.where(given & edit.replaces, _whole(count, ROWS), 0)
    roots = lax.fori_loop(0, panels, panel, roots)
    index = jnp.where(given, edit.index, size)
    return roots.at[(*where, index)].set(_pad(edit.row), mode="drop")


def append(roots: Roots, where: Places, index: Int[Array, ""], row: Vector) -> Roots:
    """The `lower` roots with a row for point `index` of the one at `where`; as they were if there is no such row."""
    n, row = row.shape[0], _pad(row)
    width = _width(n)
    panel = _Panel(roots, where, index + 1, index // ROWS, n, lower=True)

    def put(j: Int[Array, ""], roots: Roots) -> Roots:
        part = lax.dynamic_slice(row, (j * width,), (width,))
        return _put(roots, where, (panel.first + j, index % ROWS, 0), part)

    return lax.fori_loop(0, jnp.where(index < n, panel.tiles, 0), put, roots)


class _Panel:
    """A row of tiles of the root at `where`: rows `index * ROWS` and following."""

    def __init__(
        self,
        roots: Roots,
        where: Places,
        count: Int[Array, ""],
        index: Int[Array, ""],
        size: int,
        lower: bool,
    ):
        self._roots, self._where, self._index, self._lower = roots, where, index, lower
        self.width = _width(size)
        self.first = _first_tile(index, self.width)
        self.tiles = index * ROWS // self.width + 1 if lower else _whole(count, self.width)
        """That are not zero."""

    def tile(self, j: Int[Array, ""]) -> Float[Array, "rows columns"]:
        if self._lower:
            return _slice(self._roots, self._where, (self.first + j, 0, 0), (1, ROWS, self.width))[0]
        return _slice(self._roots, self._where, (self._index * ROWS, j * self.width), (ROWS, self.width))

    def column(self, point: Int[Array, ""]) -> Float[Array, " rows"]:
        """Of a root that is not `lower`."""
        return _slice(self._roots, self._where, (self._index * ROWS, point), (ROWS, 1))[:, 0]


def _whiten(panel: _Panel, covariances: Vector) -> Float[Array, " rows"]:
    """S k for the rows of a panel."""

    def add(j: Int[Array, ""], whitened: Vector) -> Vector:
        part = lax.dynamic_slice(covariances, (j * panel.width,), (panel.width,))
        return whitened + panel.tile(j) @ part

    return lax.fori_loop(0, panel.tiles, add, jnp.zeros(ROWS))


def _padded(n: int) -> int:
    """Numbers of a vector that covers whole tiles."""
    multiple = ROWS if n <= COLUMNS else COLUMNS
    return -(-n // multiple) * multiple


def _width(n: int) -> int:
    """Columns of a tile."""
    return min(_padded(n), COLUMNS)


def _first_tile(panel: Int[Array, ""] | int, width: int) -> Int[Array, ""] | int:
    """Of a panel of a `lower` root: the tiles in all panels before, each as wide as its last row needs."""
    each = width // ROWS
    groups = panel // each
    return each * groups * (groups + 1) // 2 + (panel - each * groups) * (groups + 1)


def _whole(count: Int[Array, ""], size: int) -> Int[Array, ""]:
    """Panels or tiles that hold `count` rows or columns."""
    return (jnp.asarray(count, jnp.int32) + size - 1) // size


def _pad(vector: Vector) -> Float[Array, " padded"]:
    n = vector.shape[0]
    return jnp.pad(vector, (0, _padded(n) - n))


def _slice(
    array: Array, where: Places, starts: tuple[Int[Array, ""] | int, ...], shape: tuple[int, ...]
) -> Array:
    return lax.dynamic_slice(array, _starts((*where, *starts)), (1,) * len(where) + shape).reshape(shape)


def _put(roots: Roots, where: Places, starts: tuple[Int[Array, ""] | int, ...], part: Array) -> Roots:
    part = part.reshape((1,) * (roots.ndim - part.ndim) + part.shape)
    return lax.dynamic_update_slice(roots, part, _starts((*where, *starts)))


def take(array: Array, where: Places) -> Array:
    """`array[*where]` in one slice."""
    shape = array.shape[len(where) :]
    return _slice(array, where, (0,) * len(shape), shape)


def _starts(indices: tuple[Int[Array, ""] | int, ...]) -> list[Int[Array, ""]]:
    return [jnp.asarray(index, jnp.int32) for index in indices]


def cholesky(gram: Square, active: Bool[Array, " n"], noise: Float[Array, ""]) -> Square:
    """Masked lower Cholesky factor of K + noise I: the identity on unused rows. O(n^3), for GPC-NS."""
    both = active[:, None] & active[None]
    diagonal = jnp.eye(gram.shape[0], dtype=gram.dtype)
    matrix = jnp.where(both, gram, 0.0) + diagonal * jnp.where(active, noise, 1.0)[None]
    return _factorise(matrix)


def solve(lower: Square, vector: Vector, transpose: bool = False) -> Vector:
    """L^-1 v, or L^-T v with `transpose`."""
    return (_substitute_back if transpose else _substitute)(lower, vector[:, None])[:, 0]


def one_at_a_time(function: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """`function` of arrays, which under `jax.vmap` computes one lane after the other.

    jaxlib's batched LAPACK kernels (Cholesky, triangular solves) split a batch over XLA's pool of threads where it is
    worth 200,000 operations, and wait for the parts inside a thread of that pool: as many such calls at once as the
    pool has threads wait for each other for ever. 16 lanes with matrices of 64 x 64 did, on two cores, in a process
    with default settings (jaxlib 0.10.2, ParallelBatchMap). A batch of one is computed by the thread that asks.

    What is batched stays a batch of one in any nesting of `vmap`, a condition inside stays a condition, and a lane has
    the numbers that it has alone. `function` closes over no array. Its derivative of either mode is that of what it is
    made of; that must itself be safe under `vmap`, and may compute all lanes in one go.
    """
    single = jax.custom_jvp(jax.custom_batching.sequential_vmap(function))
    single.defjvp(lambda primals, tangents: jax.jvp(function, primals, tangents))
    return single


_factorise = jax.custom_jvp(
    jax.custom_batching.sequential_vmap(lambda matrix: lax.linalg.cholesky(matrix, symmetrize_input=False))
)
"""L of a symmetric matrix L L^T, read from its lower triangle."""


def _substitution(transpose: bool) -> Callable[[Square, Float[Array, "n k"]], Float[Array, "n k"]]:
    """L^-1 B, or L^-T B, as a function of L and B."""

    def substitute(lower: Square, right: Float[Array, "n k"]) -> Float[Array, "n k"]:
        return lax.linalg.triangular_solve(lower, right, left_side=True, lower=True, transpose_a=transpose)

    single = jax.custom_jvp(jax.custom_batching.sequential_vmap(substitute))

    @single.defjvp
    def _(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
        (lower, right), (lower_dot, right_dot) = primals, tangents
        solution, inverse, change = single(lower, right), _inverse(lower), jnp.tril(lower_dot)
        if transpose:
            inverse, change = inverse.T, change.T
        return solution, inverse @ (right_dot - change @ solution)

    return single


_substitute, _substitute_back = _substitution(transpose=False), _substitution(transpose=True)


@_factorise.defjvp
def _(primals: tuple[Square], tangents: tuple[Square]) -> tuple[Square, Square]:
    # Products with the inverse, not substitutions: reverse mode has to turn them round, which it cannot do with a
    # function of its own rule for `vmap`.
    lower = _factorise(*primals)
    inverse = _inverse(lower)
    share = jnp.tril(inverse @ tangents[0] @ inverse.T)
    return lower, lower @ (share - 0.5 * jnp.diag(jnp.diag(share)))


def _inverse(lower: Square) -> Square:
    return _substitute(lower, jnp.eye(lower.shape[0], dtype=lower.dtype))
