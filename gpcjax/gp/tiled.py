"""Gram matrices that are factorised while they are made, tile by tile, for GPC-NS: K + noise I = U^T U.

Loops go over the tiles of the points in use, however much room there is, and over half of the matrix. Where XLA
compiles all of them to one function, that takes four fifths to nine tenths of LAPACK's time for a matrix that is made
before, with up to some hundred points, and no more with up to a thousand (`benchmarks/README.md`).
"""

import os

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import tiles
from gpcjax.gp.batching import together
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.tiles import ROWS as SIDE
from gpcjax.gp.tiles import Places, Vector

Tile = Float[Array, "side side"]
Side = Float[Array, " side"]
Index = Int[Array, ""]
Room = Float[Array, "m more"]
Inverses = Float[Array, "m side"]


def is_fast(capacity: int) -> bool:
    """Whether this is the faster way here, for so much room; asked when a program is traced.

    This process has to compile loops within loops to one function, as workers do, by an option of XLA's that has no
    other place than the environment (`gpcjax.sweep.environment`). Otherwise each of their operations is dispatched
    alone, which takes longer than LAPACK. An accelerator has ways of its own.
    """
    compiled = "xla_cpu_small_while_loop_byte_threshold" in os.environ.get("XLA_FLAGS", "")
    return compiled and capacity % SIDE == 0 and not together()


class Factor(eqx.Module):
    """U of the points in use, and one vector v.

    `matrix` has U, of which what is below the diagonal means nothing, and beside it in a column of tiles U^-T v.
    `inverse` has U^-1 of the tiles on the diagonal.
    """

    matrix: Room
    inverse: Inverses
    count: Index

    @property
    def whitened(self) -> Vector:
        """U^-T v: its squares add up to v^T (K + noise I)^-1 v. Zero where no point is in use."""
        return self.matrix[:, self.matrix.shape[0]]

    def solved(self) -> Vector:
        """(K + noise I)^-1 v, zero where no point is in use."""
        used, whitened = tiles.whole(self.count, SIDE), self.whitened

        def row(step: Index, solution: Vector) -> Vector:
            i = used - 1 - step

            def column(j: Index, products: Tile) -> Tile:
                return products + _tile(self.matrix, i, j) * _part(solution, j)[None]

            products = lax.fori_loop(i + 1, used, column, jnp.zeros((SIDE, SIDE)))
            rest = _part(whitened, i) - products.sum(1)
            corner, inverse = _tile(self.matrix, i, i), _tile(self.inverse, i, jnp.int32(0))
            first = (inverse * rest[None]).sum(1)
            left = rest - (corner * first[None]).sum(1)
            return tiles.put(solution, (), (i * SIDE,), first + (inverse * left[None]).sum(1))

        return lax.fori_loop(jnp.int32(0), used, row, jnp.zeros_like(whitened))


def factor(
    kernel: Kernel,
    points: Float[Array, "n d"],
    scale: Float[Array, " d"],
    count: Index,
    noise: Float[Array, ""],
    vector: Vector,
) -> Factor:
    """The factor of the first `count` points, whose inputs are multiplied by `scale` first, and `vector` with it.

    There is room for whole tiles. The vector is zero from `count` on. A matrix that is not positive definite gives NaN.
    """
    inputs, size = (points * (scale * kernel.inverse_length)[None]).T, points.shape[0]
    used = tiles.whole(count, SIDE)

    def row(i: Index, carry: tuple[Room, Inverses]) -> tuple[Room, Inverses]:
        upper, inverses = carry

        def column(j: Index, carry: tuple[Room, Tile, Tile]) -> tuple[Room, Tile, Tile]:
            upper, corner, inverse = carry
            beside = j == used  # after the last column of U comes that of the vector
            first = jnp.where(jnp.arange(SIDE)[None] == 0, _part(vector, i)[:, None], 0.0)
            tile = jnp.where(beside, first, _gram(kernel, inputs, count, noise, i, jnp.where(beside, i, j)))
            at = jnp.where(beside, jnp.int32(size // SIDE), j)
            rest = lax.fori_loop(jnp.int32(0), i, lambda k, rest: _less(upper, rest, k, i, at), tile)
            corner, inverse = lax.cond(i == j, _cholesky, lambda rest: (corner, inverse), rest)
            here = jnp.where(i == j, corner, _solved(corner, inverse, rest))
            return tiles.put(upper, (), (i * SIDE, at * SIDE), here), corner, inverse

        none = jnp.zeros((SIDE, SIDE))
        upper, _, inverse = lax.fori_loop(i, used + 1, column, (upper, none, none))
        return upper, tiles.put(inverses, (), (i * SIDE, 0), inverse)

    room = jnp.zeros((size, size + SIDE)), jnp.zeros((size, SIDE))
    upper, inverses = lax.fori_loop(jnp.int32(0), used, row, room)
    return Factor(upper, inverses, count)


def lower(upper: Room, count: Index) -> Float[Array, "m m"]:
    """L = U^T of so many points, from U; the identity where there is none."""
    n = upper.shape[0]
    rows = jnp.arange(n)
    factor = jnp.where(rows[:, None] < rows[None], 0.0, upper[:, :n].T)
    return jnp.where((rows < count)[:, None], factor, jnp.eye(n))


def write(
    lowers: Float[Array, "..."], place: Places, count: Index, upper: Room, given: Bool[Array, ""]
) -> Float[Array, "..."]:
    """The factors L with that of so many points at `place`, from U, if it is `given`; tile by tile, where they are.

    What is there has to be zero above the diagonal, and the identity from `count` on.
    """

    def row(i: Index, lowers: Float[Array, "..."]) -> Float[Array, "..."]:
        def column(j: Index, lowers: Float[Array, "..."]) -> Float[Array, "..."]:
            tile = _tile(upper, j, i)
            tile = jnp.where(i == j, jnp.triu(tile), tile)
            return tiles.put(lowers, place, (i * SIDE, j * SIDE), tile.T)

        return lax.fori_loop(jnp.int32(0), i + 1, column, lowers)

    used = jnp.where(given, tiles.whole(count, SIDE), 0)
    return lax.fori_loop(jnp.int32(0), used, row, lowers)


def whiten(lower: Float[Array, "..."], place: Places, count: Index, vector: Vector) -> Vector:
    """L^-1 v, of the factor at `place`, for a vector that is zero from `count` on, as is then the result."""

    def tile(i: Index, j: Index) -> Tile:
        return tiles.cut(lower, place, (i * SIDE, j * SIDE), (SIDE, SIDE))

    def row(i: Index, solution: Vector) -> Vector:
        def column(j: Index, products: Tile) -> Tile:
            return products + tile(i, j) * _part(solution, j)[None]

        products = lax.fori_loop(jnp.int32(0), i, column, jnp.zeros((SIDE, SIDE)))
        rest = _part(solution, i) - products.sum(1)
        return tiles.put(solution, (), (i * SIDE,), _forward(tile(i, i), rest))

    return lax.fori_loop(jnp.int32(0), tiles.whole(count, SIDE), row, vector)


def _tile(matrix: Room, i: Index, j: Index) -> Tile:
    return tiles.cut(matrix, (), (i * SIDE, j * SIDE), (SIDE, SIDE))


def _part(vector: Vector, i: Index) -> Side:
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


def _cholesky(matrix: Tile) -> tuple[Tile, Tile]:
    """U and U^-1 of a tile U^T U, of which what is below the diagonal is not looked at, and nothing is there in U."""
    within = jnp.arange(SIDE)

    def step(row: Index, both: Float[Array, "side twice"]) -> Float[Array, "side twice"]:
        mine = tiles.cut(both, (), (row, 0), (1, 2 * SIDE))[0]
        mine = mine / jnp.sqrt(tiles.cut(mine, (), (row,), (1,)))
        column = tiles.cut(mine, (), (0,), (SIDE,))
        below, here = (within > row)[:, None], (within == row)[:, None]
        return jnp.where(here, mine[None], jnp.where(below, both - column[:, None] * mine[None], both))

    both = jnp.concatenate([matrix, jnp.eye(SIDE)], axis=1)
    both = lax.fori_loop(jnp.int32(0), jnp.int32(SIDE), step, both)
    return jnp.triu(both[:, :SIDE]), both[:, SIDE:].T


def _solved(corner: Tile, inverse: Tile, right: Tile) -> Tile:
    """U^-T B, of a tile U: by its inverse, and once more for what that leaves, which is as exact as a substitution."""
    first = _product(inverse, right)
    return first + _product(inverse, right - _product(corner, first))


def _forward(corner: Tile, right: Side) -> Side:
    """L^-1 b, of a tile L."""
    within = jnp.arange(SIDE)

    def step(row: Index, rest: Side) -> Side:
        column = tiles.cut(corner, (), (0, row), (SIDE, 1))[:, 0]
        value = tiles.cut(rest, (), (row,), (1,)) / tiles.cut(column, (), (row,), (1,))
        return jnp.where(within == row, value, jnp.where(within > row, rest - column * value, rest))

    return lax.fori_loop(jnp.int32(0), jnp.int32(SIDE), step, right)
