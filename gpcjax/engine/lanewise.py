"""A block lane by lane: taking one out, putting it back, and going through those that are due.

Lanes are corrected one at a time, since in most rounds few or none are; whatever a lane computes depends on that lane
alone.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int, PyTree


def each(
    pending: Bool[Array, " n"], body: Callable[[Int[Array, ""], PyTree], PyTree], carry: PyTree
) -> PyTree:
    """`body(index, carry)` for each that is pending. Most rounds have none or one."""

    def one(loop: tuple[Bool[Array, " n"], PyTree]) -> tuple[Bool[Array, " n"], PyTree]:
        pending, carry = loop
        index = pending.argmax().astype(jnp.int32)
        return pending.at[index].set(False), body(index, carry)

    return lax.while_loop(lambda loop: loop[0].any(), one, (pending, carry))[1]


def opaque(index: Int[Array, ""], function: Callable[..., PyTree], *operands: PyTree) -> PyTree:
    """`function(*operands)` behind a condition that always holds, which XLA does not know.

    It has to finish the operands before, and the results before anything is made of them. Otherwise it fuses the
    reading of a lane into its update, can then no longer update the block in place, and copies all of it: ten times the
    time of a correction (`benchmarks/README.md`).
    """
    result = jax.eval_shape(function, *operands)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), result)
    return lax.cond(index >= 0, function, lambda *_: nothing, *operands)


def take(tree: PyTree, index: Int[Array, ""], axis: int) -> PyTree:
    """What has this index on an axis of every leaf."""

    def one(leaf: Array) -> Array:
        return lax.dynamic_index_in_dim(leaf, index, axis % leaf.ndim, keepdims=False)

    return jax.tree.map(one, tree)


def put(tree: PyTree, lane: Int[Array, ""], values: PyTree, axis: int) -> PyTree:
    """The tree with these values for one lane."""

    def one(leaf: Array, value: Array) -> Array:
        return lax.dynamic_update_index_in_dim(leaf, value, lane, axis % leaf.ndim)

    return jax.tree.map(one, tree, values)
