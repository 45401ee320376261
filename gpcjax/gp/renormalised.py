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

from gpcjax.gp import cholesky, tiles
from gpcjax.gp.batching import together
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.posterior import Posterior, empty, small, take
from gpcjax.gp.process import Change, GaussianProcess, Reading
from gpcjax.gp.tiles import Places

_SIZES = (
    *(16, 32, 48, 64, 96, 128, 192, 256, 384),
    *(quarter << octave for octave in range(7, 20) for quarter in (4, 5, 6, 7)),
)
"""Leading rows that are factorised alone; finer from 512 on, where a factor takes longer than to compile it."""

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
            return self._explained_anew(small(posteriors, place), covariances)
        whitened = cholesky.solve(tiles.take(posteriors.matrix, place), covariances)
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

    def grow_matrix(self, matrix: cholesky.Square, old: int, capacity: int) -> Float[Array, "m m"]:
        """The factor with a unit diagonal on the new rows, if there is one."""
        if not self.keeps_weights:
            return matrix
        unused = jnp.diag((jnp.arange(capacity) >= old).astype(matrix.dtype))
        return jnp.pad(matrix, (0, capacity - old)) + unused

    def _refactored(self, data: Posterior) -> Posterior:
        scale = self._scaled(normalising_scale(data.points, data.active))
        if not self.keeps_weights:
            return dataclasses.replace(data, scale=scale)
        lower, weights = _switch_leading(
            data.capacity, data.count, Renormalised._solve_leading, self, data, scale
        )
        return dataclasses.replace(data, matrix=lower, scale=scale, weights=weights)

    def _scaled(self, scale: Float[Array, " d"]) -> Float[Array, " d"]:
        return scale if self.scaling is None else scale * self.scaling

    def _factor_leading(self, size: int, data: Posterior, scale: Float[Array, " d"]) -> Float[Array, "m m"]:
        """From the first `size` rows, which hold all points in use."""
        return cholesky.factor(self.kernel.gram(data.points[:size], scale), data.active[:size], self.noise)

    def _solve_leading(
        self, size: int, data: Posterior, scale: Float[Array, " d"]
    ) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Factor and weights."""
        lower = self._factor_leading(size, data, scale)
        solved = cholesky.solve(lower, data.targets[:size])
        weights = data.weights.at[:size].set(cholesky.solve(lower, solved, transpose=True))
        return jnp.eye(data.capacity).at[:size, :size].set(lower), weights

    def _explained_anew(self, data: Posterior, covariances: Float[Array, " n"]) -> Float[Array, ""]:
        """|L^-1 k|^2, from a factor that is used once."""
        return _switch_leading(
            data.capacity, data.count, Renormalised._explain_leading, self, data, covariances
        )

    def _explain_leading(
        self, size: int, data: Posterior, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """|L^-1 k|^2 of the first `size` rows."""
        whitened = cholesky.solve(self._factor_leading(size, data, data.scale), covariances[:size])
        return (whitened * whitened).sum()


def _switch_leading(
    capacity: int,
    count: Int[Array, ""],
    function: Callable[..., PyTree],
    process: Renormalised,
    *operands: PyTree,
) -> PyTree:
    """`function(process, size, *operands)` with the smallest of a few sizes that holds all points.

    Under `vmap` one lane after the other, each with its own size: in one go all lanes would be factorised at all
    sizes. 64 lanes of capacity 64 learned 1,900 corrections a second like this and 1,000 in one go (there on one
    thread, where that does not hang; 16 lanes: 1,200 and 860; a busy machine of two cores). On an accelerator all lanes
    at once, with their empty rows.
    """
    if together():
        return function(process, capacity, *operands)
    sizes = _leading_sizes(capacity)

    @cholesky.one_at_a_time
    def choose(count: Int[Array, ""], process: Renormalised, operands: tuple[PyTree, ...]) -> PyTree:
        def at(size: int) -> Callable[..., PyTree]:
            return lambda process, operands: function(process, size, *operands)

        index = jnp.searchsorted(jnp.array(sizes), count)
        return lax.switch(index, [at(size) for size in sizes], process, operands)

    return choose(count, process, operands)


def _leading_sizes(capacity: int) -> tuple[int, ...]:
    """Sizes for dictionaries that have not filled their room: from a sixth of it on."""
    return (*[size for size in _SIZES if capacity / 6 <= size < capacity], capacity)


def normalising_scale(points: Float[Array, "n d"], active: Bool[Array, " n"]) -> Float[Array, " d"]:
    """1 / sigma_m: inverse standard deviation (ddof 0) of each dimension over the dictionary, 1 if it is constant."""
    count = jnp.maximum(active.sum(), 1)
    mask = active[:, None]
    mean = jnp.where(mask, points, 0.0).sum(0) / count
    centred = jnp.where(mask, points - mean[None], 0.0)
    deviation = jnp.sqrt((centred * centred).sum(0) / count)
    return jnp.where(deviation < SMALLEST_DEVIATION, 1.0, 1.0 / jnp.where(deviation > 0, deviation, 1.0))
