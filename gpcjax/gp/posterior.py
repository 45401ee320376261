"""The data of a Gaussian process: a dictionary of fixed capacity and what is derived from it, one or many."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gpcjax.gp import tiles
from gpcjax.gp.tiles import Places


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
    matrix: Float[Array, "..."]
    """What the model keeps of the Gram matrix: `Appending`, `Replacing` and `Renormalised` say what that is."""
    weights: Float[Array, "*places n"]
    """(K + noise I)^-1 targets; zeros in a model that keeps none."""

    @property
    def capacity(self) -> int:
        return self.points.shape[-2]

    @property
    def active(self) -> Bool[Array, " n"]:
        return jnp.arange(self.capacity) < self.count


def empty(capacity: int, scale: Float[Array, " d"], matrix: Float[Array, "..."]) -> Posterior:
    """No points, room for `capacity` of them."""
    return Posterior(
        points=jnp.zeros((capacity, scale.shape[0])),
        targets=jnp.zeros(capacity),
        count=jnp.zeros((), jnp.int32),
        scale=scale,
        matrix=matrix,
        weights=jnp.zeros(capacity),
    )


def take(posteriors: Posterior, place: Places) -> Posterior:
    """The one at `place`."""
    return jax.tree.map(lambda leaf: tiles.take(leaf, place), posteriors)


def small(posteriors: Posterior, place: Places) -> Posterior:
    """The one at `place`, with an empty matrix: the others of its fields are small."""
    nothing = jnp.zeros((*posteriors.matrix.shape[: len(place)], 0))
    return take(eqx.tree_at(lambda old: old.matrix, posteriors, nothing), place)


def with_point(
    posteriors: Posterior,
    place: Places,
    index: Int[Array, ""],
    point: Float[Array, " d"],
    target: Float[Array, ""],
    count: Int[Array, ""],
) -> Posterior:
    """The posteriors with a point in row `index` of the one at `place`, or in none if there is no such row.

    Its count is `count`; matrix and weights are as they were.
    """
    return dataclasses.replace(
        posteriors,
        points=posteriors.points.at[(*place, index)].set(point, mode="drop"),
        targets=posteriors.targets.at[(*place, index)].set(target, mode="drop"),
        count=posteriors.count.at[place].set(count),
    )
