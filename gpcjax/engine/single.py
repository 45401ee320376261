"""A block of one lane without a task: for a session, the steps of the batched loops one by one."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gpcjax.engine.correcting import correct
from gpcjax.engine.history import Credit
from gpcjax.engine.lanes import Lane, empty_tally, fresh, map_lanes
from gpcjax.engine.stepping import moment_of, propose, remember
from gpcjax.envs.base import State as EnvState
from gpcjax.envs.base import begin
from gpcjax.learners.base import Info, Learner, State
from gpcjax.teachers.base import Teacher

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
    return jax.tree.map(lambda leaf: leaf[0], block.state)


def with_state(block: Lane, learner: Learner, state: State) -> Lane:
    """The block with another state of its learner, which may have other room."""
    controller = jax.tree.map(lambda leaf: jnp.expand_dims(leaf, -1), learner.controller(state))
    return dataclasses.replace(
        block, state=jax.tree.map(lambda leaf: leaf[None], state), controller=controller
    )


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


@eqx.filter_jit
def stepped(
    block: Lane, obs: Float[Array, " obs"], begins: Bool[Array, ""], another: Bool[Array, ""]
) -> tuple[Lane, Bool[Array, " 1"]]:
    """The block at its next step, and whether its action is a number.

    With `begins` it is the first step of an episode, of `another` one than before if there was one.
    """
    history = remember(block.history, moment_of(block), ~begins[None])
    time = jnp.where(begins, 0, block.env.time + 1).astype(jnp.int32)
    env = _at(block.env, obs[:, None], time)
    proposed, finite = propose(block.controller, env.obs, block.tally.returns)
    action = jnp.clip(proposed, -1.0, 1.0)
    episode = block.episode + another
    return dataclasses.replace(block, env=env, episode=episode, action=action, history=history), finite


@eqx.filter_jit
def advised(block: Lane, advice: Float[Array, "action 1"]) -> Lane:
    """The block corrected; idling has its own time."""
    return correct(dataclasses.replace(block, waiting=jnp.zeros(1, bool)), advice)


@eqx.filter_jit
def idled(block: Lane) -> Lane:
    """The block at the end of its step, whose learner goes on by itself if that is due."""
    return correct(dataclasses.replace(block, waiting=jnp.ones(1, bool)), jnp.zeros_like(block.action))


def told(block: Lane) -> Info:
    """What the corrections of a block have done that was `cleared` before them."""
    log = jax.tree.map(lambda leaf: np.asarray(leaf[0]), block.log)
    count, action_size = int(log.count), block.action.shape[0]
    dimensions = log.where[:count, 2]
    values, outcome = np.full((action_size, 3), np.nan), np.zeros((action_size, 3), bool)
    values[:, 0] = 0.0
    values[dimensions], outcome[dimensions] = log.values[:count], log.outcome[:count]
    rate, sigma_policy, sigma_human = jnp.asarray(values.T)
    appended, replaced, full = jnp.asarray(outcome.T)
    return Info(rate, sigma_policy, sigma_human, appended, replaced, full, block.status[0])


def cleared(block: Lane) -> Lane:
    """The block without what was counted."""
    tally = jax.tree.map(lambda leaf: leaf[None], empty_tally())
    log = dataclasses.replace(block.log, count=jnp.zeros(1, jnp.int32))
    return dataclasses.replace(block, tally=tally, log=log, status=jnp.zeros_like(block.status))


def _at(env: EnvState, obs: Float[Array, "obs 1"], time: Int[Array, " 1"]) -> EnvState:
    return eqx.tree_at(lambda env: (env.obs, env.time), env, (obs, time))
