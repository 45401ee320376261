"""A Gaussian process that scales its inputs by the inverse standard deviations of its dictionary (GPC-NS).

A point moves the scale, and with it every entry of the Gram matrix: all is computed anew, O(n^3).
"""

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.gp import cholesky, nearby, tiled, tiles
from gpcjax.gp.batching import together
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.posterior import Posterior, empty, small
from gpcjax.gp.process import Change, GaussianProcess, Reading
from gpcjax.gp.tiles import Places

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

SMALLEST_DEVIATION = 1e-6
"""A dimension that varies less than this over the dictionary is not normalised (DESIGN section 2, sigma_m)."""


class Renewed(Change):
    """A posterior with normalisation after a point: all of it is new."""

    posterior: Posterior
    """Without its matrix."""
    upper: tiled.Room
    """U = L^T in its first n columns, as `tiled.Factor` has it; 0 times 0 in a model that keeps none."""
    given: Bool[Array, ""]
    """Whether there is anything to be written."""

    def only(self, write: Bool[Array, ""]) -> "Renewed":
        """The same where `write` is true, and nothing to be written where it is not."""
        return dataclasses.replace(self, given=self.given & write)

    def write(self, posteriors: Posterior, place: Places) -> Posterior:
        """The posteriors with this one at `place`."""
        written = {"matrix": posteriors.matrix}
        for name in ("points", "targets", "count", "scale", "weights"):
            new, leaf = getattr(self.posterior, name), getattr(posteriors, name)
            written[name] = leaf.at[place].set(jnp.where(self.given, new, tiles.take(leaf, place)))
        if self.upper.size:
            write = _write_by_tiles if tiled.is_fast(self.upper.shape[0]) else _write
            count = self.posterior.count
            written["matrix"] = write(posteriors.matrix, place, count, self.upper, self.given)
        return Posterior(**written)

    def points(self) -> Float[Array, "n d"]:
        """All of the dictionary."""
        return self.posterior.points

    def numbers(self) -> tuple[Float[Array, "..."], ...]:
        """Targets and weights; a factor that is no number makes weights that are none."""
        return self.posterior.targets, self.posterior.weights

    def scale(self, before: Float[Array, " d"]) -> Float[Array, " d"]:
        """Its own."""
        return self.posterior.scale


class Renormalised(GaussianProcess):
    """The model; `matrix` is the Cholesky factor L, n times n.

    `keeps_weights` says whether the mean is wanted. Static. Without, there is no factor either (0 times 0): such a
    model, of the human, is only asked before a correction, which changes all of its factor, and makes it then.
    `scaling` is what normalised inputs are multiplied by, one factor for each dimension, or None: then a program
    compiles to what it is without.
    """

    kernel: Kernel
    noise: Float[Array, ""]
    keeps_weights: bool = eqx.field(static=True, default=True)
    scaling: Float[Array, " d"] | None = None
    normalise: ClassVar[bool] = True

    def init(self, capacity: int, scale: Float[Array, " d"]) -> Posterior:
        """The empty dictionary; its scale is `scaling`, or 1, until points vary."""
        return empty(
            capacity, self._scaled(jnp.ones_like(scale)), jnp.eye(capacity if self.keeps_weights else 0)
        )

    def explained(
        self, posteriors: Posterior, place: Places, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """|L^-1 k|^2."""
        if not self.keeps_weights:
            data = small(posteriors, place)
            return _leading(_explained, self._problem(data, data.scale, covariances), _Problem.nearby)
        count = tiles.take(posteriors.count, place)
        whiten = _whiten_by_tiles if tiled.is_fast(covariances.shape[0]) else _whiten
        whitened = whiten(posteriors.matrix, place, count, covariances)
        return (whitened * whitened).sum()

    def read(
        self,
        posteriors: Posterior,
        place: Places,
        covariances: Float[Array, " n"],
        point: Int[Array, ""] | None = None,
    ) -> Reading:
        """Only the deviation: all else is made anew by `put`."""
        return Reading(self.deviation(self.explained(posteriors, place, covariances)))

    def put(
        self,
        posteriors: Posterior,
        place: Places,
        reading: Reading,
        point: Float[Array, " d"],
        target: Float[Array, ""],
        index: Int[Array, ""],
        write: Bool[Array, ""],
    ) -> Renewed:
        """The posterior with a point in row `index`, in use or the first that is free."""
        before = small(posteriors, place)
        here = (jnp.arange(before.capacity) == index) & write
        count = before.count + (write & (index >= before.count)).astype(before.count.dtype)
        targets = jnp.where(here, target, before.targets)
        points = jnp.where(here[:, None], point[None], before.points)
        data = dataclasses.replace(before, points=points, targets=targets, count=count)
        return Renewed(*self._refactored(data), write)

    def renewed(self, data: Posterior) -> Posterior:
        """As after every point."""
        after, upper = self._refactored(data)
        return (
            dataclasses.replace(after, matrix=tiled.lower(upper, data.count)) if self.keeps_weights else after
        )

    def grow_matrix(self, matrix: cholesky.Square, old: int, capacity: int) -> Float[Array, "m m"]:
        """The factor with a unit diagonal on the new rows, if there is one."""
        if not self.keeps_weights:
            return matrix
        unused = jnp.diag((jnp.arange(capacity) >= old).astype(matrix.dtype))
        return jnp.pad(matrix, (0, capacity - old)) + unused

    def _refactored(self, data: Posterior) -> tuple[Posterior, tiled.Room]:
        """With scale and weights made anew, and U."""
        scale = self._scaled(normalising_scale(data.points, data.active))
        if not self.keeps_weights:
            return dataclasses.replace(data, scale=scale), jnp.zeros((0, 0))
        upper, weights = _leading(_factorised, self._problem(data, scale, data.targets))
        return dataclasses.replace(data, scale=scale, weights=weights), upper

    def _problem(self, data: Posterior, scale: Float[Array, " d"], vector: Float[Array, " n"]) -> "_Problem":
        return _Problem(self.kernel, self.noise, data.points, data.count, scale, vector)

    def _scaled(self, scale: Float[Array, " d"]) -> Float[Array, " d"]:
        return scale if self.scaling is None else scale * self.scaling


class _Problem(eqx.Module):
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

    def leading(self, size: int) -> "_Problem":
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


_Shortcut = Callable[[_Problem], tuple[PyTree, Bool[Array, ""]]]


def _explained(problem: _Problem, by_tiles: bool, capacity: int) -> Float[Array, ""]:
    """v^T (K + noise I)^-1 v."""
    whitened = problem.tiled().whitened if by_tiles else problem.whole()[1]
    return (whitened * whitened).sum()


def _factorised(problem: _Problem, by_tiles: bool, capacity: int) -> tuple[tiled.Room, Float[Array, " n"]]:
    """U, of which what is below the diagonal means nothing, and (K + noise I)^-1 v, of so many rows."""
    if by_tiles:
        factor = problem.tiled()
        upper, solved = factor.matrix, factor.solved()
    else:
        lower, whitened = problem.whole()
        upper, solved = lower.T, cholesky.solve(lower, whitened, transpose=True)
    more = capacity - problem.capacity
    upper = jnp.pad(upper, ((0, more), (0, capacity + tiled.SIDE - upper.shape[1])))
    return upper, jnp.pad(solved, (0, more))


def _write(
    matrices: PyTree, place: Places, count: Int[Array, ""], upper: tiled.Room, given: Bool[Array, ""]
) -> PyTree:
    """The factors with that of so many points at `place`, if it is `given`."""
    return matrices.at[place].set(jnp.where(given, tiled.lower(upper, count), tiles.take(matrices, place)))


_write_by_tiles = jax.custom_jvp(tiled.write)
_write_by_tiles.defjvp(lambda primals, tangents: jax.jvp(_write, primals, tangents))


def _leading(
    function: Callable[[_Problem, bool, int], PyTree], problem: _Problem, shortcut: _Shortcut | None = None
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

    def by(are_tiled: bool) -> Callable[[_Problem], PyTree]:
        sizes = _leading_sizes(capacity, are_tiled)

        def at(size: int) -> Callable[[_Problem], PyTree]:
            by_tiles = are_tiled and size <= _TILED
            return lambda problem: function(problem.leading(size), by_tiles, capacity)

        def choose(problem: _Problem) -> PyTree:
            if len(sizes) == 1:
                return at(capacity)(problem)
            index = jnp.searchsorted(jnp.array(sizes), problem.count)
            return lax.switch(index, [at(size) for size in sizes], problem)

        first = shortcut if are_tiled and capacity > nearby.MOST else None
        return choose if first is None else _unless(first, choose)

    return cholesky.one_at_a_time(by(tiled.is_fast(capacity)), derived=by(False))(problem)


def _unless(shortcut: _Shortcut, function: Callable[[_Problem], PyTree]) -> Callable[[_Problem], PyTree]:
    def first(problem: _Problem) -> PyTree:
        value, found = shortcut(problem)
        return lax.cond(found, lambda _: value, function, problem)

    return first


def _leading_sizes(capacity: int, are_tiled: bool) -> tuple[int, ...]:
    """Sizes for dictionaries that have not filled their room: from a sixth of it on; by tiles one at most."""
    sizes = [size for size in _SIZES if capacity / 6 <= size < capacity]
    if are_tiled:
        sizes = [size for size in sizes if size >= _TILED or (size == _FEW and capacity >= 4 * _FEW)]
    return (*sizes, capacity)


def _whiten(matrix: PyTree, place: Places, count: Int[Array, ""], vector: Float[Array, " n"]) -> PyTree:
    """L^-1 v, of the factor at `place`."""
    return cholesky.solve(tiles.take(matrix, place), vector)


_whiten_by_tiles = jax.custom_jvp(tiled.whiten)
_whiten_by_tiles.defjvp(lambda primals, tangents: jax.jvp(_whiten, primals, tangents))
"""With a rule for `vmap` it would be given a copy of the block of factors: half a correction's time."""


def normalising_scale(points: Float[Array, "n d"], active: Bool[Array, " n"]) -> Float[Array, " d"]:
    """1 / sigma_m: inverse standard deviation (ddof 0) of each dimension over the dictionary, 1 if it is constant."""
    count = jnp.maximum(active.sum(), 1)
    mask = active[:, None]
    mean = jnp.where(mask, points, 0.0).sum(0) / count
    centred = jnp.where(mask, points - mean[None], 0.0)
    deviation = jnp.sqrt((centred * centred).sum(0) / count)
    return jnp.where(deviation < SMALLEST_DEVIATION, 1.0, 1.0 / jnp.where(deviation > 0, deviation, 1.0))
