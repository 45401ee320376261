"""Normalised radial basis functions on a regular grid (2.4), and the linear policy on them.

The features are Gaussians of one width on a grid, normalised to sum to one. They are therefore a product of one soft
assignment for each observation dimension, and are kept that way: a grid of 4 x 4 x 4 x 4 costs 16 exponentials,
and an observation far outside the grid still has features that sum to one.
"""

import functools
import operator

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from gpcjax.policies.base import Controller


class Grid(eqx.Module):
    """Centres of the basis functions: `counts[i]` points from `lower[i]` to `upper[i]`; the spacing is the width."""

    lower: Float[Array, "obs *lanes"]
    upper: Float[Array, "obs *lanes"]
    counts: tuple[int, ...] = eqx.field(static=True)

    def memberships(self, obs: Float[Array, "obs *lanes"]) -> list[Float[Array, "count *lanes"]]:
        """For each observation dimension the normalised features along it; their outer product is phi."""
        result = []
        for i, count in enumerate(self.counts):
            spacing = (self.upper[i] - self.lower[i]) / (count - 1)
            steps = jnp.arange(count, dtype=obs.dtype).reshape(count, *[1] * (obs.ndim - 1))
            distance = (obs[i] - self.lower[i])[None] / spacing[None] - steps
            exponent = -0.5 * distance * distance
            values = jnp.exp(exponent - exponent.max(0, keepdims=True))
            result.append(values / values.sum(0, keepdims=True))
        return result

    def features(self, obs: Float[Array, " obs"]) -> Float[Array, "*grid"]:
        """phi(s), of the grid's shape, summing to one."""
        product = jnp.ones(())
        for values in self.memberships(obs):
            product = product[..., None] * values.reshape((1,) * product.ndim + (-1,))
        return product


class GridController(Controller):
    """theta . phi(s), contracted one observation dimension at a time."""

    weights: Float[Array, "action *grid_and_lanes"]
    grid: Grid

    @property
    def obs_size(self) -> int:
        return len(self.grid.counts)

    @property
    def action_size(self) -> int:
        return self.weights.shape[0]

    def __call__(self, obs: Float[Array, "obs *lanes"]) -> Float[Array, "action *lanes"]:
        total = self.weights
        for i, values in reversed(list(enumerate(self.grid.memberships(obs)))):
            # Written out, not as a reduction: XLA then makes one loop of it, over lanes, with no array in between.
            values = values.reshape(values.shape[0], *[1] * (1 + i), *values.shape[1:])
            terms = (
                lax.index_in_dim(total, k, 1 + i, keepdims=False) * values[k] for k in range(len(values))
            )
            total = functools.reduce(operator.add, terms)
        return total
