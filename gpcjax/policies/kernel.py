"""The policy of a Gaussian process: its predictive mean."""

import equinox as eqx
from jaxtyping import Array, Float

from gpcjax.gp.kernels import correlation, sum_of_squares
from gpcjax.policies.base import Controller


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
        place = obs[None] * self.scale
        squared = sum_of_squares(self.points[:, :, i] - place[:, None, i] for i in range(obs.shape[0]))
        return (correlation(squared, self.smoothness) * self.weights).sum(1)
