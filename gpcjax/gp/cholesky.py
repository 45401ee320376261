"""Cholesky factors of Gram matrices and solves with them, computed anew in O(n^3) and one at a time under `vmap`.

For GPC-NS, whose scale moves every entry of the matrix at each correction, and for a likelihood that is differentiated
(`gpcjax.gp.fit`). A factor that is kept up to date in O(n^2) is in `gpcjax.gp.factor`.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, PyTree

import gpcjax._x64  # noqa: F401
from gpcjax.gp.batching import together

Square = Float[Array, "n n"]
Vector = Float[Array, " n"]


def factor(gram: Square, active: Bool[Array, " n"], noise: Float[Array, ""]) -> Square:
    """Masked lower Cholesky factor of K + noise I: the identity on unused rows."""
    both = active[:, None] & active[None]
    diagonal = jnp.eye(gram.shape[0], dtype=gram.dtype)
    matrix = jnp.where(both, gram, 0.0) + diagonal * jnp.where(active, noise, 1.0)[None]
    return _factorise(matrix)


def solve(lower: Square, vector: Vector, transpose: bool = False) -> Vector:
    """L^-1 v, or L^-T v with `transpose`."""
    return (_substitute_back if transpose else _substitute)(lower, vector[:, None])[:, 0]


def inverse(lower: Square) -> Square:
    """L^-1."""
    return _substitute(lower, jnp.eye(lower.shape[0], dtype=lower.dtype))


def one_at_a_time(
    function: Callable[..., PyTree], derived: Callable[..., PyTree] | None = None
) -> Callable[..., PyTree]:
    """`function` of arrays, which under `jax.vmap` computes one lane after the other.

    jaxlib's batched LAPACK kernels (Cholesky, triangular solves) split a batch over XLA's pool of threads where it is
    worth 200,000 operations, and wait for the parts inside a thread of that pool: as many such calls at once as the
    pool has threads wait for each other for ever. 16 lanes with matrices of 64 x 64 did, on two cores, in a process
    with default settings (jaxlib 0.10.2, ParallelBatchMap). A batch of one is computed by the thread that asks.

    What is batched stays a batch of one in any nesting of `vmap`, a condition inside stays a condition, and a lane has
    the numbers that it has alone. `function` closes over no array. Its derivative of either mode is that of what it is
    made of, or of `derived`, which computes the same; that must itself be safe under `vmap`, and may compute all lanes
    in one go.
    """
    single = jax.custom_jvp(_batched_apart(function))
    single.defjvp(lambda primals, tangents: jax.jvp(derived or function, primals, tangents))
    return single


def _batched_apart(function: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """`function`, which under `jax.vmap` computes one lane after the other; all at once on an accelerator."""
    apart = jax.custom_batching.sequential_vmap(function)

    def choose(*operands: PyTree) -> PyTree:
        return (function if together() else apart)(*operands)

    return choose


_factorise = jax.custom_jvp(
    _batched_apart(lambda matrix: lax.linalg.cholesky(matrix, symmetrize_input=False))
)
"""L of a symmetric matrix L L^T, read from its lower triangle."""


def _substitution(transpose: bool) -> Callable[[Square, Float[Array, "n k"]], Float[Array, "n k"]]:
    """L^-1 B, or L^-T B, as a function of L and B."""

    def substitute(lower: Square, right: Float[Array, "n k"]) -> Float[Array, "n k"]:
        return lax.linalg.triangular_solve(lower, right, left_side=True, lower=True, transpose_a=transpose)

    single = jax.custom_jvp(_batched_apart(substitute))

    @single.defjvp
    def _(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
        (lower, right), (lower_dot, right_dot) = primals, tangents
        solution, inverted, change = single(lower, right), inverse(lower), jnp.tril(lower_dot)
        if transpose:
            inverted, change = inverted.T, change.T
        return solution, inverted @ (right_dot - change @ solution)

    return single


_substitute, _substitute_back = _substitution(transpose=False), _substitution(transpose=True)


@_factorise.defjvp
def _(primals: tuple[Square], tangents: tuple[Square]) -> tuple[Square, Square]:
    # Products with the inverse, not substitutions: reverse mode has to turn them round, which it cannot do with a
    # function of its own rule for `vmap`.
    lower = _factorise(*primals)
    inverted = inverse(lower)
    share = jnp.tril(inverted @ tangents[0] @ inverted.T)
    return lower, lower @ (share - 0.5 * jnp.diag(jnp.diag(share)))
