"""What a teacher is: someone who may say "more" or "less" to an action that was taken, at once or later."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.moment import Moment

Memory = PyTree

_OF_A_LANE = ("watch", "during", "recalling", "chance", "about", "advise")
"""The methods that the built-in teachers have for all lanes at once."""


class Teacher(eqx.Module):
    """Gives advice on one step of one lane. Arguments of the built-in ones may carry lanes as LAST axes (`is_ours`).

    A teacher is given one uniform number, a coin, for each step and action dimension, and everything random that it
    does follows from it and from `Moment.draws`: as these depend on nothing but (seed, episode, step, dimension) the
    comparisons between learners are paired, and steps at which the coin forbids advice need no further work.

    A teacher of one's own writes `may_advise` and `advise`; all else has a default. One with a memory writes `init`,
    `watch` and `recalling`; one that speaks of earlier steps `reach` and `about`. Its fields that are numbers become
    settings of a sweep.
    """

    active: ClassVar[bool] = False
    """Whether the advice depends on the learner's uncertainty. Static."""

    reach: ClassVar[int] = 0
    """How many steps back its advice may be about, at most. Static; those steps are kept of every lane."""

    @property
    def watches(self) -> bool:
        """Whether it sees every step, which costs time at each of them. Static."""
        return type(self).watch is not Teacher.watch

    @property
    def draws(self) -> bool:
        """Whether it needs `Moment.draws`. Static."""
        return self.watches or self.reach > 0

    @property
    def is_ours(self) -> bool:
        """Whether all that it does is gpcjax's own. Static.

        Then its advice is known to be -1, 0 or 1, and it is asked for all lanes at once; another's is looked at, and
        sees one lane at a time.
        """
        return all(getattr(type(self), name).__module__.startswith("gpcjax.") for name in _OF_A_LANE)

    def init(self) -> Memory:
        """What it remembers before the first step of a run: a pytree of arrays, of one lane."""
        return ()

    def watch(self, memory: Memory, moment: Moment) -> Memory:
        """What it remembers once it has seen this step: called once at every step, before it is asked about it."""
        return memory

    def during(self, episode: Int[Array, "*lanes"]) -> "Teacher":
        """The teacher as it is in one episode (an index from 0); the methods below are asked of that one."""
        return self

    def recalling(self, memory: Memory) -> "Teacher":
        """The teacher as it is with this memory, which may only lower its chance of advice: `may_advise` knows none."""
        return self

    def chance(self, sigma_human: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Gamma, the chance of advice where sigma_h is this. It may have an axis before those of the lanes.

        NaN, the default, is unknown.
        """
        return jnp.full_like(sigma_human, jnp.nan)

    @abc.abstractmethod
    def may_advise(
        self,
        coins: Float[Array, "action *lanes"],
        largest_sigma: Float[Array, "*lanes"],
        step: Int[Array, "*lanes"],
    ) -> Bool[Array, "action *lanes"]:
        """Whether advice is possible at all at this step with these coins, if sigma_h is at most `largest_sigma`."""

    def about(self, moment: Moment) -> Int[Array, "*lanes"]:
        """How many steps back the step lies that the advice given at `moment` is about, at most `reach`.

        Before the first step of an episode there is nothing to advise on: then it is silent.
        """
        return jnp.zeros_like(moment.step)

    @abc.abstractmethod
    def advise(self, coins: Float[Array, "action *lanes"], moment: Moment) -> Float[Array, "action *lanes"]:
        """h: -1, 0 or 1 for each action dimension, about `moment`; with the coins of the step at which it is given."""
