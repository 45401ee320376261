"""The last steps of every lane, which late advice is about, and how a learner reckons with its lateness."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gpcjax.lateness import CREDIT, lateness
from gpcjax.moment import Moment


class Credit(eqx.Module):
    """Which earlier steps an advice is about, as a learner reckons: the credit assigner of section 2.3.1.

    Fields:
        first: steps back of the latest moment that it may be about. Static.
        weights: (moments,), how much of the advice each moment is given, from the latest to the earliest; their sum is
            1. A correction with weight w is one by w times the learning rate.
    """

    weights: Float[Array, "moments *lanes"]
    first: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, seconds: float | None, longest: float | None, shape: float | None, time_step: float
    ) -> "Credit | None":
        """Of the settings `credit`, `credit_longest` and `credit_shape`; None if all advice is about the present step.

        Raises:
            UserError: they do not fit together (`gpcjax.lateness`).
        """
        chances = lateness(CREDIT, seconds, longest, shape, time_step)
        first = next(index for index, chance in enumerate(chances) if chance > 0)
        return None if len(chances) == 1 else cls(weights=jnp.asarray(chances[first:]), first=first)

    @property
    def moments(self) -> int:
        """How many moments an advice is about."""
        return self.weights.shape[0]

    @property
    def reach(self) -> int:
        """How many steps back the earliest moment lies."""
        return self.first + self.moments - 1


class History(eqx.Module):
    """The last `depth` steps of an episode: that of time t is at place t modulo depth."""

    obs: Float[Array, "depth obs *lanes"]
    action: Float[Array, "depth action *lanes"]

    @classmethod
    def empty(cls, depth: int, obs_size: int, action_size: int) -> "History | None":
        """Of one lane; None where no step needs to be kept."""
        return cls(jnp.zeros((depth, obs_size)), jnp.zeros((depth, action_size))) if depth else None

    @property
    def depth(self) -> int:
        return self.obs.shape[0]

    def with_step(self, moment: Moment, mask: Bool[Array, " lanes"]) -> "History":
        """With a step of the lanes `mask` it was executed, in place of their oldest."""
        place = jnp.where(mask, moment.step % self.depth, self.depth)  # behind the last one: dropped
        lane = jnp.arange(place.shape[0])
        return History(
            obs=self.obs.at[place, :, lane].set(moment.obs.T, mode="drop"),
            action=self.action.at[place, :, lane].set(moment.action.T, mode="drop"),
        )

    def before(self, moment: Moment, back: Int[Array, " lanes"]) -> Moment:
        """The steps so far `back` of the present ones; they must be in the same episode."""
        place, lane = (moment.step - back) % self.depth, jnp.arange(back.shape[0])
        obs, action = self.obs[place, :, lane].T, self.action[place, :, lane].T
        return Moment(
            obs=jnp.where(back == 0, moment.obs, obs),
            action=jnp.where(back == 0, moment.action, action),
            episode=moment.episode,
            step=moment.step - back,
            draws=moment.draws,
        )
