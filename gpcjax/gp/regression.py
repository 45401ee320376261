"""Gaussian process regression on a dictionary of fixed capacity, one point at a time.

`GaussianProcess` holds the hyperparameters, `Posterior` the data and what is derived from them. The inputs are scaled
per dimension: by fixed weights (GPC), or by the inverse standard deviation of each dimension over the dictionary
(GPC-NS). With fixed weights a new point is an O(n^2) update of the inverse factor; with normalisation it moves every
entry of the Gram matrix, and the factor is computed anew, O(n^3).
"""

import dataclasses
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.gp import factor
from gpcjax.gp.factor import Reading
from gpcjax.gp.kernels import Kernel

Places = factor.Places

SMALLEST_DEVIATION = 1e-6
"""A dimension that varies less than this over the dictionary is not normalised (DESIGN section 2, sigma_m)."""


class Posterior(eqx.Module):
    """A dictionary of up to n points of d dimensions and its factor; or many, their places as first axes.

    Rows from `count` on are unused: their points and targets are zero, and so are their rows and columns of `matrix`
    (but for the unit diagonal of a Cholesky factor).
    """

    points: Float[Array, "*places n d"]
    """Inputs as given, before scaling."""
    targets: Float[Array, "*places n"]
    """Outputs: actions for a policy, advice for a human model."""
    count: Int[Array, "*places"]
    """Number of points in use, int32."""
    scale: Float[Array, "*places d"]
    """What each input dimension is multiplied by before the kernel."""
    matrix: factor.Roots
    """Inverse root S (fixed scale), as `gpcjax.gp.factor` keeps it, or Cholesky factor L (normalised; n times n).

    A normalised model without weights keeps none (0 times 0): it is only asked before a correction, which changes all
    of its factor, and makes it then.
    """
    weights: Float[Array, "*places n"]
    """(K + noise I)^-1 targets; zeros in a model that keeps none."""

    @property
    def capacity(self) -> int:
        return self.points.shape[-2]

    @property
    def active(self) -> Bool[Array, " n"]:
        return jnp.arange(self.capacity) < self.count


class Appended(eqx.Module):
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


class Placed(eqx.Module):
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

    @property
    def row(self) -> Float[Array, " n"]:
        """Of `matrix`."""
        return self.edit.row


class Renewed(eqx.Module):
    """A posterior with normalisation after a point: all of it is new."""

    posterior: Posterior
    given: Bool[Array, ""]
    """Whether there is anything to be written."""

    def only(self, write: Bool[Array, ""]) -> "Renewed":
        """The same where `write` is true, and nothing to be written where it is not."""
        return dataclasses.replace(self, given=self.given & write)


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
        kept = capacity if self.keeps_weights else 0
        empty = jnp.eye(kept) if self.normalise else factor.empty(capacity, self.lower)
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

    def explained(
        self, posteriors: Posterior, where: Places, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """How much of the variance of an input with these covariances the points at `where` explain."""
        if not self.normalise:
            return factor.explained(
                posteriors.matrix, where, posteriors.count[where], covariances, self.lower
            )
        if not self.keeps_weights:
            return self._explained_anew(small(posteriors, where), covariances)
        whitened = factor.solve(factor.take(posteriors.matrix, where), covariances)
        return (whitened * whitened).sum()

    def read(
        self,
        posteriors: Posterior,
        where: Places,
        covariances: Float[Array, " n"],
        point: Int[Array, ""] | None = None,
    ) -> Reading:
        """What the posterior at `where` tells of an input with these covariances, and of a `point` that may go.

        With normalisation only what the points explain: all else is made anew by `put`.
        """
        if self.normalise:
            nothing = jnp.zeros_like(covariances)
            return Reading(self.explained(posteriors, where, covariances), nothing, nothing)
        count = posteriors.count[where]
        return factor.read(posteriors.matrix, where, count, covariances, point, self.lower)

    def deviation(self, explained: Float[Array, ""]) -> Float[Array, ""]:
        """Predictive standard deviation of an input of whose variance the points explain this, noise included (2.9).

        Rounding cannot take it below that of the noise.
        """
        return jnp.sqrt(jnp.maximum(self._prior - explained, self.noise))

    def uncertainty(self, posterior: Posterior, point: Float[Array, " d"]) -> Float[Array, ""]:
        """Predictive standard deviation at `point`."""
        return self.deviation(self.explained(posterior, (), self.covariances(posterior, point)))

    def put(
        self,
        posteriors: Posterior,
        where: Places,
        reading: Reading,
        point: Float[Array, " d"],
        target: Float[Array, ""],
        index: Int[Array, ""],
        write: Bool[Array, ""],
    ) -> "Renewed | Placed":
        """What one point changes that is appended (`index == count`) or replaces another (`index < count`).

        `reading` is that of `point`, with the column of the one that it replaces. The caller keeps `index` below the
        capacity wherever `write` is true; where it is false, nothing changes. For `write`.
        """
        before = small(posteriors, where)
        here = jnp.arange(before.capacity) == index
        count = before.count + (write & (index >= before.count)).astype(before.count.dtype)
        targets = jnp.where(here & write, target, before.targets)
        if self.normalise:
            points = jnp.where((here & write)[:, None], point[None], before.points)
            before = take(posteriors, where)
            data = dataclasses.replace(before, points=points, targets=targets, count=count)
            return Renewed(self._refactored(data), write)
        edit = factor.edit(posteriors.matrix, where, before.count, index, reading, self._prior, self.noise)
        weights = before.weights
        if self.keeps_weights:
            share = jnp.take(weights, index) / jnp.where(edit.replaces, jnp.take(reading.column, index), 1.0)
            others = jnp.where(edit.replaces, jnp.where(here, 0.0, weights - reading.column * share), weights)
            weights = others + edit.row * (edit.row * targets).sum()
        return Placed(edit, before.count, count, point, target, weights, write)

    def append(
        self,
        posteriors: Posterior,
        where: Places,
        point: Float[Array, " d"],
        target: Float[Array, ""],
    ) -> tuple[Float[Array, ""], Appended]:
        """The deviation at `point`, and what it changes as one more point, for `write`.

        For a fixed scale, without weights, and a dictionary to which points were only appended: the one at `where`
        among `posteriors`, whose matrices are not copied. The caller keeps `count` below the capacity, or the point is
        no part of it.
        """
        posterior = small(posteriors, where)
        reading = self.read(posteriors, where, self.covariances(posterior, point))
        deviation, row = factor.new_row(
            reading.solved, reading.explained, posterior.count, self._prior, self.noise
        )
        before = posterior.count
        return deviation, Appended(before, before, before + 1, point, target, row)

    def sound(self, change: "Renewed | Placed | Appended", scale: Float[Array, " d"]) -> Bool[Array, ""]:
        """Whether all that a change would write is a number, and no point so far away that its distances are none.

        `scale` is that of the dictionary before; with normalisation the change has its own.
        """
        if isinstance(change, Renewed):
            new = change.posterior
            points, scale, numbers = new.points, new.scale, (new.targets, new.weights)
        else:
            points, numbers = change.point[None], (change.target, change.row)
            if isinstance(change, Placed):
                numbers = (*numbers, change.weights, change.edit.scaled, change.edit.image)
        # Twice as far, for the point on the other side.
        across = 2.0 * points * (scale * self.kernel.inverse_length)[None]
        near = jnp.isfinite(scale).all() & (scale > 0).all() & jnp.isfinite((across * across).sum())
        return near & jnp.stack([jnp.isfinite(number).all() for number in numbers]).all()

    def grow(self, posterior: Posterior, capacity: int) -> Posterior:
        """The same dictionary with room for `capacity` points."""
        old = posterior.capacity
        if capacity < old:
            raise ValueError(f"capacity {capacity} is below the dictionary's {old}")

        def pad(array: Array) -> Array:
            return jnp.pad(array, [(0, capacity - old)] + [(0, 0)] * (array.ndim - 1))

        if self.normalise and not self.keeps_weights:
            matrix = posterior.matrix
        elif self.normalise:
            unused = jnp.diag((jnp.arange(capacity) >= old).astype(posterior.matrix.dtype))
            matrix = jnp.pad(posterior.matrix, (0, capacity - old)) + unused
        else:
            matrix = factor.grow(posterior.matrix, capacity, self.lower)
        return Posterior(
            points=pad(posterior.points),
            targets=pad(posterior.targets),
            count=posterior.count,
            scale=posterior.scale,
            matrix=matrix,
            weights=pad(posterior.weights),
        )

    @property
    def lower(self) -> bool:
        """Whether its roots are `lower` ones: of points that are only appended."""
        return not (self.normalise or self.replaces)

    @property
    def _prior(self) -> Float[Array, ""]:
        """Variance of an observation before any data."""
        return self.kernel.variance + self.noise

    def _refactored(self, data: Posterior) -> Posterior:
        scale = normalising_scale(data.points, data.active)
        if not self.keeps_weights:
            return dataclasses.replace(data, scale=scale)
        lower, weights = _switch_leading(
            data.capacity, data.count, GaussianProcess._solve_leading, self, data, scale
        )
        return dataclasses.replace(data, matrix=lower, scale=scale, weights=weights)

    def _factor_leading(self, size: int, data: Posterior, scale: Float[Array, " d"]) -> Float[Array, "m m"]:
        """From the first `size` rows, which hold all points in use."""
        return factor.cholesky(self.kernel.gram(data.points[:size], scale), data.active[:size], self.noise)

    def _solve_leading(
        self, size: int, data: Posterior, scale: Float[Array, " d"]
    ) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Factor and weights."""
        lower = self._factor_leading(size, data, scale)
        solved = factor.solve(lower, data.targets[:size])
        weights = data.weights.at[:size].set(factor.solve(lower, solved, transpose=True))
        return jnp.eye(data.capacity).at[:size, :size].set(lower), weights

    def _explained_anew(self, data: Posterior, covariances: Float[Array, " n"]) -> Float[Array, ""]:
        """|L^-1 k|^2, from a factor that is used once."""

        def explained(
            process: GaussianProcess, size: int, data: Posterior, covariances: Float[Array, " n"]
        ) -> Float[Array, ""]:
            whitened = factor.solve(process._factor_leading(size, data, data.scale), covariances[:size])
            return (whitened * whitened).sum()

        return _switch_leading(data.capacity, data.count, explained, self, data, covariances)


def take(posteriors: Posterior, where: Places) -> Posterior:
    """The one at `where`."""
    return jax.tree.map(lambda leaf: factor.take(leaf, where), posteriors)


def small(posteriors: Posterior, where: Places) -> Posterior:
    """The one at `where`, with an empty matrix: the others of its fields are small."""
    nothing = jnp.zeros((*posteriors.matrix.shape[: len(where)], 0))
    return take(eqx.tree_at(lambda old: old.matrix, posteriors, nothing), where)


def write(posteriors: Posterior, where: Places, change: Renewed | Placed | Appended) -> Posterior:
    """The posteriors with a change of the one at `where`."""
    if isinstance(change, Renewed):
        before = take(posteriors, where)
        after = jax.tree.map(lambda new, old: jnp.where(change.given, new, old), change.posterior, before)
        return jax.tree.map(lambda leaf, value: leaf.at[where].set(value), posteriors, after)
    if isinstance(change, Appended):
        index, count, weights = change.index, change.count, posteriors.weights
        matrix = factor.append(posteriors.matrix, where, change.index, change.row)
    else:
        index = jnp.where(change.given, change.edit.index, change.edit.row.shape[0])
        count = jnp.where(change.given, change.count, change.before)
        matrix = factor.write(posteriors.matrix, where, change.before, change.edit, change.given)
        before = factor.take(posteriors.weights, where)
        weights = posteriors.weights.at[where].set(jnp.where(change.given, change.weights, before))
    return Posterior(
        points=posteriors.points.at[(*where, index)].set(change.point, mode="drop"),
        targets=posteriors.targets.at[(*where, index)].set(change.target, mode="drop"),
        count=posteriors.count.at[where].set(count),
        scale=posteriors.scale,
        matrix=matrix,
        weights=weights,
    )


def _switch_leading(
    capacity: int,
    count: Int[Array, ""],
    function: Callable[..., PyTree],
    process: GaussianProcess,
    *operands: PyTree,
) -> PyTree:
    """`function(process, size, *operands)` with the smallest of a few sizes that holds all points.

    Under `vmap` one lane after the other, each with its own size: in one go all lanes would be factorised at all
    sizes. 64 lanes of capacity 64 learned 1,900 corrections a second like this and 1,000 in one go (there on one
    thread, where that does not hang; 16 lanes: 1,200 and 860; a busy machine of two cores).
    """
    sizes = _leading_sizes(capacity)

    @factor.one_at_a_time
    def choose(count: Int[Array, ""], process: GaussianProcess, operands: tuple[PyTree, ...]) -> PyTree:
        def at(size: int) -> Callable[..., PyTree]:
            return lambda process, operands: function(process, size, *operands)

        index = jnp.searchsorted(jnp.array(sizes), count)
        return lax.switch(index, [at(size) for size in sizes], process, operands)

    return choose(count, process, operands)


def _leading_sizes(capacity: int) -> tuple[int, ...]:
    """A few sizes, so that a dictionary that has grown little is not factorised with all of its empty rows."""
    parts = 4 if capacity <= 512 else 8
    step = 8 * max(2, math.ceil(capacity / (8 * parts)))
    return (*range(step, capacity, step), capacity)


def normalising_scale(points: Float[Array, "n d"], active: Bool[Array, " n"]) -> Float[Array, " d"]:
    """1 / sigma_m: inverse standard deviation (ddof 0) of each dimension over the dictionary, 1 if it is constant."""
    count = jnp.maximum(active.sum(), 1)
    mask = active[:, None]
    mean = jnp.where(mask, points, 0.0).sum(0) / count
    centred = jnp.where(mask, points - mean[None], 0.0)
    deviation = jnp.sqrt((centred * centred).sum(0) / count)
    return jnp.where(deviation < SMALLEST_DEVIATION, 1.0, 1.0 / jnp.where(deviation > 0, deviation, 1.0))
