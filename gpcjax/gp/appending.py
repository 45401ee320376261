"""A Gaussian process to which points are only appended and which is only asked for its uncertainty.

That is GPC's human model. Its inverse root stays lower triangular, so half of it is kept, and a point adds one row:
what a correction writes are vectors, however large the dictionary is.
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import factor
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.posterior import Posterior, empty, with_point
from gpcjax.gp.process import Change, GaussianProcess, Reading
from gpcjax.gp.tiles import Places


class Appended(Change):
    """What one more point changes in a posterior that only appends: vectors, however large its matrix is."""

    index: Int[Array, ""]
    """Row of the point; the capacity, which is no row, if nothing is to be written."""
    before: Int[Array, ""]
    """Count of points before."""
    count: Int[Array, ""]
    point: Float[Array, " d"]
    target: Float[Array, ""]
    row: Float[Array, " n"]
    """Of `matrix`."""

    def only(self, write: Bool[Array, ""]) -> "Appended":
        """The same where `write` is true, and nothing to be written where it is not."""
        return dataclasses.replace(
            self,
            index=jnp.where(write, self.index, self.row.shape[0]),
            count=jnp.where(write, self.count, self.before),
        )

    def write(self, posteriors: Posterior, place: Places) -> Posterior:
        """The posteriors with this point appended to the one at `place`."""
        matrix = factor.append(posteriors.matrix, place, self.index, self.row)
        after = with_point(posteriors, place, self.index, self.point, self.target, self.count)
        return dataclasses.replace(after, matrix=matrix)

    def points(self) -> Float[Array, "1 d"]:
        """The point."""
        return self.point[None]

    def numbers(self) -> tuple[Float[Array, "..."], ...]:
        """Target and row."""
        return self.target, self.row

    def scale(self, before: Float[Array, " d"]) -> Float[Array, " d"]:
        """It stays."""
        return before


class Projected(Reading):
    """What such a posterior tells of an input."""

    solved: Float[Array, " n"]
    """S^T S k = (K + noise I)^-1 k, the weights with which the points explain it."""


class Appending(GaussianProcess):
    """The model; `matrix` is a `lower` inverse root S, as `gpcjax.gp.factor` keeps it, and there are no weights."""

    kernel: Kernel
    noise: Float[Array, ""]
    normalise: ClassVar[bool] = False

    def init(self, capacity: int, scale: Float[Array, " d"]) -> Posterior:
        """The empty dictionary, scaled by `scale` for good."""
        return empty(capacity, scale, factor.empty(capacity, lower=True))

    def explained(
        self, posteriors: Posterior, place: Places, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """|S k|^2."""
        return factor.explained(posteriors.matrix, place, posteriors.count[place], covariances, lower=True)

    def read(
        self,
        posteriors: Posterior,
        place: Places,
        covariances: Float[Array, " n"],
        point: Int[Array, ""] | None = None,
    ) -> Projected:
        """Deviation and weights in one pass; no `point` goes, so there is nothing to be told of one."""
        told = factor.read(posteriors.matrix, place, posteriors.count[place], covariances, lower=True)
        return Projected(self.deviation(told.explained), told.solved)

    def put(
        self,
        posteriors: Posterior,
        place: Places,
        reading: Projected,
        point: Float[Array, " d"],
        target: Float[Array, ""],
        index: Int[Array, ""],
        write: Bool[Array, ""],
    ) -> Appended:
        """What one more point changes; `index` is the count of points, wherever `write` is true."""
        before = posteriors.count[place]
        # By the deviation that was read: XLA compiles one that is computed once more to other bits.
        row = factor.row_of(reading.solved, before, reading.deviation)
        return Appended(index, before, before + 1, point, target, row).only(write)

    def renewed(self, data: Posterior) -> Posterior:
        """With the inverse of the Cholesky factor as the root: what appending one point after the other comes to."""
        root = factor.of_points(
            self.kernel.gram(data.points, data.scale), data.active, self.noise, lower=True
        )
        return dataclasses.replace(data, matrix=root, weights=jnp.zeros_like(data.weights))

    def grow_matrix(self, matrix: factor.Roots, old: int, capacity: int) -> factor.Roots:
        """The root with more tiles."""
        return factor.grow(matrix, capacity, lower=True)
