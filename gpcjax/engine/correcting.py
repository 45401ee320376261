"""What advice does to the lanes that it is given to: Alg. 2's lines 6 to 14 (Alg. 1's 6 to 13)."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.engine import streams
from gpcjax.engine.history import Credit
from gpcjax.engine.lanes import LOGGED_CORRECTIONS, CorrectionLog, Lane, Phase, Tally
from gpcjax.engine.lanewise import each, opaque, put, take
from gpcjax.learners.base import Info, Learner, Status
from gpcjax.moment import Moment


def correct(block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
    """Corrects the lanes and action dimensions that were given advice, and lets those go on learning that are due.

    The advice is about the present step, or about the earlier ones that `Lane.credit` names; of these it is about none
    before the first step of the episode.
    """
    if block.learner.joint:
        block = _correct_jointly(block, advice)
        return _idle(block) if block.learner.idle_every else block
    size, moments = advice.shape[0], _moments(block.credit)

    def body(index: Int[Array, ""], carry: PyTree) -> PyTree:
        states, controllers, tally, log, status = carry
        place = index // moments
        lane, dimension = place // size, place % size
        learner = take(block.learner, lane, 0)
        about = _Credited(block, lane, index % moments)
        change, info = opaque(
            index,
            lambda learner, *arguments: learner._correct(*arguments),
            learner,
            states,
            (lane, dimension),
            about.obs(),
            about.action(dimension),
            about.weight(advice[dimension, lane]),
        )
        states = block.learner._write(states, (lane, dimension), change)
        counted = index % moments == 0 if moments > 1 else None
        return (
            states,
            put(controllers, lane, learner.controller(take(states, lane, 0)), -1),
            _count_corrections(tally, lane, info, counted),
            _log(log, lane, info, (block.episode[lane], block.env.time[lane], dimension), counted),
            status.at[lane].max(jnp.where(_goes_on(learner, info), jnp.int32(Status.OK), info.status)),
        )

    carry = (block.state, block.controller, block.tally, block.log, block.status)
    pending = (advice != 0).T.reshape(-1)
    if block.credit is not None:
        given = (advice != 0).T[:, :, None] & _exists(block, block.credit)[:, None, :]
        pending = given.reshape(-1)
    state, controller, tally, log, status = each(pending, body, carry)
    return dataclasses.replace(block, state=state, controller=controller, tally=tally, log=log, status=status)


def _correct_jointly(block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
    """The same for learners that take all action dimensions at once."""
    moments = _moments(block.credit)

    def body(index: Int[Array, ""], carry: PyTree) -> PyTree:
        states, controllers, tally, log, status = carry
        lane, which = index // moments, index % moments
        learner, given = take(block.learner, lane, 0), take(advice, lane, -1)
        about = _Credited(block, lane, which)
        moment = Moment(
            obs=about.obs(), action=about.action(None), episode=block.episode[lane], step=about.step()
        )
        key = streams.learner_key(block.seed[lane], moment.episode, block.env.time[lane])
        if moments > 1:
            key = jax.random.fold_in(key, which)
        state, info = opaque(
            lane,
            lambda learner, *others: learner._learn(*others),
            learner,
            take(states, lane, 0),
            moment,
            about.weight(given),
            key,
        )
        for dimension in range(given.shape[0]):
            one = _of_dimension(info, dimension)
            advised = given[dimension] != 0
            counted = advised & (which == 0)
            tally = _count_corrections(tally, lane, one, counted)
            place = (moment.episode, block.env.time[lane], jnp.int32(dimension))
            log = _log(log, lane, one, place, counted)
        return (
            put(states, lane, state, 0),
            put(controllers, lane, learner.controller(state), -1),
            tally,
            log,
            status.at[lane].max(jnp.where(_goes_on(learner, info), jnp.int32(Status.OK), info.status)),
        )

    carry = (block.state, block.controller, block.tally, block.log, block.status)
    pending = (advice != 0).any(0)
    if block.credit is not None:
        pending = (pending[:, None] & _exists(block, block.credit)).reshape(-1)
    state, controller, tally, log, status = each(pending, body, carry)
    return dataclasses.replace(block, state=state, controller=controller, tally=tally, log=log, status=status)


def idle_is_due(learner: Learner, time: Int[Array, " lanes"]) -> Bool[Array, " lanes"]:
    """Whether the learner goes on by itself at this step of an episode (from 0)."""
    return (time + 1) % learner.idle_every == 0


def _idle(block: Lane) -> Lane:
    """Lets the waiting lanes that are due go on learning from what they have kept."""

    def body(lane: Int[Array, ""], carry: PyTree) -> PyTree:
        states, controllers, status = carry
        learner = take(block.learner, lane, 0)
        key = streams.learner_key(block.seed[lane], block.episode[lane], block.env.time[lane], use=1)
        state, outcome = opaque(
            lane, lambda learner, *others: learner._idle(*others), learner, take(states, lane, 0), key
        )
        return (
            put(states, lane, state, 0),
            put(controllers, lane, learner.controller(state), -1),
            status.at[lane].max(outcome),
        )

    # One that waits for room comes back to this step, with the correction that is to come first.
    due = block.waiting & (block.phase == Phase.RUNNING) & idle_is_due(block.learner, block.env.time)
    state, controller, status = each(due, body, (block.state, block.controller, block.status))
    return dataclasses.replace(block, state=state, controller=controller, status=status)


class _Credited(NamedTuple):
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


def _moments(credit: Credit | None) -> int:
    return 1 if credit is None else credit.moments


def _exists(block: Lane, credit: Credit) -> Bool[Array, "lanes moments"]:
    """Which of the moments that an advice is about lie in the episode, and have a part in it."""
    back = credit.first + jnp.arange(credit.moments)
    return (back[None] <= block.env.time[:, None]) & (credit.weights.T > 0)


def _of_dimension(info: Info, dimension: int) -> Info:
    """Of a correction of all action dimensions, what concerns one."""
    return jax.tree.map(lambda leaf: leaf[dimension] if leaf.ndim else leaf, info)


def _goes_on(learner: Learner, info: Info) -> Bool[Array, ""]:
    """Whether what a correction met does not end the run."""
    return (info.status == Status.FULL) & learner.goes_on_when_full


def _count_corrections(
    tally: Tally, lane: Int[Array, ""], info: Info, counted: Bool[Array, ""] | None = None
) -> Tally:
    """One more correction, if it was `counted`; without a value it is. Its rate counts in any case."""
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


def _log(
    log: CorrectionLog,
    lane: Int[Array, ""],
    info: Info,
    where: tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]],
    counted: Bool[Array, ""] | None = None,
) -> CorrectionLog:
    # A place behind the last one is dropped.
    position = log.count[lane]
    if counted is not None:
        position = jnp.where(counted, position, LOGGED_CORRECTIONS)
    values = jnp.stack([info.rate, info.sigma_policy, info.sigma_human])
    outcome = jnp.stack([info.appended, info.replaced, info.full])
    return CorrectionLog(
        count=log.count.at[lane].add((position < LOGGED_CORRECTIONS).astype(jnp.int32)),
        where=log.where.at[lane, position].set(jnp.stack(where), mode="drop"),
        values=log.values.at[lane, position].set(values, mode="drop"),
        outcome=log.outcome.at[lane, position].set(outcome, mode="drop"),
    )
