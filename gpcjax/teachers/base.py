"""What a teacher is: someone who may say "more" or "less" to the action that was just taken."""

import abc

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

import gpcjax._x64  # noqa: F401


class Teacher(eqx.Module):
    """Gives advice on one step of one lane. Leaves and arguments may carry lanes as LAST axes.

    A teacher is given one uniform number, a coin, for each step and action dimension, and everything random that it
    does follows from it: with coins that depend on nothing but (seed, episode, step, dimension) the comparisons
    between learners are paired, and steps at which the coin forbids advice need no further work.
    """

    active: eqx.AbstractVar[bool]
    """Whether the advice depends on the learner's uncertainty. Static."""

    @abc.abstractmethod
    def during(self, episode: Int[Array, "*lanes"]) -> "Teacher":
        """The teacher as it is in one episode (an index from 0); the methods below are asked of that one."""

    @abc.abstractmethod
    def chance(self, sigma_human: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Gamma, the chance of advice where sigma_h is this. It may have an axis before those of the lanes."""

    @abc.abstractmethod
    def may_advise(
        self, coins: Float[Array, "action *lanes"], largest_sigma: Float[Array, "*lanes"]
    ) -> Bool[Array, "action *lanes"]:
        """Whether advice is possible at all with these coins, if sigma_h is at most `largest_sigma`."""

    @abc.abstractmethod
    def advise(
        self,
        coins: Float[Array, "action *lanes"],
        action: Float[Array, "action *lanes"],
        target: Float[Array, "action *lanes"],
        sigma_human: Float[Array, "action *lanes"],
    ) -> Float[Array, "action *lanes"]:
        """h: -1, 0 or 1 for each action dimension.

        `action` is what was executed, `target` what the teacher would have done; `sigma_human` is the learner's
        uncertainty, read only by a teacher that is `active`.
        """
