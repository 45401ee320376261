"""The synthesised teacher: Alg. 4 of the thesis, with the active-learning chance of section 4.1.3."""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from gpcjax.errors import UserError
from gpcjax.policies.base import ByIdentity, Vector, check_executed, vector
from gpcjax.teachers.base import Teacher


class Oracle(Teacher):
    """Advises towards a target action, at random times, sometimes in the wrong direction.

    With coin u and chance gamma: advice is given where u < gamma, and it is inverted where u < gamma * e. That is
    Alg. 4 with one draw in place of its two.

    Fields:
        rate: gamma, or the least chance gamma_c of active learning.
        error: e, the probability that given advice has the wrong sign.
        delta: no advice where the action is within this of the target.
        active_gain: c_a of (3.6): the chance grows by c_a * sigma_h.
        active: whether the chance depends on sigma_h at all. Static.
        schedule: gamma of each episode in place of `rate`, the last one for all that follow; or None.
    """

    rate: Float[Array, "*lanes"]
    error: Float[Array, "*lanes"]
    delta: Float[Array, "*lanes"]
    active_gain: Float[Array, "*lanes"]
    active: bool = eqx.field(static=True)
    schedule: Float[Array, "episodes *lanes"] | None = None

    def during(self, episode: Int[Array, "*lanes"]) -> "Oracle":
        if self.schedule is None:
            return self
        index = jnp.minimum(episode, self.schedule.shape[0] - 1)
        rate = jnp.take_along_axis(self.schedule, index[None], axis=0)[0]
        return dataclasses.replace(self, rate=rate, schedule=None)

    def chance(self, sigma_human: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Gamma = c_a * sigma_h + gamma_c (section 4.1.3), at most 1."""
        rate, gain = (jnp.broadcast_to(value, sigma_human.shape) for value in (self.rate, self.active_gain))
        return jnp.minimum(gain * sigma_human + rate, 1.0) if self.active else rate

    def may_advise(
        self, coins: Float[Array, "action *lanes"], largest_sigma: Float[Array, "*lanes"]
    ) -> Bool[Array, "action *lanes"]:
        return coins < self.chance(largest_sigma)[None]

    def advise(
        self,
        coins: Float[Array, "action *lanes"],
        action: Float[Array, "action *lanes"],
        target: Float[Array, "action *lanes"],
        sigma_human: Float[Array, "action *lanes"],
    ) -> Float[Array, "action *lanes"]:
        gamma = self.chance(sigma_human)
        gap = target - action
        sign = jnp.where(jnp.abs(gap) > self.delta[None], jnp.sign(gap), 0.0)
        inverted = coins < gamma * self.error[None]
        return jnp.where(coins < gamma, jnp.where(inverted, -sign, sign), 0.0)


def synthesised(
    rate: float, error: float, delta: float, active_gain: float = 0.0, schedule: Sequence[float] | None = None
) -> Oracle:
    """The teacher of Alg. 4: `Oracle` with these numbers; a gain of 0 is no active learning."""
    numbers = {"rate": rate, "error": error, "delta": delta, "active_gain": active_gain}
    return Oracle(
        **{name: jnp.asarray(value, float) for name, value in numbers.items()},
        active=active_gain > 0,
        schedule=None if schedule is None else jnp.asarray(schedule, float),
    )


class Advisor(ByIdentity):
    """An oracle that knows its task: it works out the target by itself.

    Fields:
        expert: what it would do, obs (obs_size,) -> action (action_size,) in [-1, 1].
        oracle: when and how it advises.
        obs_size, action_size: of the task. Static.
    """

    expert: Callable[[Float[Array, " obs"]], Float[Array, " action"]]
    oracle: Oracle
    obs_size: int = eqx.field(static=True)
    action_size: int = eqx.field(static=True)

    def target(self, obs: Vector) -> Float[Array, " action"]:
        """The expert's action at `obs` (obs_size,). Raises ValueError for another shape."""
        return self.expert(jnp.asarray(vector("obs", obs, self.obs_size, "this oracle")))

    def advise(
        self, key: PRNGKeyArray, obs: Vector, action: Vector, sigma_human: Vector | None = None
    ) -> Float[Array, " action"]:
        """H (action_size,), each -1, 0 or 1, for an executed action, which is in [-1, 1]. Consumes `key`.

        Raises:
            ValueError: a shape does not fit, the action is beyond [-1, 1] (its value is not known where jax traces it:
                clip it there), or active learning needs `sigma_human`, from `Learner.uncertainty`.
        """
        action = self._of_actions("action", action)
        check_executed(action)
        if sigma_human is None:
            if self.oracle.active:
                raise UserError("this oracle learns actively: give sigma_human, from learner.uncertainty")
            sigma_human = jnp.zeros_like(action)
        coins = jax.random.uniform(key, action.shape)
        return self.oracle.advise(
            coins, action, self.target(obs), self._of_actions("sigma_human", sigma_human)
        )

    def _of_actions(self, name: str, value: Vector) -> Float[Array, " action"]:
        return jnp.asarray(vector(name, value, self.action_size, "this oracle"))
