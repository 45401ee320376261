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
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import cholesky, tiled
from gpcjax.gp.batching import together
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.posterior import Posterior, empty, small, take
from gpcjax.gp.process import Change, GaussianProcess, Reading
from gpcjax.gp.tiles import Places

_TILED = (128, 512)
"""Rooms of matrices that are factorised tile by tile, as many as are in use: what they cost beside is to be zeroed."""

_WHOLE = tuple(quarter << octave for octave in range(7, 20) for quarter in (5, 6, 7, 8))
"""Leading rows that LAPACK factorises, where it is faster; finer than doubling, as that takes longer than compiling."""

SMALLEST_DEVIATION = 1e-6
"""A dimension that varies less than this over the dictionary is not normalised (DESIGN section 2, sigma_m)."""


class Renewed(Change):
    """A posterior with normalisation after a point: all of it is new."""

    posterior: Posterior
    given: Bool[Array, ""]
    """Whether there is anything to be written."""

    def only(self, write: Bool[Array, ""]) -> "Renewed":
        """The same where `write` is true, and nothing to be written where it is not."""
        return dataclasses.replace(self, given=self.given & write)

    def write(self, posteriors: Posterior, place: Places) -> Posterior:
        """The posteriors with this one at `place`."""
        before = take(posteriors, place)
        after = jax.tree.map(lambda new, old: jnp.where(self.given, new, old), self.posterior, before)
        return jax.tree.map(lambda leaf, value: leaf.at[place].set(value), posteriors, after)

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
    """The model. It keeps no `matrix` (0 times 0): a factor is made where it is asked for, as each point changes it.

    `keeps_weights` says whether the mean is wanted. Static. `scaling` is what normalised inputs are multiplied by, one
    factor for each dimension, or None: then a program compiles to what it is without.
    """

    kernel: Kernel
    noise: Float[Array, ""]
    keeps_weights: bool = eqx.field(static=True, default=True)
    scaling: Float[Array, " d"] | None = None
    normalise: ClassVar[bool] = True

    def init(self, capacity: int, scale: Float[Array, " d"]) -> Posterior:
        """The empty dictionary; its scale is `scaling`, or 1, until points vary."""
        return empty(capacity, self._scaled(jnp.ones_like(scale)), jnp.zeros((0, 0)))

    def explained(
        self, posteriors: Posterior, place: Places, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """k^T (K + noise I)^-1 k."""
        data = small(posteriors, place)
        return _leading(self, _explained, data, data.scale, covariances)

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
        before = take(posteriors, place)
        here = (jnp.arange(before.capacity) == index) & write
        count = before.count + (write & (index >= before.count)).astype(before.count.dtype)
        targets = jnp.where(here, target, before.targets)
        points = jnp.where(here[:, None], point[None], before.points)
        data = dataclasses.replace(before, points=points, targets=targets, count=count)
        return Renewed(self._refactored(data), write)

    def renewed(self, data: Posterior) -> Posterior:
        """As after every point."""
        return self._refactored(data)

    def grow_matrix(self, matrix: Float[Array, "0 0"], old: int, capacity: int) -> Float[Array, "0 0"]:
        """There is none."""
        return matrix

    def _refactored(self, data: Posterior) -> Posterior:
        scale = self._scaled(normalising_scale(data.points, data.active))
        if not self.keeps_weights:
            return dataclasses.replace(data, scale=scale)
        weights = _leading(self, _weights, data, scale, data.targets)
        return dataclasses.replace(data, scale=scale, weights=weights)

    def _scaled(self, scale: Float[Array, " d"]) -> Float[Array, " d"]:
        return scale if self.scaling is None else scale * self.scaling


class _Problem(eqx.Module):
    """The Gram matrix of a dictionary and a vector v; both have zeros where there is no point."""

    kernel: Kernel
    noise: Float[Array, ""]
    points: Float[Array, "n d"]
    count: Int[Array, ""]
    scale: Float[Array, " d"]
    vector: Float[Array, " n"]

    def leading(self, size: int) -> "_Problem":
        """Its first rows, which hold all points in use."""
        return dataclasses.replace(self, points=self.points[:size], vector=self.vector[:size])

    def tiled(self) -> tiled.Factor:
        return tiled.factor(self.kernel, self.points, self.scale, self.count, self.noise, self.vector)

    def whole(self) -> tuple[cholesky.Square, Float[Array, " n"]]:
        """L of all rows, and L^-1 v."""
        active = jnp.arange(len(self.points)) < self.count
        lower = cholesky.factor(self.kernel.gram(self.points, self.scale), active, self.noise)
        return lower, cholesky.solve(lower, self.vector)


def _explained(problem: _Problem, by_tiles: bool) -> Float[Array, ""]:
    """v^T (K + noise I)^-1 v."""
    whitened = problem.tiled().whitened if by_tiles else problem.whole()[1]
    return (whitened * whitened).sum()


def _weights(problem: _Problem, by_tiles: bool) -> Float[Array, " n"]:
    """(K + noise I)^-1 v."""
    if by_tiles:
        return problem.tiled().solved()[: len(problem.points)]
    lower, whitened = problem.whole()
    return cholesky.solve(lower, whitened, transpose=True)


def _leading(
    process: Renormalised,
    function: Callable[[_Problem, bool], Float[Array, "..."]],
    data: Posterior,
    scale: Float[Array, " d"],
    vector: Float[Array, " n"],
) -> Float[Array, "..."]:
    """`function` of the smallest of a few leading parts of a dictionary that holds all points.

    Under `vmap` one lane after the other, each with its own size: in one go all lanes would be factorised at all
    sizes. On an accelerator all lanes at once, with their empty rows.
    """
    capacity = data.capacity
    problem = _Problem(process.kernel, process.noise, data.points, data.count, scale, vector)
    if together():
        return function(problem, False)
    sizes = _leading_sizes(capacity)

    @cholesky.one_at_a_time
    def choose(problem: _Problem) -> Float[Array, "..."]:
        def at(size: int) -> Callable[[_Problem], Float[Array, "..."]]:
            def leading(problem: _Problem) -> Float[Array, "..."]:
                result = function(problem.leading(size), size <= _TILED[-1])
                return jnp.pad(result, (0, capacity - size)) if result.ndim else result

            return leading

        index = jnp.searchsorted(jnp.array(sizes), problem.count)
        return lax.switch(index, [at(size) for size in sizes], problem)

    return choose(problem)


def _leading_sizes(capacity: int) -> tuple[int, ...]:
    """Sizes for dictionaries that have not filled their room: from a quarter of it on."""
    return (*[size for size in (*_TILED, *_WHOLE) if capacity / 4 <= size < capacity], capacity)


def normalising_scale(points: Float[Array, "n d"], active: Bool[Array, " n"]) -> Float[Array, " d"]:
    """1 / sigma_m: inverse standard deviation (ddof 0) of each dimension over the dictionary, 1 if it is constant."""
    count = jnp.maximum(active.sum(), 1)
    mask = active[:, None]
    mean = jnp.where(mask, points, 0.0).sum(0) / count
    centred = jnp.where(mask, points - mean[None], 0.0)
    deviation = jnp.sqrt((centred * centred).sum(0) / count)
    return jnp.where(deviation < SMALLEST_DEVIATION, 1.0, 1.0 / jnp.where(deviation > 0, deviation, 1.0))
