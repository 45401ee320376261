"""The synthesised teacher: Alg. 4 of the thesis, with the active-learning chance of section 4.1.3.

Beside them what people do that an oracle does not: late advice, attention that comes and goes, a rate that dies.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gpcjax.allowed import shown
from gpcjax.elementary import decay
from gpcjax.errors import UserError
from gpcjax.lateness import DELAY, lateness
from gpcjax.moment import Moment
from gpcjax.policies.base import ByIdentity, Vector, check_executed, vector
from gpcjax.policies.vectors import is_traced
from gpcjax.teachers.base import Teacher


class Memory(eqx.Module):
    """What an oracle remembers that is not always at its best."""

    attending: Bool[Array, "*lanes"]
    steps: Int[Array, "*lanes"]
    """Seen so far, over all episodes."""


class Oracle(Teacher):
    """Advises towards a target action, at random times, sometimes in the wrong direction.

    With coin u and chance gamma: advice is given where u < gamma, and it is inverted where u < gamma * e. That is
    Alg. 4 with one draw in place of its two.

    What people are beside that is left out unless it is given: they are late, they do not always look, they tire, and
    they are wrong about a whole action and not about each of its dimensions.

    Fields:
        rate: gamma, or the least chance gamma_c of active learning.
        error: e, the probability that given advice has the wrong sign.
        delta: no advice where the action is within this of the target.
        active_gain: c_a of (3.6): the chance grows by c_a * sigma_h.
        active: whether the chance depends on sigma_h at all. Static.
        schedule: gamma of each episode in place of `rate`, the last one for all that follow; or None.
        lateness: (reach,), the chance that advice is about a step less than 1, 2, ..., `reach` steps back; or None.
        looks_away, looks_back: the chances that attention is lost at a step, and that it comes back; or None.
        fading: tau: the chance of advice falls as exp(-tau * steps seen); or None (D-COACH's dying rate).
        willing: what the chance is multiplied by at this moment; or None. `recalling` sets it.
        whole: a wrong advice has all its signs wrong; otherwise each dimension is wrong for itself. Static.
    """

    rate: Float[Array, "*lanes"]
    error: Float[Array, "*lanes"]
    delta: Float[Array, "*lanes"]
    active_gain: Float[Array, "*lanes"]
    active: bool = eqx.field(static=True)  # pyright: ignore[reportIncompatibleVariableOverride]
    schedule: Float[Array, "episodes *lanes"] | None = None
    lateness: Float[Array, "reach *lanes"] | None = None
    looks_away: Float[Array, "*lanes"] | None = None
    looks_back: Float[Array, "*lanes"] | None = None
    fading: Float[Array, "*lanes"] | None = None
    willing: Float[Array, "*lanes"] | None = None
    whole: bool = eqx.field(static=True, default=False)

    @property
    def reach(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return 0 if self.lateness is None else self.lateness.shape[0]

    @property
    def watches(self) -> bool:
        return self.looks_away is not None or self.fading is not None

    @property
    def draws(self) -> bool:
        return self.watches or self.reach > 0 or self.whole

    def init(self) -> Memory | tuple[()]:
        return Memory(jnp.ones((), bool), jnp.zeros((), jnp.int32)) if self.watches else ()

    def watch(self, memory: Memory, moment: Moment) -> Memory:
        attending = memory.attending
        if self.looks_away is not None:
            assert moment.draws is not None and self.looks_back is not None
            coin = moment.draws[0]
            attending = jnp.where(attending, coin >= self.looks_away, coin < self.looks_back)
        return Memory(attending=attending, steps=memory.steps + 1)

    def during(self, episode: Int[Array, "*lanes"]) -> "Oracle":
        if self.schedule is None:
            return self
        index = jnp.minimum(episode, self.schedule.shape[0] - 1)
        rate = jnp.take_along_axis(self.schedule, index[None], axis=0)[0]
        return dataclasses.replace(self, rate=rate, schedule=None)

    def recalling(self, memory: Memory | tuple[()]) -> "Oracle":
        if not isinstance(memory, Memory):
            return self
        willing = jnp.where(memory.attending, 1.0, 0.0)
        if self.fading is not None:
            willing = willing * decay(self.fading * (memory.steps - 1))
        return dataclasses.replace(self, willing=willing)

    def chance(self, sigma_human: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Gamma = c_a * sigma_h + gamma_c (section 4.1.3), at most 1."""
        rate, gain = (jnp.broadcast_to(value, sigma_human.shape) for value in (self.rate, self.active_gain))
        chance = jnp.minimum(gain * sigma_human + rate, 1.0) if self.active else rate
        return chance if self.willing is None else chance * jnp.broadcast_to(self.willing, chance.shape)

    def may_advise(
        self,
        coins: Float[Array, "action *lanes"],
        largest_sigma: Float[Array, "*lanes"],
        step: Int[Array, "*lanes"],
    ) -> Bool[Array, "action *lanes"]:
        return coins < self.chance(largest_sigma)[None]

    def about(self, moment: Moment) -> Int[Array, "*lanes"]:
        if self.lateness is None:
            return super().about(moment)
        assert moment.draws is not None
        return (moment.draws[1][None] >= self.lateness).sum(0, dtype=jnp.int32)

    def advise(self, coins: Float[Array, "action *lanes"], moment: Moment) -> Float[Array, "action *lanes"]:
        assert moment.target is not None and moment.sigma_human is not None
        gamma = self.chance(moment.sigma_human)
        gap = moment.target - moment.action
        sign = jnp.where(jnp.abs(gap) > self.delta[None], jnp.sign(gap), 0.0)
        if self.whole:
            assert moment.draws is not None
            inverted = jnp.broadcast_to(moment.draws[2] < self.error, coins.shape)
        else:
            inverted = coins < gamma * self.error[None]
        return jnp.where(coins < gamma, jnp.where(inverted, -sign, sign), 0.0)


def synthesised(
    rate: float,
    error: float,
    delta: float,
    active_gain: float = 0.0,
    schedule: Sequence[float] | None = None,
    delay: float | None = None,
    delay_longest: float | None = None,
    delay_shape: float | None = None,
    attention: float | None = None,
    distraction: float | None = None,
    fading: float | None = None,
    whole_error: int = 0,
    time_step: float = 1.0,
) -> Oracle:
    """The teacher of Alg. 4: `Oracle` with these numbers; a gain of 0 is no active learning.

    Args:
        rate, error, delta, active_gain, schedule, fading: see `Oracle`.
        delay, delay_longest, delay_shape: seconds between a step and the advice about it (`lateness`).
        attention, distraction: mean seconds that the teacher looks, and looks away, a step at least; the second is the
            first's if it is not given.
        whole_error: 1 for `Oracle.whole`.
        time_step: seconds of a step.

    Raises:
        UserError: numbers that do not fit together.
    """
    numbers = {"rate": rate, "error": error, "delta": delta, "active_gain": active_gain}
    if attention is None and distraction is not None:
        raise UserError("distraction: without attention it changes nothing, give both")
    late = lateness(DELAY, delay, delay_longest, delay_shape, time_step)
    spells = (attention, attention if distraction is None else distraction)
    # Spells are geometric: a chance of 1 / n at each step ends one after n steps in the mean.
    away, back = (None if spell is None else min(time_step / spell, 1.0) for spell in spells)
    values = {"schedule": schedule, "looks_away": away, "looks_back": back, "fading": fading, **numbers}
    arrays: dict[str, Any] = {
        name: None if value is None else jnp.asarray(value, float) for name, value in values.items()
    }
    return Oracle(
        **arrays,
        active=active_gain > 0,
        lateness=jnp.cumsum(jnp.asarray(late[:-1])) if len(late) > 1 else None,
        whole=bool(whole_error),
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
        self, key: Any, obs: Vector, action: Vector, sigma_human: Vector | None = None
    ) -> Float[Array, " action"]:
        """H (action_size,), each -1, 0 or 1, for an executed action, which is in [-1, 1]. Consumes `key`.

        Raises:
            ValueError: a shape does not fit, the action is beyond [-1, 1] (its value is not known where jax traces it:
                clip it there), what is given is no number, `key` is no random key, or active learning needs
                `sigma_human`, from `Learner.uncertainty`, of a learner that knows it: numbers of at least 0.
        """
        if not _is_key(key):
            raise UserError(f"key {shown(key)}: give a random key, from jax.random.key or jax.random.split")
        action = _finite("action", self._of_actions("action", action))
        obs = _finite("obs", jnp.asarray(vector("obs", obs, self.obs_size, "this oracle")))
        check_executed(action)
        if sigma_human is None:
            if self.oracle.active:
                raise UserError("this oracle learns actively: give sigma_human, from learner.uncertainty")
            sigma_human = jnp.zeros_like(action)
        sigma_human = self._of_actions("sigma_human", sigma_human)
        if self.oracle.active:
            _finite("sigma_human", sigma_human)
            if not is_traced(sigma_human) and (np.asarray(sigma_human) < 0.0).any():
                raise UserError(f"sigma_human {shown(sigma_human.tolist())}: give numbers of at least 0")
        coins = jax.random.uniform(key, action.shape)
        moment = Moment(
            obs=obs,
            action=action,
            episode=jnp.int32(0),
            step=jnp.int32(0),
            target=self.target(obs),
            sigma_human=sigma_human,
        )
        return self.oracle.advise(coins, moment)

    def _of_actions(self, name: str, value: Vector) -> Float[Array, " action"]:
        return jnp.asarray(vector(name, value, self.action_size, "this oracle"))


def _finite(name: str, value: Array) -> Array:
    """A vector, if all of it is finite, as far as that is known where jax traces it."""
    if not is_traced(value) and not np.isfinite(np.asarray(value)).all():
        raise UserError(f"{name} {shown(np.asarray(value).tolist())}: each entry must be finite")
    return value


def _is_key(key: Any) -> bool:
    """Whether it is one random key, of jax's own type or as an array of its words."""
    kind = getattr(key, "dtype", None)
    if kind is None or not jnp.issubdtype(kind, jax.dtypes.prng_key):
        words = jax.eval_shape(lambda: jax.random.PRNGKey(0)).shape
        return kind == np.uint32 and np.shape(key) == words
    return key.shape == ()
