"""A Gaussian process that scales its inputs by the inverse standard deviations of its dictionary (GPC-NS).

A point moves the scale, and with it every entry of the Gram matrix: all is computed anew, O(n^3).
"""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.gp import cholesky, tiled, tiles
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.leading import Problem, leading
from gpcjax.gp.posterior import Posterior, empty, small
from gpcjax.gp.process import Change, GaussianProcess, Reading
from gpcjax.gp.tiles import Places

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

    def covariances(
        self, posteriors: Posterior, place: Places, point: Float[Array, " d"]
    ) -> Float[Array, " n"]:
        """k(x_i, x), of all rows at once: little beside a factorisation, and it has derivatives of either mode."""
        data = small(posteriors, place)
        return jnp.where(data.active, self.kernel.covariances(data.points, point, data.scale), 0.0)

    def explained(
        self, posteriors: Posterior, place: Places, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """|L^-1 k|^2."""
        if not self.keeps_weights:
            data = small(posteriors, place)
            return leading(_explained, self._problem(data, data.scale, covariances), Problem.nearby)
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
        upper, weights = leading(_factorised, self._problem(data, scale, data.targets))
        return dataclasses.replace(data, scale=scale, weights=weights), upper

    def _problem(self, data: Posterior, scale: Float[Array, " d"], vector: Float[Array, " n"]) -> Problem:
        return Problem(self.kernel, self.noise, data.points, data.count, scale, vector)

    def _scaled(self, scale: Float[Array, " d"]) -> Float[Array, " d"]:
        return scale if self.scaling is None else scale * self.scaling


def _explained(problem: Problem, by_tiles: bool, capacity: int) -> Float[Array, ""]:
    """v^T (K + noise I)^-1 v."""
    whitened = problem.tiled().whitened if by_tiles else problem.whole()[1]
    return (whitened * whitened).sum()


def _factorised(problem: Problem, by_tiles: bool, capacity: int) -> tuple[tiled.Room, Float[Array, " n"]]:
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
