"""Gaussian process regression on a dictionary of fixed capacity, one point at a time.

`GaussianProcess` holds the hyperparameters, `Posterior` the data and what is derived from them. The inputs are scaled
per dimension: by fixed weights (GPC), or by the inverse standard deviation of each dimension over the dictionary
(GPC-NS). With fixed weights a new point is an O(n^2) update of the inverse factor; with normalisation it moves every
entry of the Gram matrix, and the factor is computed anew, O(n^3).
"""

import dataclasses
import functools
import math

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import factor
from gpcjax.gp.kernels import Kernel

SMALLEST_DEVIATION = 1e-6
"""A dimension that varies less than this over the dictionary is not normalised (DESIGN section 2, sigma_m)."""


class Posterior(eqx.Module):
    """A dictionary of up to n points of d dimensions and its factor.

    Rows from `count` on are unused: their points and targets are zero, and so are their rows and columns of `matrix`
    (but for the unit diagonal of a Cholesky factor).
    """

    points: Float[Array, "n d"]
    """Inputs as given, before scaling."""
    targets: Float[Array, " n"]
    """Outputs: actions for a policy, advice for a human model."""
    count: Int[Array, ""]
    """Number of points in use, int32."""
    scale: Float[Array, " d"]
    """What each input dimension is multiplied by before the kernel."""
    matrix: Float[Array, "n n"]
    """Inverse root S (fixed scale) or Cholesky factor L (normalised)."""
    weights: Float[Array, " n"]
    """(K + noise I)^-1 targets; zeros in a model that keeps none."""

    @property
    def capacity(self) -> int:
        return self.points.shape[0]

    @property
    def active(self) -> Bool[Array, " n"]:
        return jnp.arange(self.capacity) < self.count


class Appended(eqx.Module):
    """What one more point changes in a posterior that only appends: vectors, however large its matrix is."""

    index: Int[Array, ""]
    """Row of the point; the capacity, which is no row, if nothing is to be written."""
    count: Int[Array, ""]
    point: Float[Array, " d"]
    target: Float[Array, ""]
    row: Float[Array, " n"]
    """Of `matrix`."""
    weights: Float[Array, " n"]


class GaussianProcess(eqx.Module):
    """Zero-mean Gaussian process with observation noise.

    Fields:
        kernel: covariance of the scaled inputs.
        noise: variance added to the diagonal, and part of every predictive variance.
        normalise: scale by the dictionary's standard deviations (GPC-NS) instead of fixed weights. Static.
        keeps_weights: whether the mean is wanted; a human model is only asked for its uncertainty. Static.
        replaces: whether points may be replaced in place; a model that only appends skips that work. Static.
    """

    kernel: Kernel
    noise: Float[Array, ""]
    normalise: bool = eqx.field(static=True, default=False)
    keeps_weights: bool = eqx.field(static=True, default=True)
    replaces: bool = eqx.field(static=True, default=True)

    def init(self, capacity: int, scale: Float[Array, " d"]) -> Posterior:
        """The empty dictionary."""
        empty = jnp.eye(capacity) if self.normalise else jnp.zeros((capacity, capacity))
        return Posterior(
            points=jnp.zeros((capacity, scale.shape[0])),
            targets=jnp.zeros(capacity),
            count=jnp.zeros((), jnp.int32),
            scale=jnp.ones_like(scale) if self.normalise else scale,
            matrix=empty,
            weights=jnp.zeros(capacity),
        )

    def covariances(self, posterior: Posterior, point: Float[Array, " d"]) -> Float[Array, " n"]:
        """k(x_i, x) with every point of the dictionary, zero on unused rows."""
        values = self.kernel.covariances(posterior.points, point, posterior.scale)
        return jnp.where(posterior.active, values, 0.0)

    def deviation(self, posterior: Posterior, covariances: Float[Array, " n"]) -> Float[Array, ""]:
        """Predictive standard deviation at the input with these covariances, noise included (2.9)."""
        if self.normalise:
            whitened = factor.solve(posterior.matrix, covariances)
        else:
            whitened = factor.whiten(posterior.matrix, covariances)
        return jnp.sqrt(self._variance(whitened))

    def put(
        self,
        posterior: Posterior,
        point: Float[Array, " d"],
        target: Float[Array, ""],
        index: Int[Array, ""],
        write: Bool[Array, ""],
    ) -> Posterior:
        """Appends (`index == count`) or replaces (`index < count`) one point; where `write` is false, nothing changes.

        The caller keeps `index` below the capacity wherever `write` is true.
        """
        if not (self.normalise or self.replaces):
            return write_appended(posterior, self.append(posterior, point, target, write))
        here = (jnp.arange(posterior.capacity) == index) & write
        appended = write & (index >= posterior.count)
        data = dataclasses.replace(
            posterior,
            points=jnp.where(here[:, None], point[None], posterior.points),
            targets=jnp.where(here, target, posterior.targets),
            count=posterior.count + appended.astype(posterior.count.dtype),
        )
        if self.normalise:
            return self._refactor(posterior, data, write)
        return self._update(data, posterior, point, index, write)

    def append(
        self,
        posterior: Posterior,
        point: Float[Array, " d"],
        target: Float[Array, ""],
        write: Bool[Array, ""],
    ) -> Appended:
        """What one more point changes, for `write_appended`. With a fixed scale only.

        The caller keeps `count` below the capacity wherever `write` is true.
        """
        whitened = factor.whiten(posterior.matrix, self.covariances(posterior, point))
        row = factor.new_row(posterior.matrix, posterior.count, whitened, self._variance(whitened))
        weights = posterior.weights
        if self.keeps_weights:
            here = jnp.arange(posterior.capacity) == posterior.count
            targets = jnp.where(here, target, posterior.targets)
            weights = jnp.where(write, weights + row * (row * targets).sum(), weights)
        return Appended(
            index=jnp.where(write, posterior.count, posterior.capacity),
            count=posterior.count + write.astype(posterior.count.dtype),
            point=point,
            target=target,
            row=row,
            weights=weights,
        )

    def grow(self, posterior: Posterior, capacity: int) -> Posterior:
        """The same dictionary with room for `capacity` points."""
        old = posterior.capacity
        if capacity < old:
            raise ValueError(f"capacity {capacity} is below the dictionary's {old}")

        def pad(array: Array) -> Array:
            return jnp.pad(array, [(0, capacity - old)] + [(0, 0)] * (array.ndim - 1))

        matrix = jnp.pad(posterior.matrix, (0, capacity - old))
        if self.normalise:
            matrix = matrix + jnp.diag((jnp.arange(capacity) >= old).astype(matrix.dtype))
        return Posterior(
            points=pad(posterior.points),
            targets=pad(posterior.targets),
            count=posterior.count,
            scale=posterior.scale,
            matrix=matrix,
            weights=pad(posterior.weights),
        )

    def _variance(self, whitened: Float[Array, " n"]) -> Float[Array, ""]:
        """Prior variance less what is explained; rounding cannot take it below the noise."""
        return jnp.maximum(self.kernel.variance + self.noise - (whitened * whitened).sum(), self.noise)

    def _update(
        self,
        data: Posterior,
        before: Posterior,
        point: Float[Array, " d"],
        index: Int[Array, ""],
        write: Bool[Array, ""],
    ) -> Posterior:
        root, weights = before.matrix, before.weights
        covariances = self.covariances(before, point)
        replaced = write & (index < before.count)
        root, column = factor.remove(root, index, replaced)
        # Column `index` of the new root is zero, so the old point's covariance no longer matters.
        if self.keeps_weights:
            here = jnp.arange(before.capacity) == index
            share = jnp.take(weights, index) / jnp.where(replaced, jnp.take(column, index), 1.0)
            remaining = jnp.where(here, 0.0, weights - column * share)
            weights = jnp.where(replaced, remaining, weights)
        whitened = factor.whiten(root, covariances)
        root, row = factor.append(root, index, whitened, self._variance(whitened), write)
        if self.keeps_weights:
            weights = jnp.where(write, weights + row * (row * data.targets).sum(), before.weights)
        return dataclasses.replace(data, matrix=root, weights=weights)

    def _refactor(self, before: Posterior, data: Posterior, write: Bool[Array, ""]) -> Posterior:
        scale = normalising_scale(data.points, data.active)
        sizes = _leading_sizes(data.capacity)
        smallest = jnp.searchsorted(jnp.array(sizes), data.count)
        branches = [functools.partial(self._factor_leading, size) for size in sizes]
        lower, weights = lax.switch(smallest, branches, data, scale)
        return dataclasses.replace(
            data,
            matrix=jnp.where(write, lower, before.matrix),
            scale=jnp.where(write, scale, before.scale),
            weights=jnp.where(write, weights, before.weights),
        )

    def _factor_leading(
        self, size: int, data: Posterior, scale: Float[Array, " d"]
    ) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Factor and weights from the first `size` rows, which hold all points in use."""
        points, active = data.points[:size], data.active[:size]
        lower = factor.cholesky(self.kernel.gram(points, scale), active, self.noise)
        weights = data.weights
        if self.keeps_weights:
            solved = factor.solve(lower, data.targets[:size])
            weights = weights.at[:size].set(factor.solve(lower, solved, transpose=True))
        return jnp.eye(data.capacity).at[:size, :size].set(lower), weights


def write_appended(
    posterior: Posterior, appended: Appended, where: tuple[Int[Array, ""] | int, ...] = ()
) -> Posterior:
    """The posterior with the new point. `where` tells its place if the fields have axes before their own."""
    there = (*where, appended.index)
    return eqx.tree_at(
        lambda old: (old.points, old.targets, old.count, old.matrix, old.weights),
        posterior,
        (
            posterior.points.at[there].set(appended.point, mode="drop"),
            posterior.targets.at[there].set(appended.target, mode="drop"),
            posterior.count.at[where].set(appended.count),
            posterior.matrix.at[there].set(appended.row, mode="drop"),
            posterior.weights.at[where].set(appended.weights),
        ),
    )


def _leading_sizes(capacity: int) -> tuple[int, ...]:
    """Up to four sizes, so that a dictionary that has grown little is not factorised with all of its empty rows."""
    quarter = 8 * max(2, math.ceil(capacity / 32))
    return (*range(quarter, capacity, quarter), capacity)


def normalising_scale(points: Float[Array, "n d"], active: Bool[Array, " n"]) -> Float[Array, " d"]:
    """1 / sigma_m: inverse standard deviation (ddof 0) of each dimension over the dictionary, 1 if it is constant."""
    count = jnp.maximum(active.sum(), 1)
    mask = active[:, None]
    mean = jnp.where(mask, points, 0.0).sum(0) / count
    centred = jnp.where(mask, points - mean[None], 0.0)
    deviation = jnp.sqrt((centred * centred).sum(0) / count)
    return jnp.where(deviation < SMALLEST_DEVIATION, 1.0, 1.0 / jnp.where(deviation > 0, deviation, 1.0))
