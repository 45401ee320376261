"""What a learner asks of a Gaussian process that learns one point at a time; its models are apart.

| model | scale of the inputs | a point | used as |
|---|---|---|---|
| `gpcjax.gp.appending` | fixed | O(n^2), half of a factor; appended only | GPC's human model |
| `gpcjax.gp.replacing` | fixed | O(n^2); appended, or in another one's place | GPC's policy; a human model that does |
| `gpcjax.gp.renormalised` | of the dictionary | O(n^3); all is computed anew | both of GPC-NS |

A `GaussianProcess` holds the hyperparameters, a `Posterior` the data and what is derived from them. Posteriors are
read and written where they are: `posteriors` holds one or many, `place` is the place of the one that is meant (the
indices of the first axes), and no large matrix is copied.
"""

import abc
import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import tiles
from gpcjax.gp.batching import together
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.posterior import Posterior
from gpcjax.gp.tiles import Places

PART = 64
"""Points whose covariances are computed at once."""


class Change(eqx.Module):
    """What one more point, or another one, changes in a posterior; not written yet."""

    @abc.abstractmethod
    def only(self, write: Bool[Array, ""]) -> "Change":
        """The same where `write` is true, and nothing to be written where it is not."""

    @abc.abstractmethod
    def write(self, posteriors: Posterior, place: Places) -> Posterior:
        """The posteriors with this change of the one at `place`."""

    @abc.abstractmethod
    def points(self) -> Float[Array, "m d"]:
        """The inputs that it writes, or writes once more."""

    @abc.abstractmethod
    def numbers(self) -> tuple[Float[Array, "..."], ...]:
        """All else that it writes and that may come out as no number."""

    @abc.abstractmethod
    def scale(self, before: Float[Array, " d"]) -> Float[Array, " d"]:
        """That of the posterior when it is written, given that of the posterior `before`."""


class Reading(eqx.Module):
    """What a posterior tells of an input. A model adds what its `put` needs to learn it."""

    deviation: Float[Array, ""]
    """Predictive standard deviation, noise included."""


class GaussianProcess(eqx.Module):
    """Zero-mean Gaussian process with observation noise.

    Fields of each model:
        kernel: covariance of the scaled inputs.
        noise: variance added to the diagonal, and part of every predictive variance.

    A correction is `covariances`, `read`, `put` and `Change.write`, in this order; what is read and `sound`
    tell in between whether it is wanted.
    """

    kernel: eqx.AbstractVar[Kernel]
    noise: eqx.AbstractVar[Float[Array, ""]]
    normalise: ClassVar[bool]
    """Whether inputs are scaled by the dictionary's standard deviations (GPC-NS) instead of fixed weights."""

    @abc.abstractmethod
    def init(self, capacity: int, scale: Float[Array, " d"]) -> Posterior:
        """The empty dictionary; `scale` is w, which a model that normalises makes itself."""

    @abc.abstractmethod
    def explained(
        self, posteriors: Posterior, place: Places, covariances: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """How much of the variance of an input with these covariances the points at `place` explain."""

    @abc.abstractmethod
    def read(
        self,
        posteriors: Posterior,
        place: Places,
        covariances: Float[Array, " n"],
        point: Int[Array, ""] | None = None,
    ) -> Reading:
        """What the posterior at `place` tells of an input with these covariances: what `put` needs to learn it.

        `point` is the row that the input may replace, if any.
        """

    @abc.abstractmethod
    def put(
        self,
        posteriors: Posterior,
        place: Places,
        reading: Any,
        point: Float[Array, " d"],
        target: Float[Array, ""],
        index: Int[Array, ""],
        write: Bool[Array, ""],
    ) -> Change:
        """What one point changes that is appended (`index == count`) or replaces another (`index < count`).

        `reading` is that of `point`, as this model's `read` gives it; if it replaces another one, from a `read` that
        was told so. The caller keeps `index` below the capacity wherever `write` is true; where it is false, nothing
        changes.
        """

    @abc.abstractmethod
    def renewed(self, data: Posterior) -> Posterior:
        """The points and targets of one posterior with all that follows from them computed anew, in O(n^3).

        The scale of `data` is w, as `init` takes it; its matrix and its weights do not count, but for their shapes.
        """

    @abc.abstractmethod
    def grow_matrix(self, matrix: Float[Array, "..."], old: int, capacity: int) -> Float[Array, "..."]:
        """That of a posterior with room for `old` points, for `capacity`: as many or more."""

    def covariances(
        self, posteriors: Posterior, place: Places, point: Float[Array, " d"]
    ) -> Float[Array, " n"]:
        """k(x_i, x) with every point of the dictionary at `place`, zero on unused rows.

        Only of the parts in use, however much room there is. The loop has another use, too: without it XLA computes
        all of them anew wherever one is asked for, and number by number where they are summed or compared.
        """
        n, d = posteriors.points.shape[-2:]
        size = n if together() or n % PART else PART
        count, scale = posteriors.count[place], tiles.take(posteriors.scale, place)

        def part(index: Int[Array, ""], covariances: Float[Array, " n"]) -> Float[Array, " n"]:
            first = index * size
            points = tiles.cut(posteriors.points, place, (first, 0), (size, d))
            active = first + jnp.arange(size) < count
            values = jnp.where(active, self.kernel.covariances(points, point, scale), 0.0)
            return lax.dynamic_update_slice(covariances, values, (first,))

        if together():
            return part(jnp.int32(0), jnp.zeros(n))
        return lax.fori_loop(0, tiles.whole(count, size), part, jnp.zeros(n))

    def deviation(self, explained: Float[Array, ""]) -> Float[Array, ""]:
        """Predictive standard deviation of an input of whose variance the points explain this, noise included (2.9).

        Rounding cannot take it below that of the noise.
        """
        return jnp.sqrt(jnp.maximum(self.prior - explained, self.noise))

    def uncertainty(
        self, posteriors: Posterior, place: Places, point: Float[Array, " d"]
    ) -> Float[Array, ""]:
        """Predictive standard deviation of the posterior at `place`, at `point`."""
        return self.deviation(self.explained(posteriors, place, self.covariances(posteriors, place, point)))

    def sound(self, change: Change, scale: Float[Array, " d"]) -> Bool[Array, ""]:
        """Whether all that a change would write is a number, and no point so far away that its distances are none.

        `scale` is that of the dictionary before.
        """
        scale = change.scale(scale)
        # Twice as far, for the point on the other side.
        across = 2.0 * change.points() * (scale * self.kernel.inverse_length)[None]
        near = jnp.isfinite(scale).all() & (scale > 0).all() & jnp.isfinite((across * across).sum())
        return near & jnp.stack([jnp.isfinite(number).all() for number in change.numbers()]).all()

    def grow(self, posterior: Posterior, capacity: int) -> Posterior:
        """The same dictionary with room for `capacity` points."""
        old = posterior.capacity
        if capacity < old:
            raise ValueError(f"capacity {capacity} is below the dictionary's {old}")

        def pad(array: Array) -> Array:
            return jnp.pad(array, [(0, capacity - old)] + [(0, 0)] * (array.ndim - 1))

        return dataclasses.replace(
            posterior,
            points=pad(posterior.points),
            targets=pad(posterior.targets),
            matrix=self.grow_matrix(posterior.matrix, old, capacity),
            weights=pad(posterior.weights),
        )

    @property
    def prior(self) -> Float[Array, ""]:
        """Variance of an observation before any data."""
        return jnp.add(self.kernel.variance, self.noise)  # on the host too an array of jax


def nearest(covariances: Float[Array, " n"]) -> Int[Array, ""]:
    """Row of the first point of largest covariance, int32; the last row where one is no number.

    XLA makes loops over vectors of these two reductions, and compares number by number for `argmax`.
    """
    last = covariances.shape[0] - 1
    return jnp.where(covariances == covariances.max(), jnp.arange(last + 1, dtype=jnp.int32), last).min()
