"""A step of every lane, wherever its task is simulated: what the policy proposes, what is seen of it and kept."""

import dataclasses
import functools
import operator
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from gpcjax.engine import streams
from gpcjax.engine.history import History
from gpcjax.engine.lanes import Lane, Tally
from gpcjax.gp.batching import together
from gpcjax.moment import Moment
from gpcjax.policies.base import Controller
from gpcjax.teachers.base import Teacher


def acting(block: Lane, lanes: Bool[Array, " lanes"]) -> Callable[[Array], Array]:
    """The controllers of the block, for these lanes of it. An accelerator has no time to decide what to leave out."""
    controller = block.controller
    return controller.in_use(lanes) if isinstance(controller, Controller) and not together() else controller


def propose(
    controller: Callable[[Array], Array], obs: Float[Array, "obs lanes"], returns: Float[Array, " lanes"]
) -> tuple[Float[Array, "action lanes"], Bool[Array, " lanes"]]:
    """The actions at these observations before they are clipped, and whether all is a number in each lane."""
    proposed = controller(obs)
    return proposed, all_finite(obs, proposed, returns[None])


def moment_of(block: Lane) -> Moment:
    """The present step of every lane, with the action that it has chosen."""
    return seen(block, block.env.obs, block.action, block.env.time)


def seen(
    block: Lane,
    obs: Float[Array, "obs lanes"],
    action: Float[Array, "action lanes"],
    time: Array,
) -> Moment:
    """A step of every lane as its teacher sees it, in the episodes of the block."""
    drawn = None
    if block.teacher.draws:
        drawn = jax.vmap(streams.draws, out_axes=-1)(block.seed, block.episode, time)
    return Moment(obs=obs, action=action, episode=block.episode, step=time, draws=drawn)


def of_teachers(
    block: Lane, function: Callable[..., PyTree], *arguments: PyTree, recalls: bool = True
) -> PyTree:
    """`function(teacher, *arguments)` for the teacher of every lane as it is in its episode, with what it remembers.

    The built-in ones have all lanes at once; of another one nobody knows whether it does not mix them: it sees one.
    """

    def asked(teacher: Teacher, episode: Array, memory: PyTree, *arguments: PyTree) -> PyTree:
        teacher = teacher.during(episode)
        return function(teacher.recalling(memory) if recalls else teacher, *arguments)

    if not block.teacher.is_ours:
        asked = jax.vmap(asked, in_axes=-1, out_axes=-1)
    return asked(block.teacher, block.episode, block.memory, *arguments)


def watch(block: Lane, memory: PyTree, moment: Moment, mask: Bool[Array, " lanes"]) -> PyTree:
    """The memories of the teachers of the lanes `mask` that take a step; nothing is done where none watches."""
    if not block.teacher.watches:
        return memory

    def watched(teacher: Teacher, memory: PyTree, moment: Moment) -> PyTree:
        return teacher.watch(memory, moment)

    after = of_teachers(block, watched, memory, moment, recalls=False)
    return jax.tree.map(lambda new, old: jnp.where(mask, new, old), after, memory)


def remember(history: History | None, moment: Moment, mask: Bool[Array, " lanes"]) -> History | None:
    """The steps that are kept, with one more for the lanes `mask` it is executed."""
    return None if history is None else history.with_step(moment, mask)


def all_finite(*values: Float[Array, "_ lanes"]) -> Bool[Array, " lanes"]:
    """Whether a lane has only numbers in all of them."""
    # Term by term, and zero times a number: so it joins the loop over lanes that reads them anyway.
    rows = [value[i] for value in values for i in range(value.shape[0])]
    return functools.reduce(operator.add, (0.0 * row for row in rows)) == 0.0


def count_clipped(tally: Tally, proposed: Float[Array, "action lanes"], mask: Bool[Array, " lanes"]) -> Tally:
    """One more step for the lanes `mask` whose action is beyond [-1, 1]."""
    beyond = (jnp.abs(proposed) > 1.0).any(0) & mask
    return dataclasses.replace(tally, clipped=tally.clipped + beyond)
