"""What advice does to the lanes that it is given to: Alg. 2's lines 6 to 14 (Alg. 1's 6 to 13)."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.engine import streams
from gpcjax.engine.credited import (
    Credited,
    count_corrections,
    exists,
    goes_on,
    log_correction,
    moments_of,
    of_dimension,
)
from gpcjax.engine.lanes import Lane, Phase
from gpcjax.engine.lanewise import each, opaque, put, take
from gpcjax.engine.together import correct_together, idle_together, joint_moment
from gpcjax.gp.batching import together
from gpcjax.learners.base import Learner, Status


def correct(block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
    """Corrects the lanes and action dimensions that were given advice, and lets those go on learning that are due.

    The advice is about the present step, or about the earlier ones that `Lane.credit` names; of these it is about none
    before the first step of the episode.
    """
    if block.learner.joint:
        block = correct_together(block, advice) if together() else _correct_jointly(block, advice)
        return _idle(block) if block.learner.idle_every else block
    if together():
        return correct_together(block, advice)
    size, moments = advice.shape[0], moments_of(block.credit)

    def body(index: Int[Array, ""], carry: PyTree) -> PyTree:
        states, controllers, tally, log, status = carry
        place = index // moments
        lane, dimension = place // size, place % size
        learner = take(block.learner, lane, 0)
        about = Credited(block, lane, index % moments)
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
            count_corrections(tally, lane, info, counted),
            log_correction(log, lane, info, (block.episode[lane], block.env.time[lane], dimension), counted),
            status.at[lane].max(jnp.where(goes_on(learner, info), jnp.int32(Status.OK), info.status)),
        )

    carry = (block.state, block.controller, block.tally, block.log, block.status)
    pending = (advice != 0).T.reshape(-1)
    if block.credit is not None:
        given = (advice != 0).T[:, :, None] & exists(block, block.credit)[:, None, :]
        pending = given.reshape(-1)
    state, controller, tally, log, status = each(pending, body, carry)
    return dataclasses.replace(block, state=state, controller=controller, tally=tally, log=log, status=status)


def _correct_jointly(block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
    """The same for learners that take all action dimensions at once."""
    moments = moments_of(block.credit)

    def body(index: Int[Array, ""], carry: PyTree) -> PyTree:
        states, controllers, tally, log, status = carry
        lane, which = index // moments, index % moments
        learner, given = take(block.learner, lane, 0), take(advice, lane, -1)
        about = Credited(block, lane, which)
        moment, key = joint_moment(about)
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
            one = of_dimension(info, dimension)
            advised = given[dimension] != 0
            counted = advised & (which == 0)
            tally = count_corrections(tally, lane, one, counted)
            place = (moment.episode, block.env.time[lane], jnp.int32(dimension))
            log = log_correction(log, lane, one, place, counted)
        return (
            put(states, lane, state, 0),
            put(controllers, lane, learner.controller(state), -1),
            tally,
            log,
            status.at[lane].max(jnp.where(goes_on(learner, info), jnp.int32(Status.OK), info.status)),
        )

    carry = (block.state, block.controller, block.tally, block.log, block.status)
    pending = (advice != 0).any(0)
    if block.credit is not None:
        pending = (pending[:, None] & exists(block, block.credit)).reshape(-1)
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
    if together():
        return idle_together(block, due)
    state, controller, status = each(due, body, (block.state, block.controller, block.status))
    return dataclasses.replace(block, state=state, controller=controller, status=status)
