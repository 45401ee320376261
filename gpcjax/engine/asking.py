"""The teacher's advice to the lanes that wait."""

import dataclasses
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from gpcjax.engine import streams
from gpcjax.engine.lanes import Lane, Phase
from gpcjax.engine.lanewise import each, opaque, put, take
from gpcjax.engine.stepping import moment_of, of_teachers
from gpcjax.gp.batching import together
from gpcjax.learners.base import Learner, Status
from gpcjax.moment import Moment
from gpcjax.policies.base import Planner
from gpcjax.teachers.base import Teacher

Expert = Callable[[Float[Array, " obs"]], Float[Array, " action"]]


def ask(block: Lane, expert: Expert, grows: bool) -> tuple[Lane, Float[Array, "action lanes"]]:
    """The teacher's advice to the lanes that wait, zero for the others.

    With `grows`, a lane that has no room for it stops with `Phase.NEEDS_ROOM`, to be moved into a block of larger
    capacity (`gpcjax.engine.pool`), and is asked again when it has.
    """
    coins, here, asked = _coins_once(block), moment_of(block), block.waiting
    teacher = block.teacher
    moment, allowed = here, asked
    if teacher.reach:
        back = jnp.clip(of_teachers(block, lambda teacher, here: teacher.about(here), here), 0, teacher.reach)
        allowed &= back <= here.step
        assert block.history is not None
        moment = block.history.before(here, jnp.minimum(back, here.step))
    if block.learner.idle_every:  # those that wait to go on learning by themselves are not asked
        asked &= may_advise(block.teacher, block.learner, block.episode, here.step, coins)
        allowed &= asked
    target = _targets(block, expert, moment)
    sigma = _uncertainty(block, moment)
    moment = dataclasses.replace(moment, target=target, sigma_human=sigma)
    advice = of_teachers(block, lambda teacher, *others: teacher.advise(*others), coins, moment)
    advice = jnp.where(allowed[None], advice, 0.0)
    if not teacher.is_ours:
        invalid = ~jnp.isin(advice, jnp.array([-1.0, 0.0, 1.0])).all(0)
        status = jnp.where(invalid, jnp.int32(Status.INVALID), block.status)
        block, advice = dataclasses.replace(block, status=status), jnp.where(invalid[None], 0.0, advice)
    if grows:
        corrections = 1 if block.credit is None else block.credit.moments
        room = jax.vmap(lambda learner, state: learner.has_room(state, corrections))(
            block.learner, block.state
        )
        stuck = (advice != 0).any(0) & ~room
        phase = jnp.where(stuck, jnp.int32(Phase.NEEDS_ROOM), block.phase)
        block = dataclasses.replace(block, phase=phase)
        advice, asked = jnp.where(stuck[None], 0.0, advice), asked & ~stuck
    chance = of_teachers(block, lambda teacher, sigma: teacher.chance(sigma), sigma).mean(0)
    tally = dataclasses.replace(
        block.tally,
        asked=block.tally.asked + asked,
        chance_sum=block.tally.chance_sum + jnp.where(asked, chance, 0.0),
    )
    return dataclasses.replace(block, tally=tally), advice


def block_coins(block: Lane) -> Float[Array, "action lanes"]:
    """The coins of every lane's present step."""
    drawn = functools.partial(streams.coins, action_size=block.action.shape[0])
    return jax.vmap(drawn, out_axes=-1)(block.seed, block.episode, block.env.time)


def _coins_once(block: Lane) -> Float[Array, "action lanes"]:
    """The same, where any lane waits: behind that condition XLA draws them once, and not anew for each use of them."""
    return lax.cond(block.waiting.any(), lambda: block_coins(block), lambda: jnp.ones_like(block.action))


def may_advise(
    teacher: Teacher,
    learner: Learner,
    episode: Int[Array, " lanes"],
    step: Int[Array, " lanes"],
    coins: Float[Array, "action lanes"],
) -> Bool[Array, " lanes"]:
    """Whether the coins allow advice on any action dimension of each lane."""

    def one(teacher: Teacher, learner: Learner, episode: Array, step: Array, coins: Array) -> Bool[Array, ""]:
        return teacher.during(episode).may_advise(coins, learner.largest_sigma(), step).any()

    return jax.vmap(one, in_axes=(-1, 0, -1, -1, -1))(teacher, learner, episode, step, coins)


def _targets(block: Lane, expert: Expert, moment: Moment) -> Float[Array, "action lanes"]:
    """What the expert would do in each lane; a planner thinks about the lanes that wait only, zero for the others."""
    if together() or not isinstance(expert, Planner):
        return jax.vmap(expert, in_axes=-1, out_axes=-1)(moment.obs)

    def body(lane: Int[Array, ""], target: Float[Array, "action lanes"]) -> Float[Array, "action lanes"]:
        return put(target, lane, expert(take(moment.obs, lane, -1)), -1)

    return each(block.waiting, body, jnp.zeros_like(block.action))


def _uncertainty(block: Lane, moment: Moment) -> Float[Array, "action lanes"]:
    """sigma_h where a teacher needs it: at the lanes that wait, if the learning is active."""
    sigma = jnp.zeros_like(block.action)
    if not block.teacher.active:
        return sigma
    if together():
        return jax.vmap(
            lambda learner, state, *others: learner._uncertainty(state, (), *others),
            in_axes=(0, 0, -1, -1),
            out_axes=-1,
        )(block.learner, block.state, moment.obs, moment.action)

    def body(lane: Int[Array, ""], sigma: Float[Array, "action lanes"]) -> Float[Array, "action lanes"]:
        value = opaque(
            lane,
            lambda learner, states, *others: learner._uncertainty(states, (lane,), *others),
            take(block.learner, lane, 0),
            block.state,
            take(moment.obs, lane, -1),
            take(moment.action, lane, -1),
        )
        return put(sigma, lane, value, -1)

    return each(block.waiting, body, sigma)
