"""What a correction is about, one of few moments of a lane, and what is counted and logged of it."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gpcjax.engine.history import Credit
from gpcjax.engine.lanes import LOGGED_CORRECTIONS, CorrectionLog, Lane, Tally
from gpcjax.engine.lanewise import take
from gpcjax.learners.base import Info, Learner, Status


class Credited(NamedTuple):
    """One moment of one lane that an advice is about, and how much of it."""

    block: Lane
    lane: Int[Array, ""]
    which: Int[Array, ""]

    def obs(self) -> Float[Array, " obs"]:
        return self._of("obs", self.block.env.obs)

    def action(self, dimension: Int[Array, ""] | None) -> Float[Array, "*action"]:
        if self.block.credit is None and dimension is not None:
            return self.block.action[dimension, self.lane]
        action = self._of("action", self.block.action)
        return action if dimension is None else action[dimension]

    def step(self) -> Int[Array, ""]:
        return self.block.env.time[self.lane] - self._back()

    def weight(self, advice: Float[Array, "*action"]) -> Float[Array, "*action"]:
        credit = self.block.credit
        if credit is None or credit.moments == 1:
            return advice
        return advice * credit.weights[self.which, self.lane]

    def _back(self) -> Int[Array, ""]:
        credit = self.block.credit
        return jnp.int32(0) if credit is None else (credit.first + self.which).astype(jnp.int32)

    def _of(self, name: str, present: Float[Array, "_ lanes"]) -> Float[Array, " _"]:
        now = take(present, self.lane, -1)
        if self.block.credit is None or self.block.history is None:
            return now
        kept = take(getattr(self.block.history, name), self.lane, -1)
        back = self._back()
        past = kept[(self.block.env.time[self.lane] - back) % kept.shape[0]]
        return jnp.where(back == 0, now, past)


def moments_of(credit: Credit | None) -> int:
    """How many moments an advice is about."""
    return 1 if credit is None else credit.moments


def exists(block: Lane, credit: Credit) -> Bool[Array, "lanes moments"]:
    """Which of the moments that an advice is about lie in the episode, and have a part in it."""
    back = credit.first + jnp.arange(credit.moments)
    return (back[None] <= block.env.time[:, None]) & (credit.weights.T > 0)


def of_dimension(info: Info, dimension: int | Int[Array, ""]) -> Info:
    """Of a correction of all action dimensions, what concerns one."""
    return jax.tree.map(lambda leaf: leaf[dimension] if leaf.ndim else leaf, info)


def goes_on(learner: Learner, info: Info) -> Bool[Array, "*lanes"]:
    """Whether what a correction met does not end the run."""
    return (info.status == Status.FULL) & learner.goes_on_when_full


def count_corrections(
    tally: Tally, lane: Int[Array, "*lanes"], info: Info, counted: Bool[Array, "*lanes"] | None = None
) -> Tally:
    """One more correction of `lane`, if it was `counted`; without a value it is. Its rate counts in any case.

    Of one lane, or of all of them at once.
    """
    learned = info.status == Status.OK
    added = {
        "corrections": learned if counted is None else learned & counted,
        "rate_sum": jnp.where(learned, info.rate, 0.0),
        "full": info.full,
    }
    sums = {name: getattr(tally, name) for name in added}
    return dataclasses.replace(
        tally,
        **{name: value.at[lane].add(added[name].astype(value.dtype)) for name, value in sums.items()},
    )


def log_correction(
    log: CorrectionLog,
    lane: Int[Array, "*lanes"],
    info: Info,
    moment: tuple[Int[Array, "*lanes"], Int[Array, "*lanes"], Int[Array, "*lanes"]],
    counted: Bool[Array, "*lanes"] | None = None,
) -> CorrectionLog:
    """One more line for a correction of `lane`, if it was `counted`; `moment` is its episode, step and dimension.

    Of one lane, or of all of them at once: then each argument has the lanes as its first axis.
    """
    # A place behind the last one is dropped.
    position = log.count[lane]
    if counted is not None:
        position = jnp.where(counted, position, LOGGED_CORRECTIONS)
    values = jnp.stack([info.rate, info.sigma_policy, info.sigma_human], axis=-1)
    outcome = jnp.stack([info.appended, info.replaced, info.full], axis=-1)
    return CorrectionLog(
        count=log.count.at[lane].add((position < LOGGED_CORRECTIONS).astype(jnp.int32)),
        moments=log.moments.at[lane, position].set(jnp.stack(moment, axis=-1), mode="drop"),
        values=log.values.at[lane, position].set(values, mode="drop"),
        outcome=log.outcome.at[lane, position].set(outcome, mode="drop"),
    )
