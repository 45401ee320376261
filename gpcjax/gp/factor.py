r"""The inverse Cholesky factor of a Gram matrix, kept up to date in O(n^2).

A *root* is a square matrix S of fixed size with

    S^T S = (K + noise I)^-1        on the points in use, zero rows and columns elsewhere.

It starts as L^-1, the inverse of the Cholesky factor, and stays exactly that as long as points are appended: a new
point adds one row. A point is removed by a Householder reflection Q that turns column i of S into a multiple of one
unit vector; Q S has the same Gram matrix, its row i carries all that S knew of point i, and dropping that row leaves
the root of the remaining points. Row and column i are then free for the next point, in place. Both steps are
matrix-vector products and one rank-one pass: no loop over columns, so they run at full speed under `vmap`, and as Q is
orthogonal thousands of replacements do not lose digits.

Every function takes `write`, a scalar bool: where it is false the root is returned as it was, so that lanes
of a batch that have nothing to do cost no branch.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

import gpcjax._x64  # noqa: F401

Root = Float[Array, "n n"]
Vector = Float[Array, " n"]


def whiten(root: Root, covariances: Vector) -> Vector:
    """S k: its squared norm is the variance that the points explain at the input with covariances k."""
    return root @ covariances


def append(
    root: Root,
    index: Int[Array, ""],
    whitened: Vector,
    variance: Float[Array, ""],
    write: Bool[Array, ""],
) -> tuple[Root, Vector]:
    """Adds a point in the free row `index`; gives the new root and its row, zero with `write` false."""
    here = jnp.arange(root.shape[0]) == index
    row = jnp.where(write, new_row(root, index, whitened, variance), 0.0)
    return jnp.where((here & write)[:, None], row[None], root), row


def new_row(root: Root, index: Int[Array, ""], whitened: Vector, variance: Float[Array, ""]) -> Vector:
    """The row w that a point in the free row `index` adds; all other rows stay as they are.

    `whitened` is S k for the new point, `variance` its predictive variance with noise (the Schur complement).
    The precision matrix grows by w w^T, so the caller can update weights by `w * (w @ targets)`.
    """
    here = jnp.arange(root.shape[0]) == index
    return jnp.where(here, 1.0, -(whitened @ root)) / jnp.sqrt(variance)


def remove(root: Root, index: Int[Array, ""], write: Bool[Array, ""]) -> tuple[Root, Vector]:
    """Removes the point at `index`; gives the new root and the point's column of the old precision matrix.

    The column p lets the caller update weights: `a - p * (a[index] / p[index])`. Row and column `index` of the
    new root are zero.
    """
    here = jnp.arange(root.shape[0]) == index
    column = jnp.take(root, index, axis=1)
    norm = jnp.sqrt((column * column).sum())
    pivot = jnp.where(here, column, 0.0).sum()
    precision_column = column @ root
    # The sign that adds to the pivot: the reflection's vector is then never a difference of equals.
    shift = jnp.where(pivot < 0, -norm, norm)
    reflector = column + jnp.where(here, shift, 0.0)
    image = precision_column + shift * jnp.take(root, index, axis=0)
    # |reflector|^2 / 2 = norm^2 + |pivot| norm
    half = norm * (norm + jnp.abs(pivot))
    factor = 1.0 / jnp.where(write, half, 1.0)
    reflected = root - (factor * reflector)[:, None] * image[None]
    reflected = jnp.where(here[:, None] | here[None], 0.0, reflected)
    return jnp.where(write, reflected, root), precision_column


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
