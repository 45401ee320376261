"""The policy of a Gaussian process: its predictive mean."""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from gpcjax.gp.kernels import correlation, sum_of_squares
from gpcjax.policies.base import Controller

PART = 64
"""Points that are summed at once, or more, of which four parts are all there is room for. Up to 32 of them XLA sums in
another order, and in twice the time.
"""


class KernelController(Controller):
    """Weighted kernel sums over one dictionary for each action dimension: k(s) . alpha (2.9)."""

    points: Float[Array, "action n obs *lanes"]
    """Dictionary inputs, scaled and divided by the length-scale."""
    weights: Float[Array, "action n *lanes"]
    """c * alpha, zero on unused rows."""
    scale: Float[Array, "action obs *lanes"]
    """What an observation is multiplied by to stand among `points`."""
    smoothness: float = eqx.field(static=True)

    @property
    def obs_size(self) -> int:
        return self.scale.shape[1]

    @property
    def action_size(self) -> int:
        return self.scale.shape[0]

    def __call__(self, obs: Float[Array, "obs *lanes"]) -> Float[Array, "action *lanes"]:
        return self._sum(obs, 0, self.points.shape[1])

    def in_use(self, lanes: Bool[Array, " lanes"]) -> Callable[[Array], Array]:
        if type(self).__call__ is not KernelController.__call__:
            return self  # somebody's own, who acts otherwise
        room = self.points.shape[1]
        part = max(PART, -(-room // (4 * PART)) * PART)
        others = [(first, min(first + part, room)) for first in range(part, room, part)]
        # A sum over points goes through all lanes at once; what is no number is not zero either.
        weighed = [jnp.abs(self.weights[:, first:end]).sum(1) != 0.0 for first, end in others]
        counts = [(each & lanes[None]).any() for each in weighed]

        def act(obs: Float[Array, "obs lanes"]) -> Float[Array, "action lanes"]:
            """The sum part by part, whichever of them count: so its bits do not depend on that."""
            total = self._sum(obs, 0, min(part, room))
            nothing = jnp.zeros_like(total)
            for (first, end), count in zip(others, counts, strict=True):
                total += lax.cond(count, partial(self._sum, first=first, end=end), lambda _: nothing, obs)
            return total

        return act

    def _sum(self, obs: Float[Array, "obs *lanes"], first: int, end: int) -> Float[Array, "action *lanes"]:
        """The weighted kernels of the points from `first` up to `end`."""
        place = obs[None] * self.scale
        points = self.points[:, first:end]
        squared = sum_of_squares(points[:, :, i] - place[:, None, i] for i in range(obs.shape[0]))
        return (correlation(squared, self.smoothness) * self.weights[:, first:end]).sum(1)
