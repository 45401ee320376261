"""Corrections of all lanes of a block at once, where that is how lanes are computed (`gpcjax.gp.batching`).

What `gpcjax.engine.correcting` does lane by lane: one turn for each action dimension and moment, in the same order, and
each lane keeps what its own advice comes to.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
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
from gpcjax.engine.lanes import Lane
from gpcjax.learners.base import Info, Learner, State, Status
from gpcjax.moment import Moment

One = Callable[[Learner, State, Credited, Int[Array, ""]], tuple[State, Info]]
"""What a lane's state becomes in a turn, of this action dimension."""


def correct_together(block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
    """Corrects the lanes and action dimensions that were given advice."""
    learner, moments = block.learner, moments_of(block.credit)
    given = advice != 0
    if learner.joint:
        given = given.any(0)[None]
    pending = jnp.repeat(given, moments, axis=0)
    if block.credit is not None:
        pending &= jnp.tile(exists(block, block.credit).T, (given.shape[0], 1))
    one = _jointly(advice) if learner.joint else _of_one_dimension(advice)
    places = jnp.arange(advice.shape[1], dtype=jnp.int32)

    def turn(index: Int[Array, ""], carry: PyTree) -> PyTree:
        states, tally, log, status = carry
        dimension, which = index // moments, index % moments
        due = pending[index]

        def lane(learner: Learner, state: State, place: Int[Array, ""]) -> tuple[State, Info]:
            return one(learner, state, Credited(block, place, which), dimension)

        after, info = jax.vmap(lane)(learner, states, places)
        states = _where_lanes(due, after, states)
        for number in range(advice.shape[0]) if learner.joint else (dimension,):
            done = jax.vmap(partial(of_dimension, dimension=number))(info)
            counted = due & (which == 0) & (advice[number] != 0)
            tally = count_corrections(tally, places, _only(done, due), counted)
            moment = block.episode, block.env.time, jnp.full_like(places, number)
            log = log_correction(log, places, done, moment, counted)
        ended = jnp.where(goes_on(learner, info), jnp.int32(Status.OK), info.status)
        return states, tally, log, jnp.where(due, jnp.maximum(status, ended), status)

    carry = block.state, block.tally, block.log, block.status
    state, tally, log, status = lax.fori_loop(0, pending.shape[0], turn, carry)
    controller = _controllers(block, state, pending.any(0))
    return dataclasses.replace(block, state=state, controller=controller, tally=tally, log=log, status=status)


def idle_together(block: Lane, due: Bool[Array, " lanes"]) -> Lane:
    """Lets the lanes that are due go on learning from what they have kept."""

    def key(*numbers: Int[Array, ""]) -> Array:
        return streams.learner_key(*numbers, use=1)

    def one(learner: Learner, state: State, key: Array) -> tuple[State, Array]:
        return learner._idle(state, key)

    keys = jax.vmap(key)(block.seed, block.episode, block.env.time)
    after, outcome = jax.vmap(one)(block.learner, block.state, keys)
    state = _where_lanes(due, after, block.state)
    status = jnp.where(due, jnp.maximum(block.status, outcome), block.status)
    controller = _controllers(block, state, due)
    return dataclasses.replace(block, state=state, controller=controller, status=status)


def _controllers(block: Lane, state: State, changed: Bool[Array, " lanes"]) -> PyTree:
    """The block's controllers, with those anew whose states have changed."""
    after = jax.vmap(lambda learner, state: learner.controller(state), out_axes=-1)(block.learner, state)
    return jax.tree.map(lambda new, old: jnp.where(changed, new, old), after, block.controller)


def _where_lanes(mask: Bool[Array, " lanes"], after: PyTree, before: PyTree) -> PyTree:
    """`after` for the lanes of the mask, of trees whose first axis are the lanes."""

    def one(new: Array, old: Array) -> Array:
        return jnp.where(mask.reshape(-1, *[1] * (old.ndim - 1)), new, old)

    return jax.tree.map(one, after, before)


def _of_one_dimension(advice: Float[Array, "action lanes"]) -> One:
    def one(learner: Learner, state: State, about: Credited, dimension: Int[Array, ""]) -> tuple[State, Info]:
        states, place = jax.tree.map(lambda leaf: leaf[None], state), (jnp.int32(0), dimension)
        weight = about.weight(advice[dimension, about.lane])
        change, info = learner._correct(states, place, about.obs(), about.action(dimension), weight)
        return jax.tree.map(lambda leaf: leaf[0], learner._write(states, place, change)), info

    return one


def _jointly(advice: Float[Array, "action lanes"]) -> One:
    def one(learner: Learner, state: State, about: Credited, dimension: Int[Array, ""]) -> tuple[State, Info]:
        moment, key = joint_moment(about)
        return learner._learn(state, moment, about.weight(advice[:, about.lane]), key)

    return one


def joint_moment(about: Credited) -> tuple[Moment, Array]:
    """What an advice about all action dimensions is about, and the key of what is drawn for it."""
    block, lane = about.block, about.lane
    episode = block.episode[lane]
    moment = Moment(obs=about.obs(), action=about.action(None), episode=episode, step=about.step())
    key = streams.learner_key(block.seed[lane], episode, block.env.time[lane])
    return moment, key if moments_of(block.credit) == 1 else jax.random.fold_in(key, about.which)


def _only(info: Info, due: Bool[Array, " lanes"]) -> Info:
    """Of a lane without advice nothing counts."""
    counts = info.full & due, jnp.where(due, info.rate, 0.0)
    return eqx.tree_at(lambda info: (info.full, info.rate), info, counts)
