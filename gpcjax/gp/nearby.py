"""What points explain of the variance at an input, from those around it, for GPC-NS.

k^T (K + noise I)^-1 k takes a factor of all points of a dictionary, but covariances fall off: of a thousand points the
hundred or two of largest covariance often come to the same number. They are factorised alone: K_11 x = k_1. The others
would add r^T S^-1 r, for what is left of their covariances r = k_2 - K_21 x and the Schur complement S, of which no
eigenvalue is below the noise: at most |r|^2 / noise.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import tiled, tiles
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.tiles import Vector

FEWEST, MOST = 128, 512
"""Points that are tried first, half as many more each time, and at most. Of twice the fewest all are taken at once."""

TOLERANCE = 1e-10
"""By how much the points that are left out may change the deviation, over that of the kernel."""

ROWS = 64
"""Rows of a residual that are computed at once."""


class _Attempt(eqx.Module):
    """What the points before came to, and how many are next."""

    few: Int[Array, ""]
    explained: Float[Array, ""]
    found: Bool[Array, ""]


def explained(
    kernel: Kernel,
    points: Float[Array, "n d"],
    scale: Float[Array, " d"],
    count: Int[Array, ""],
    noise: Float[Array, ""],
    covariances: Vector,
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """k^T (K + noise I)^-1 k of the first `count` points, and whether it is: more than half of them were not tried.

    `covariances` is k, zero from `count` on; n is more than `MOST`. It is not, where k is no number.
    """
    order, room = _nearest_first(covariances), (0, -covariances.shape[0] % ROWS)
    points, covariances = points[order], jnp.pad(covariances[order], room)
    inputs = jnp.pad((points * (scale * kernel.inverse_length)[None]).T, ((0, 0), room))
    # |r|^2 / noise of a variance that is at least the noise: half of it, over its root, of the deviation.
    allowed = 2.0 * TOLERANCE * jnp.sqrt(kernel.variance * noise) * noise

    def goes_on(attempt: _Attempt) -> Bool[Array, ""]:
        few = attempt.few
        return ~attempt.found & (few <= MOST) & ((2 * few <= count) | (few == count))

    def go_on(attempt: _Attempt) -> _Attempt:
        few = attempt.few
        vector = jnp.where(jnp.arange(MOST) < few, covariances[:MOST], 0.0)
        factor = tiled.factor(kernel, points[:MOST], scale, few, noise, vector)
        left = _left(kernel, inputs, count, covariances, few, factor.solved())
        return _Attempt(few + few // 2, (factor.whitened * factor.whitened).sum(), left < allowed)

    few = jnp.where(count <= 2 * FEWEST, count, jnp.int32(FEWEST))
    last = lax.while_loop(goes_on, go_on, _Attempt(few, jnp.zeros(()), jnp.array(False)))
    return last.explained, last.found & jnp.isfinite(covariances.sum())


def _nearest_first(covariances: Vector) -> Int[Array, " n"]:
    """Rows by covariance, the largest first, to some 13 digits.

    The row is in the last bits of what is sorted: sorting numbers alone takes a fifth of the time of `jnp.argsort`.
    """
    n = covariances.shape[0]
    rows = (1 << (n - 1).bit_length()) - 1
    numbers = ~lax.bitcast_convert_type(covariances, jnp.int64)
    return lax.sort(numbers & ~rows | jnp.arange(n), is_stable=False) & rows


def _left(
    kernel: Kernel,
    inputs: Float[Array, "d n"],
    count: Int[Array, ""],
    covariances: Vector,
    few: Int[Array, ""],
    solution: Float[Array, " most"],
) -> Float[Array, ""]:
    """|k - K x|^2 over the rows from `few` on, for an x that is zero there."""
    d = inputs.shape[0]

    def rows(i: Int[Array, ""], total: Float[Array, ""]) -> Float[Array, ""]:
        beside = tiles.cut(inputs, (), (0, i * ROWS), (d, ROWS))

        def columns(j: Int[Array, ""], rest: Float[Array, " rows"]) -> Float[Array, " rows"]:
            above = tiles.cut(inputs, (), (0, j * tiles.ROWS), (d, tiles.ROWS))
            weights = tiles.cut(solution, (), (j * tiles.ROWS,), (tiles.ROWS,))
            gram = kernel.of_differences(above[k][:, None] - beside[k][None] for k in range(d))
            return rest - (gram * weights[:, None]).sum(0)

        rest = tiles.cut(covariances, (), (i * ROWS,), (ROWS,))
        rest = lax.fori_loop(jnp.int32(0), tiles.whole(few, tiles.ROWS), columns, rest)
        row = jnp.arange(ROWS, dtype=jnp.int32) + i * ROWS
        return total + jnp.where((row >= few) & (row < count), rest * rest, 0.0).sum()

    return lax.fori_loop(few // ROWS, tiles.whole(count, ROWS), rows, jnp.zeros(()))
