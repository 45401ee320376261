"""A Gaussian process of fixed scale whose points are appended, or put in another one's place: O(n^2) each.

That is GPC's policy, and its human model where a full one replaces its nearest point.
"""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import factor, tiles
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.posterior import Posterior, empty, small, with_point
from gpcjax.gp.process import Change, GaussianProcess, Reading
from gpcjax.gp.tiles import Places


class Placed(Change):
    """What a point changes in a posterior of fixed scale, appended or in another one's place: vectors too."""

    edit: factor.Edit
    before: Int[Array, ""]
    """Count of points before."""
    count: Int[Array, ""]
    point: Float[Array, " d"]
    target: Float[Array, ""]
    weights: Float[Array, " n"]
    given: Bool[Array, ""]
    """Whether there is anything to be written."""

    def only(self, write: Bool[Array, ""]) -> "Placed":
        """The same where `write` is true, and nothing to be written where it is not."""
        return dataclasses.replace(self, given=self.given & write)

    def write(self, posteriors: Posterior, place: Places) -> Posterior:
        """The posteriors with this point in the one at `place`."""
        index = jnp.where(self.given, self.edit.index, self.edit.row.shape[0])
        count = jnp.where(self.given, self.count, self.before)
        matrix = factor.write(posteriors.matrix, place, self.before, self.edit, self.given)
        before = tiles.take(posteriors.weights, place)
        weights = posteriors.weights.at[place].set(jnp.where(self.given, self.weights, before))
        after = with_point(posteriors, place, index, self.point, self.target, count)
        return dataclasses.replace(after, matrix=matrix, weights=weights)

    def points(self) -> Float[Array, "1 d"]:
        """The point."""
        return self.point[None]

    def numbers(self) -> tuple[Float[Array, "..."], ...]:
        """Target, weights, and what goes into the root."""
        return self.target, self.edit.row, self.weights, self.edit.scaled, self.edit.image

    def scale(self, before: Float[Array, " d"]) -> Float[Array, " d"]:
        """It stays."""
        return before


class Weighed(Reading):
    """What such a posterior tells of an input."""

    root: factor.Reading
    """With the column of a point that may go."""


class Replacing(GaussianProcess):
    """The model; `matrix` is the inverse root S, a square as `gpcjax.gp.factor` keeps it.

    `keeps_weights` says whether the mean is wanted; a human model is only asked for its uncertainty. Static.
    """

    kernel: Kernel
    noise: Float[Array, ""]
    keeps_weights: bool = eqx.field(static=True, default=True)
    normalise: ClassVar[bool] = False

    def init(self, capacity: int, scale: Float[Array, " d"]) -> Posterior:
        """The empty dictionary, scaled by `scale` for good."""
        return empty(capacity, scale, factor.empty(capacity))

    def explained(
        self, posteriors: Posterior, place: Places, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """|S k|^2."""
        return factor.explained(posteriors.matrix, place, posteriors.count[place], covariances)

    def read(
        self,
        posteriors: Posterior,
        place: Places,
        covariances: Float[Array, " n"],
        point: Int[Array, ""] | None = None,
    ) -> Weighed:
        """|S k|^2, S^T S k and the column of S^T S that belongs to a `point` which may go, in one pass."""
        root = factor.read(posteriors.matrix, place, posteriors.count[place], covariances, point)
        return Weighed(self.deviation(root.explained), root)

    def put(
        self,
        posteriors: Posterior,
        place: Places,
        reading: Weighed,
        point: Float[Array, " d"],
        target: Float[Array, ""],
        index: Int[Array, ""],
        write: Bool[Array, ""],
    ) -> Placed:
        """What a point changes in row `index`: the first that is free, or that of a point which `read` was told of."""
        before, root = small(posteriors, place), reading.root
        here = jnp.arange(before.capacity) == index
        count = before.count + (write & (index >= before.count)).astype(before.count.dtype)
        edit = factor.edit(posteriors.matrix, place, before.count, index, root, self.prior, self.noise)
        weights = before.weights
        if self.keeps_weights:
            targets = jnp.where(here & write, target, before.targets)
            share = jnp.take(weights, index) / jnp.where(edit.replaces, jnp.take(root.column, index), 1.0)
            others = jnp.where(edit.replaces, jnp.where(here, 0.0, weights - root.column * share), weights)
            weights = others + edit.row * (edit.row * targets).sum()
        return Placed(edit, before.count, count, point, target, weights, write)

    def renewed(self, data: Posterior) -> Posterior:
        """With the inverse of the Cholesky factor as the root."""
        root = factor.of_points(self.kernel.gram(data.points, data.scale), data.active, self.noise)
        inner = factor.dense(root, data.capacity)
        weights = inner.T @ (inner @ data.targets) if self.keeps_weights else jnp.zeros_like(data.weights)
        return dataclasses.replace(data, matrix=root, weights=weights)

    def grow_matrix(self, matrix: factor.Roots, old: int, capacity: int) -> factor.Roots:
        """The root with more tiles."""
        return factor.grow(matrix, capacity)
