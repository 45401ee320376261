"""A block of one lane without a task: for a session, the steps of the batched loops one by one."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gpcjax.engine.correcting import correct
from gpcjax.engine.history import Credit, History
from gpcjax.engine.lanes import CorrectionLog, Lane, Tally, empty_tally, fresh, map_lanes
from gpcjax.engine.stepping import propose, remember
from gpcjax.envs.base import State as EnvState
from gpcjax.envs.base import begin
from gpcjax.learners.base import Info, Learner, State
from gpcjax.moment import Moment
from gpcjax.policies.base import Controller
from gpcjax.teachers.base import Teacher

Plain = Array | np.ndarray
"""What a compiled function takes from the host: one of numpy's costs no call of its own to make."""

_KEPT = ("obs", "action")
"""The fields of `History`."""


class Elsewhere(Teacher):
    """A teacher who is not asked: advice comes when it comes."""

    def may_advise(self, coins, largest_sigma, step):
        return jnp.ones_like(coins, bool)

    def advise(self, coins, moment):
        return jnp.zeros_like(coins)


def single(learner: Learner, state: State | None, credit: Credit | None, seed: int) -> Lane:
    """The block before its first step, with this state of the learner or an untaught one.

    Raises:
        UserError: `state` is none of this learner's.
    """
    start = begin((), jnp.zeros(learner.obs_size))
    lane = fresh(start, learner, Elsewhere(), jnp.asarray(seed), 1, credit)
    block = map_lanes(lambda leaf, axis: jnp.expand_dims(leaf, axis), lane)
    if state is None:
        return block
    learner.policy_of(state)  # refuses it
    return with_state(block, learner, state)


def state_of(block: Lane) -> State:
    """The learner's state, without a lanes axis."""
    return _first(block.state)


@eqx.filter_jit
def _first(state: State) -> State:
    # One call: leaf by leaf from Python it took 20 to 50 ms of a full dictionary, beside which no step was made.
    return jax.tree.map(lambda leaf: leaf[0], state)


def with_state(block: Lane, learner: Learner, state: State) -> Lane:
    """The block with another state of its learner, which may have other room."""
    controller = jax.tree.map(lambda leaf: jnp.expand_dims(leaf, -1), learner.controller(state))
    # A number of Python's, and an array of numpy's, which its owner may write into, become jax's own.
    state = jax.tree.map(lambda leaf: jnp.array(leaf, copy=not isinstance(leaf, jax.Array))[None], state)
    return dataclasses.replace(block, state=state, controller=controller)


def grown(block: Lane) -> Lane | None:
    """The block with twice the room; None where that is the same, as it is for learners that know what to do."""
    state, controller = _grown(block)
    if jax.tree.map(jnp.shape, state) == jax.tree.map(jnp.shape, block.state):
        return None
    return dataclasses.replace(block, state=state, controller=controller)


@eqx.filter_jit
def _grown(block: Lane) -> tuple[State, Controller]:
    learner, state = _alone(block)
    larger = learner.grow(state)
    controller = jax.tree.map(lambda leaf: jnp.expand_dims(leaf, -1), learner.controller(larger))
    return jax.tree.map(lambda leaf: leaf[None], larger), controller


def place_of(block: Lane) -> dict[str, Any]:
    """The step that the block stands at, and those that are kept, as JSON knows them."""
    history = None
    if block.history is not None:
        history = {name: getattr(block.history, name)[..., 0].tolist() for name in _KEPT}
    return {
        "episode": int(block.episode[0]),
        "time": int(block.env.time[0]),
        "obs": block.env.obs[:, 0].tolist(),
        "action": block.action[:, 0].tolist(),
        "history": history,
    }


def placed(block: Lane, place: Mapping[str, Any]) -> Lane:
    """The block at a place that `place_of` gave for one of its kind.

    Raises:
        KeyError, TypeError, ValueError: for another one.
    """

    def like(values: Any, leaf: Array) -> Array:
        numbers = np.array(values, leaf.dtype)
        if numbers.shape != leaf.shape[:-1] or not np.isfinite(numbers).all():
            raise ValueError("another shape, or what is no number")
        return jnp.asarray(numbers[..., None])

    history, env = block.history, block.env
    if history is not None:
        kept = {name: like(place["history"][name], getattr(history, name)) for name in _KEPT}
        history = dataclasses.replace(history, **kept)
    env = _at(env, like(place["obs"], env.obs), like(place["time"], env.time))
    action, episode = like(place["action"], block.action), like(place["episode"], block.episode)
    return dataclasses.replace(block, env=env, history=history, action=action, episode=episode)


def stepped(
    block: Lane, obs: Float[np.ndarray, " obs"], begins: bool, another: bool
) -> tuple[Lane, Float[np.ndarray, " action"], bool]:
    """The block at its next step, what is proposed there before it is clipped, and whether that is a number.

    With `begins` it is the first step of an episode, of `another` one than before if there was one.
    """
    flags = np.array([begins, another])
    moving = block.env, block.action, block.episode, block.history
    env, action, episode, history, proposed, finite = _step(block.controller, moving, obs, flags)
    block = dataclasses.replace(block, env=env, action=action, episode=episode, history=history)
    return block, np.asarray(proposed)[:, 0], bool(np.asarray(finite)[0])


@eqx.filter_jit
def _step(
    controller: Controller,
    moving: tuple[EnvState, Float[Array, "action 1"], Int[Array, " 1"], History | None],
    obs: Float[Plain, " obs"],
    flags: Bool[Plain, " 2"],
) -> tuple[Any, ...]:
    # Without the learner's state, most of a block's leaves: each costs its share of a call.
    env, action, episode, history = moving
    begins, another = flags
    before = Moment(obs=env.obs, action=action, episode=episode, step=env.time)
    history = remember(history, before, ~begins[None])
    env = _at(env, jnp.asarray(obs)[:, None], jnp.where(begins, 0, env.time + 1).astype(jnp.int32))
    proposed, finite = propose(controller, env.obs, jnp.zeros(1))
    return env, jnp.clip(proposed, -1.0, 1.0), episode + another, history, proposed, finite


@eqx.filter_jit
def acts(controller: Controller, obs: Float[Plain, " obs"]) -> Float[Array, " action"]:
    """What a block's controller does at an observation, clipped."""
    return jnp.clip(controller(jnp.asarray(obs)[:, None])[:, 0], -1.0, 1.0)


@eqx.filter_jit
def acts_at(controller: Controller, obs: Float[Plain, "obs points"]) -> Float[Array, "action points"]:
    """The same at many observations."""
    return jax.vmap(acts, in_axes=(None, -1), out_axes=-1)(controller, obs)


@eqx.filter_jit
def has_room(block: Lane, corrections: int) -> Bool[Array, ""]:
    """Whether so many more corrections of each action dimension surely fit."""
    learner, state = _alone(block)
    return learner.has_room(state, corrections)


@eqx.filter_jit
def points_of(block: Lane) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Points held by the policies and by the human models, over all action dimensions."""
    learner, state = _alone(block)
    return learner.points(state)


@eqx.filter_jit
def uncertain(block: Lane) -> Float[Array, " action"]:
    """sigma_h at the present step and what was executed there; NaN of a learner that does not know it."""
    learner, state = _alone(block)
    return learner._uncertainty(state, (), block.env.obs[:, 0], block.action[:, 0])


@eqx.filter_jit
def measured(block: Lane) -> dict[str, Float[Array, ""]]:
    """What the learner measures of itself."""
    learner, state = _alone(block)
    return learner.measure(state)


def _alone(block: Lane) -> tuple[Learner, State]:
    return jax.tree.map(lambda leaf: leaf[0], (block.learner, block.state))


@eqx.filter_jit
def advised(block: Lane, advice: Float[Plain, "action 1"]) -> Lane:
    """The block corrected; idling has its own time."""
    return correct(dataclasses.replace(block, waiting=jnp.zeros(1, bool)), jnp.asarray(advice))


@eqx.filter_jit
def idled(block: Lane) -> Lane:
    """The block at the end of its step, whose learner goes on by itself if that is due."""
    return correct(dataclasses.replace(block, waiting=jnp.ones(1, bool)), jnp.zeros_like(block.action))


def told(block: Lane) -> Info:
    """What the corrections of a block have done that was `cleared` before them."""
    count, action_size = int(np.asarray(block.log.count)[0]), block.action.shape[0]
    logged = (np.asarray(getattr(block.log, name))[0, :count] for name in ("moments", "values", "outcome"))
    moments, values, outcome = logged
    numbers, flags = np.full((action_size, 3), np.nan), np.zeros((action_size, 3), bool)
    numbers[:, 0] = 0.0
    numbers[moments[:, 2]], flags[moments[:, 2]] = values, outcome
    return Info(*jax.device_put((*numbers.T, *flags.T, np.asarray(block.status)[0])))


def info_in(log: CorrectionLog, status: Int[Array, ""], action_size: int) -> Info:
    """The same of one lane's log, as part of a program."""
    logged = jnp.arange(action_size) < log.count
    place = jnp.where(logged, log.moments[:action_size, 2], action_size)  # behind the last one: dropped
    numbers = jnp.full((action_size, 3), jnp.nan).at[:, 0].set(0.0)
    numbers = numbers.at[place].set(log.values[:action_size], mode="drop")
    flags = jnp.zeros((action_size, 3), bool).at[place].set(log.outcome[:action_size], mode="drop")
    rate, sigma_policy, sigma_human = numbers.T
    appended, replaced, full = flags.T
    return Info(rate, sigma_policy, sigma_human, appended, replaced, full, status)


def cleared(block: Lane) -> Lane:
    """The block without what was counted."""
    tally, zero = _nothing()
    log = dataclasses.replace(block.log, count=zero)
    return dataclasses.replace(block, tally=tally, log=log, status=zero)


@functools.cache
def _nothing() -> tuple[Tally, Int[Array, " 1"]]:
    """Nothing counted in a block of one lane: made once, as an array is a call of its own to make."""
    return jax.tree.map(lambda leaf: leaf[None], empty_tally()), jnp.zeros(1, jnp.int32)


def _at(env: EnvState, obs: Float[Array, "obs 1"], time: Int[Array, " 1"]) -> EnvState:
    return eqx.tree_at(lambda env: (env.obs, env.time), env, (obs, time))
