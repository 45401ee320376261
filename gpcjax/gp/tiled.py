"""Gram matrices that are factorised while they are made, tile by tile, for GPC-NS: K + noise I = U^T U.

Loops go over the tiles of the points in use, however much room there is, and XLA compiles all of them to one function.
With some hundred points that takes less time than LAPACK for a matrix that was made before (`benchmarks/README.md`),
and no number depends on how a library splits its work.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from gpcjax.gp import tiles
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.tiles import ROWS as SIDE

Tile = Float[Array, "side side"]
Index = Int[Array, ""]
Room = Float[Array, "m more"]


class Factor(eqx.Module):
    """U of the points in use, and one vector v.

    `matrix` has the tiles of U above the diagonal, U^-T of those on it, and beside it in a column of tiles U^-T v.
    """

    matrix: Room
    count: Index

    @property
    def whitened(self) -> Float[Array, " m"]:
        """U^-T v: its squares add up to v^T (K + noise I)^-1 v. Zero where no point is in use."""
        return self.matrix[:, self.matrix.shape[0]]

    def solved(self) -> Float[Array, " m"]:
        """(K + noise I)^-1 v, zero where no point is in use."""
        used, whitened = tiles.whole(self.count, SIDE), self.whitened

        def row(step: Index, solution: Float[Array, " m"]) -> Float[Array, " m"]:
            i = used - 1 - step

            def column(j: Index, products: Tile) -> Tile:
                return products + _tile(self.matrix, i, j) * _part(solution, j)[None]

            products = lax.fori_loop(i + 1, used, column, jnp.zeros((SIDE, SIDE)))
            rest = _part(whitened, i) - products.sum(1)
            return tiles.put(solution, (), (i * SIDE,), (_tile(self.matrix, i, i) * rest[:, None]).sum(0))

        return lax.fori_loop(jnp.int32(0), used, row, jnp.zeros_like(whitened))


def factor(
    kernel: Kernel,
    points: Float[Array, "n d"],
    scale: Float[Array, " d"],
    count: Index,
    noise: Float[Array, ""],
    vector: Float[Array, " n"],
) -> Factor:
    """The factor of the first `count` points, whose inputs are multiplied by `scale` first, and `vector` with it.

    The vector is zero from `count` on. A matrix that is not positive definite gives NaN.
    """
    more = -points.shape[0] % SIDE
    inputs = jnp.pad((points * (scale * kernel.inverse_length)[None]).T, ((0, 0), (0, more)))
    right = jnp.pad(vector, (0, more))
    size = inputs.shape[1]
    used = tiles.whole(count, SIDE)

    def row(i: Index, upper: Room) -> Room:
        def column(j: Index, carry: tuple[Room, Tile]) -> tuple[Room, Tile]:
            upper, inverse = carry
            beside = j == used  # after the last column of U comes that of the vector
            first = jnp.where(jnp.arange(SIDE)[None] == 0, _part(right, i)[:, None], 0.0)
            tile = jnp.where(beside, first, _gram(kernel, inputs, count, noise, i, jnp.where(beside, i, j)))
            at = jnp.where(beside, jnp.int32(size // SIDE), j)
            rest = lax.fori_loop(jnp.int32(0), i, lambda k, rest: _less(upper, rest, k, i, at), tile)
            inverse = lax.cond(i == j, _inverse, lambda rest: inverse, rest)
            here = jnp.where(i == j, inverse, _product(inverse.T, rest))
            return tiles.put(upper, (), (i * SIDE, at * SIDE), here), inverse

        return lax.fori_loop(i, used + 1, column, (upper, jnp.zeros((SIDE, SIDE))))[0]

    return Factor(lax.fori_loop(jnp.int32(0), used, row, jnp.zeros((size, size + SIDE))), count)


def _tile(matrix: Room, i: Index, j: Index) -> Tile:
    return tiles.cut(matrix, (), (i * SIDE, j * SIDE), (SIDE, SIDE))


def _part(vector: Float[Array, " m"], i: Index) -> Float[Array, " side"]:
    return tiles.cut(vector, (), (i * SIDE,), (SIDE,))


def _gram(
    kernel: Kernel,
    inputs: Float[Array, "d m"],
    count: Index,
    noise: Float[Array, ""],
    i: Index,
    j: Index,
) -> Tile:
    """Tile (i, j), i <= j, of K + noise I; of the identity, where there is no point."""
    d = inputs.shape[0]
    above, beside = (tiles.cut(inputs, (), (0, tile * SIDE), (d, SIDE)) for tile in (i, j))
    covariances = kernel.of_differences(above[k][:, None] - beside[k][None] for k in range(d))
    within = jnp.arange(SIDE, dtype=jnp.int32)
    columns = within[None] + j * SIDE
    is_used, is_diagonal = columns < count, within[:, None] + i * SIDE == columns
    diagonal = jnp.where(is_used, noise, 1.0)
    return jnp.where(is_used, covariances, 0.0) + jnp.where(is_diagonal, diagonal, 0.0)


def _less(upper: Room, tile: Tile, k: Index, i: Index, j: Index) -> Tile:
    """What is left of tile (i, j) without the rows of tile k."""
    return tile - _product(_tile(upper, k, i), _tile(upper, k, j))


def _product(left: Tile, right: Tile) -> Tile:
    """A^T B, as a sum: a product of matrices this small is compiled to slower code."""
    return (left[:, :, None] * right[:, None, :]).sum(0)


def _inverse(matrix: Tile) -> Tile:
    """U^-T of a tile U^T U of which only what is not below the diagonal is looked at: rows taken out of those below."""
    within = jnp.arange(SIDE)

    def step(row: Index, both: Float[Array, "side twice"]) -> Float[Array, "side twice"]:
        mine = tiles.cut(both, (), (row, 0), (1, 2 * SIDE))[0]
        mine = mine / jnp.sqrt(tiles.cut(mine, (), (row,), (1,)))
        column = tiles.cut(mine, (), (0,), (SIDE,))
        below, here = (within > row)[:, None], (within == row)[:, None]
        return jnp.where(here, mine[None], jnp.where(below, both - column[:, None] * mine[None], both))

    both = jnp.concatenate([matrix, jnp.eye(SIDE)], axis=1)
    return lax.fori_loop(jnp.int32(0), jnp.int32(SIDE), step, both)[:, SIDE:]
