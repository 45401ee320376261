r"""The inverse Cholesky factor of a Gram matrix, kept up to date in O(n^2).

A *root* is a square matrix S of fixed size with

    S^T S = (K + noise I)^-1        on the points in use, zero rows and columns elsewhere.

It starts as L^-1, the inverse of the Cholesky factor, and stays exactly that as long as points are appended: a new
point adds one row. A point is removed by a Householder reflection Q that turns column i of S into a multiple of one
unit vector; Q S has the same Gram matrix, its row i carries all that S knew of point i, and dropping that row leaves
the root of the remaining points. Row and column i are then free for the next point, in place. All that is a
matrix-vector product, one of two vectors, and one rank-one pass, with no loop over columns; and as Q is orthogonal,
thousands of replacements lose no digits.

`whitened` is S k, k the covariances of an input with the points: its squared norm is the variance that they explain.

Roots are read and written where they are: `roots` holds one or many, `where` is the place of the one that is meant (the
indices of the first axes), and only the rows of its `count` points are touched, some at a time.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree

import gpcjax._x64  # noqa: F401

Root = Float[Array, "n n"]
Roots = Float[Array, "*places n n"]
Vector = Float[Array, " n"]
Places = tuple[Int[Array, ""], ...]

ROWS = 32
"""Rows that are read at once: they stay in the cache for all that is done with them."""

COLUMNS = 256
"""Of a lower triangular root, columns are read up to the next multiple of this."""


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


def whiten(roots: Roots, where: Places, count: Int[Array, ""], covariances: Vector) -> Vector:
    """S k."""
    size = min(ROWS, covariances.shape[0])

    def add(start: Int[Array, ""], _: Int[Array, ""], whitened: Vector) -> Vector:
        rows = take(roots, where, start, (size, covariances.shape[0]))
        return lax.dynamic_update_slice(whitened, rows @ covariances, (start,))

    return _by_rows(covariances.shape[0], count, add, jnp.zeros_like(covariances))


def edit(
    roots: Roots,
    where: Places,
    count: Int[Array, ""],
    index: Int[Array, ""],
    whitened: Vector,
    prior: Float[Array, ""],
    noise: Float[Array, ""],
) -> tuple[Edit, Vector]:
    """What a new point changes that is put into row `index`: the first free one, or that of a point that goes.

    Args:
        roots, where, count: S.
        index: of the point, at most `count`.
        whitened: S k of the new point, where k knows the point that goes too.
        prior: variance of the new point before any data, with noise.
        noise: what its variance cannot fall below.

    Returns:
        The edit, and the old point's column p of the old precision matrix: weights a become a - p (a[index] / p[index])
        without it.
    """
    n = whitened.shape[0]
    here, replaces = jnp.arange(n) == index, index < count
    column = lax.dynamic_slice(roots, _starts((*where, 0, index)), (1,) * len(where) + (n, 1)).reshape(n)
    norm = jnp.sqrt((column * column).sum())
    pivot = jnp.where(here, column, 0.0).sum()
    # The sign that adds to the pivot: the reflector is then never a difference of equals.
    shift = jnp.where(pivot < 0, -norm, norm)
    reflector = jnp.where(replaces, column + jnp.where(here, shift, 0.0), 0.0)
    # |reflector|^2 / 2 = norm^2 + |pivot| norm
    scaled = reflector / jnp.where(replaces, norm * (norm + jnp.abs(pivot)), 1.0)
    # What the other points explain: (Q S) k without its row `index`; column `index` of Q S is zero elsewhere.
    remaining = jnp.where(here, 0.0, whitened - scaled * (reflector * whitened).sum())
    old, product = _products(roots, where, count, (column, remaining))
    image = old + shift * take(roots, where, index, (1, n))[0]
    product = product - (remaining * scaled).sum() * image
    deviation = jnp.sqrt(jnp.maximum(prior - (remaining * remaining).sum(), noise))
    row = jnp.where(here, 1.0, -product) / deviation
    return Edit(index, replaces, scaled, image, row), old


def write(roots: Roots, where: Places, count: Int[Array, ""], edit: Edit, given: Bool[Array, ""]) -> Roots:
    """The roots with an edit of the one at `where`; as they were if it is not `given`."""
    n = edit.row.shape[0]
    size = min(ROWS, n)
    first = jnp.where(edit.replaces, 0, edit.index // size)
    last = jnp.where(edit.replaces, (count + size - 1) // size, first + 1)

    def change(start: Int[Array, ""], fresh: Int[Array, ""], roots: Roots) -> Roots:
        rows, index = take(roots, where, start, (size, n)), start + jnp.arange(size)
        scaled = jnp.where(index >= fresh, lax.dynamic_slice(edit.scaled, (start,), (size,)), 0.0)
        others = jnp.where(jnp.arange(n) == edit.index, 0.0, rows - scaled[:, None] * edit.image[None])
        changed = jnp.where((index == edit.index)[:, None], edit.row[None], others)
        changed = jnp.where(edit.replaces | (index == edit.index)[:, None], changed, rows)
        shape = (1,) * len(where) + (size, n)
        return lax.dynamic_update_slice(roots, changed.reshape(shape), _starts((*where, start, 0)))

    def body(i: Int[Array, ""], roots: Roots) -> Roots:
        return change(jnp.minimum(i * size, n - size), i * size, roots)

    return lax.fori_loop(first, jnp.where(given, last, first), body, roots)


def append(
    roots: Roots,
    where: Places,
    count: Int[Array, ""],
    covariances: Vector,
    prior: Float[Array, ""],
    noise: Float[Array, ""],
) -> tuple[Float[Array, ""], Vector]:
    """Deviation of an input, and the row that it adds as point `count` of a root to which points were only appended.

    Such a root is lower triangular. It is read once, and no more of it than that. `prior` and `noise` as in `edit`.
    """
    n = covariances.shape[0]
    explained, product, size = jnp.zeros(()), jnp.zeros(n), min(ROWS, n)
    for first in range(0, n, COLUMNS):
        end = min(first + COLUMNS, n)

        def add(
            start: Int[Array, ""], fresh: Int[Array, ""], sums: tuple[Array, Array], end: int = end
        ) -> tuple[Array, Array]:
            rows = take(roots, where, start, (size, end))
            whitened = jnp.where(start + jnp.arange(size) >= fresh, rows @ covariances[:end], 0.0)
            return sums[0] + (whitened * whitened).sum(), sums[1] + whitened @ rows

        explained, partial = _by_rows(end, count, add, (explained, jnp.zeros(end)), first, min(size, end))
        product = product.at[:end].add(partial)
    deviation = jnp.sqrt(jnp.maximum(prior - explained, noise))
    return deviation, jnp.where(jnp.arange(n) == count, 1.0, -product) / deviation


def _products(
    roots: Roots, where: Places, count: Int[Array, ""], vectors: tuple[Vector, ...]
) -> tuple[Vector, ...]:
    """v^T S for each vector, one by one: as a product of matrices, XLA would compile it badly inside of a loop."""
    n = vectors[0].shape[0]
    size = min(ROWS, n)

    def add(start: Int[Array, ""], fresh: Int[Array, ""], sums: tuple[Vector, ...]) -> tuple[Vector, ...]:
        rows, counts = take(roots, where, start, (size, n)), start + jnp.arange(size) >= fresh
        parts = (jnp.where(counts, lax.dynamic_slice(v, (start,), (size,)), 0.0) for v in vectors)
        return tuple(total + part @ rows for total, part in zip(sums, parts, strict=True))

    return _by_rows(n, count, add, tuple(map(jnp.zeros_like, vectors)))


def _by_rows(
    n: int,
    count: Int[Array, ""],
    body: Callable[[Int[Array, ""], Int[Array, ""], PyTree], PyTree],
    carry: PyTree,
    first: int = 0,
    size: int | None = None,
) -> PyTree:
    """`body(start, fresh, carry)` for `size` rows from each start, up to the row of the last point.

    The last rows of a root whose size is no multiple begin early: those before `fresh` have been there already.
    """
    size = min(ROWS, n) if size is None else size
    blocks = (jnp.clip(count, first, n) - first + size - 1) // size

    def one(i: Int[Array, ""], carry: PyTree) -> PyTree:
        fresh = first + i * size
        return body(jnp.minimum(fresh, n - size), fresh, carry)

    return lax.fori_loop(0, blocks, one, carry)


def take(
    array: Array, where: Places, start: Int[Array, ""] | int = 0, shape: tuple[int, ...] | None = None
) -> Array:
    """`array[*where]` in one slice, whole or of this shape from `start` on in its first axis."""
    shape = array.shape[len(where) :] if shape is None else shape
    starts = _starts((*where, *(start, 0, 0)[: len(shape)]))
    return lax.dynamic_slice(array, starts, (1,) * len(where) + shape).reshape(shape)


def _starts(indices: tuple[Int[Array, ""] | int, ...]) -> list[Int[Array, ""]]:
    return [jnp.asarray(index, jnp.int32) for index in indices]


def cholesky(gram: Root, active: Bool[Array, " n"], noise: Float[Array, ""]) -> Root:
    """Masked lower Cholesky factor of K + noise I: the identity on unused rows. O(n^3), for GPC-NS."""
    both = active[:, None] & active[None]
    diagonal = jnp.eye(gram.shape[0], dtype=gram.dtype)
    matrix = jnp.where(both, gram, 0.0) + diagonal * jnp.where(active, noise, 1.0)[None]
    return lax.linalg.cholesky(matrix, symmetrize_input=False)


def solve(lower: Root, vector: Vector, transpose: bool = False) -> Vector:
    """L^-1 v, or L^-T v with `transpose`."""
    solution = lax.linalg.triangular_solve(
        lower, vector[:, None], left_side=True, lower=True, transpose_a=transpose
    )
    return solution[:, 0]
