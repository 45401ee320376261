"""Which way a Gram matrix is factorised, by how many points there are: by tiles, or by LAPACK, which of how many rows.

For GPC-NS (`gpcjax.gp.renormalised`), which factorises one at each correction.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.gp import cholesky, nearby, tiled
from gpcjax.gp.batching import together
from gpcjax.gp.kernels import Kernel

_SIZES = (
    *(16, 32, 48, 64, 96, 128, 192, 256, 384),
    *(quarter << octave for octave in range(7, 20) for quarter in (4, 5, 6, 7)),
)
"""Leading rows that LAPACK factorises alone; finer from 512 on, where a factor takes longer than to compile it."""

_FEW, _TILED = 128, 1024
"""Rooms for matrices that are factorised tile by tile, as many tiles as are in use: the second one for all that are,
the first one where it saves much of what it costs to zero the room. Each takes half a second to compile. LAPACK is
faster with more points; with 640 both take as long, with all that goes into LAPACK and comes out of it.
"""


class Problem(eqx.Module):
    """K + noise I of a dictionary and a vector v; both have nothing where there is no point."""

    kernel: Kernel
    noise: Float[Array, ""]
    points: Float[Array, "n d"]
    count: Int[Array, ""]
    scale: Float[Array, " d"]
    vector: Float[Array, " n"]

    @property
    def capacity(self) -> int:
        return self.points.shape[0]

    def first(self, size: int) -> "Problem":
        """Its first rows, which hold all points in use."""
        return dataclasses.replace(self, points=self.points[:size], vector=self.vector[:size])

    def tiled(self) -> tiled.Factor:
        return tiled.factor(self.kernel, self.points, self.scale, self.count, self.noise, self.vector)

    def nearby(self) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """v^T (K + noise I)^-1 v from the points around an input whose covariances v is, and whether it is that."""
        return nearby.explained(self.kernel, self.points, self.scale, self.count, self.noise, self.vector)

    def whole(self) -> tuple[cholesky.Square, Float[Array, " n"]]:
        """L of all rows, and L^-1 v."""
        active = jnp.arange(self.capacity) < self.count
        lower = cholesky.factor(self.kernel.gram(self.points, self.scale), active, self.noise)
        return lower, cholesky.solve(lower, self.vector)


Shortcut = Callable[[Problem], tuple[PyTree, Bool[Array, ""]]]


def leading(
    function: Callable[[Problem, bool, int], PyTree], problem: Problem, shortcut: Shortcut | None = None
) -> PyTree:
    """`function(problem, by_tiles, capacity)` of the smallest of a few leading parts that hold all points.

    By tiles and with much room `shortcut(problem)` is asked first, which gives the same and whether it does. Under
    `vmap` one lane after the other, each with its own size: in one go all lanes would be factorised at all sizes (64
    lanes of capacity 64 learned 1,900 corrections a second like this and 1,000 in one go). On an accelerator all lanes
    at once, with their empty rows.
    """
    capacity = problem.capacity
    if together():
        return function(problem, False, capacity)

    def by(are_tiled: bool) -> Callable[[Problem], PyTree]:
        sizes = leading_sizes(capacity, are_tiled)

        def at(size: int) -> Callable[[Problem], PyTree]:
            by_tiles = are_tiled and size <= _TILED
            return lambda problem: function(problem.first(size), by_tiles, capacity)

        def choose(problem: Problem) -> PyTree:
            if len(sizes) == 1:
                return at(capacity)(problem)
            index = jnp.searchsorted(jnp.array(sizes), problem.count)
            return lax.switch(index, [at(size) for size in sizes], problem)

        if shortcut is None or not are_tiled or capacity <= nearby.MOST:
            return choose
        return _unless(shortcut, choose)

    return cholesky.one_at_a_time(by(tiled.is_fast(capacity)), derived=by(False))(problem)


def _unless(shortcut: Shortcut, function: Callable[[Problem], PyTree]) -> Callable[[Problem], PyTree]:
    def first(problem: Problem) -> PyTree:
        value, found = shortcut(problem)
        return lax.cond(found, lambda _: value, function, problem)

    return first


def leading_sizes(capacity: int, are_tiled: bool) -> tuple[int, ...]:
    """Sizes for dictionaries that have not filled their room: from a sixth of it on; by tiles one at most."""
    sizes = [size for size in _SIZES if capacity / 6 <= size < capacity]
    if are_tiled:
        sizes = [size for size in sizes if size >= _TILED or (size == _FEW and capacity >= 4 * _FEW)]
    return (*sizes, capacity)
