"""The state of one lane: a learner, its teacher and its task, and the rows that they produce.

A block holds many lanes in the same structure. Which axis the lanes take is a matter of speed, fixed here for each
field: FIRST for what a correction touches as a whole (the learner's matrices), so that a lane is contiguous; LAST for
what every step touches (observations, the controller), so that arithmetic runs over lanes.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from gpcjax.engine import streams
from gpcjax.engine.history import Credit, History
from gpcjax.envs.base import State as EnvState
from gpcjax.learners.base import Learner
from gpcjax.policies.base import Controller
from gpcjax.teachers.base import Teacher

LOGGED_CORRECTIONS = 200
"""Corrections of a run that are recorded one by one, for the learning-rate figures."""


class Phase(enum.IntEnum):
    """What a lane may do next."""

    RUNNING = 0
    NEEDS_ROOM = 1
    """A correction waits for a larger dictionary."""
    FINISHED = 2
    """All episodes are done, or the learner stopped with a status."""
    EMPTY = 3
    """No cell."""
    PAUSED = 4
    """An episode has ended, the next one is about to begin, and the host copies what was learned (`Keep`)."""


ROWS = 32
"""Episodes that a run has room for in its rows, at least."""


def room_for(episodes: int) -> int:
    """The rows of runs of so many episodes: a power of two, so that runs of other lengths share programs."""
    return max(ROWS, 1 << (episodes - 1).bit_length())


class EpisodeRows(eqx.Module):
    """What was measured in each episode, [episodes]; while a run is in a block there may be room for more of them."""

    returns: Float[Array, "episodes *lanes"]
    length: Int[Array, "episodes *lanes"]
    corrections: Int[Array, "episodes *lanes"]
    rate_sum: Float[Array, "episodes *lanes"]
    policy_points: Int[Array, "episodes *lanes"]
    human_points: Int[Array, "episodes *lanes"]
    clipped: Int[Array, "episodes *lanes"]
    """Steps whose action was outside [-1, 1]."""
    full: Int[Array, "episodes *lanes"]
    """Corrections that met a full dictionary."""
    asked: Int[Array, "episodes *lanes"]
    """Steps at which the coins allowed advice, so that the teacher's chance was worked out."""
    chance_sum: Float[Array, "episodes *lanes"]
    """The chances of advice at those steps, each the mean over the action dimensions."""
    own: dict[str, Float[Array, "episodes *lanes"]]
    """What the learner measured at the episode's end (`Learner.measure`)."""


class Tally(eqx.Module):
    """The running sums of the current episode."""

    returns: Float[Array, "*lanes"]
    corrections: Int[Array, "*lanes"]
    rate_sum: Float[Array, "*lanes"]
    clipped: Int[Array, "*lanes"]
    full: Int[Array, "*lanes"]
    asked: Int[Array, "*lanes"]
    chance_sum: Float[Array, "*lanes"]


class CorrectionLog(eqx.Module):
    """The first `LOGGED_CORRECTIONS` corrections, one entry for each corrected action dimension."""

    count: Int[Array, "*lanes"]
    moments: Int[Array, "*lanes log 3"]
    """Episode (from 0), step (from 0), action dimension."""
    values: Float[Array, "*lanes log 3"]
    """Rate, sigma_policy, sigma_human."""
    outcome: Bool[Array, "*lanes log 3"]
    """Appended, replaced, full."""


class Lane(eqx.Module):
    """One lane, or a block of them; `AXES` tells where the lanes are."""

    learner: Learner
    state: PyTree
    controller: Controller
    teacher: Teacher
    env: EnvState
    seed: Int[Array, "*lanes"]
    episode: Int[Array, "*lanes"]
    """Index of the current episode, from 0."""
    episodes: Int[Array, "*lanes"]
    """How many this run has."""
    phase: Int[Array, "*lanes"]
    status: Int[Array, "*lanes"]
    window_start: Int[Array, "*lanes"]
    """First step that `window` tells of."""
    window: UInt32[Array, "*lanes"]
    """Bit i: the coins of step `window_start + i` may bring advice."""
    waiting: Bool[Array, "*lanes"]
    """The lane has reached such a step and rests until the block turns to advice."""
    action: Float[Array, "action *lanes"]
    """The action chosen where the lane waits."""
    tally: Tally
    rows: EpisodeRows
    log: CorrectionLog
    memory: PyTree
    """What the teacher remembers; nothing of one that does not watch."""
    history: History | None
    """The last steps of the episode, where advice may be about them."""
    credit: Credit | None
    """How the learner reckons with late advice; None if all advice is about the present step."""


@dataclass(frozen=True)
class Start:
    """A run to begin.

    Numbers of `learner`, `teacher` and `credit` may differ between the starts of one pool, their structure may not.
    """

    name: Any
    """The caller's own, handed back with the result."""
    learner: Learner
    teacher: Teacher
    seed: int
    credit: Credit | None = None
    state: PyTree | None = None
    """What the learner begins with, on the host, of the shapes of one of the pool's tiers; None for nothing learned."""


FIRST = ("learner", "state", "log")


LEARNED = ("state", "controller")
"""What of a lane a learner has learned."""


def map_by_field(function: Callable[[Any, str], Any], lane: Lane) -> Lane:
    """`function(leaf, field)` for each leaf, which may be any array, with the field of the lane that it is in."""
    return jax.tree_util.tree_map_with_path(lambda path, leaf: function(leaf, path[0].name), lane)


def map_lanes(function: Callable[..., Any], block: Lane, *others: Lane) -> Lane:
    """`function(leaf, *other leaves, axis)` for each leaf, with the axis that the lanes take in a block.

    A leaf may be an array of jax or numpy, or the shape of one.
    """

    def apply(path: Any, leaf: Any, *rest: Any) -> Any:
        return function(leaf, *rest, 0 if path[0].name in FIRST else -1)

    return jax.tree_util.tree_map_with_path(apply, block, *others)


WINDOW = 32
"""Steps whose coins are drawn at once: the bits of `Lane.window`."""


def coin_window(
    teacher: Teacher,
    learner: Learner,
    seed: Int[Array, ""],
    episode: Int[Array, ""],
    start: Int[Array, ""],
) -> UInt32[Array, ""]:
    """Which of the steps from `start` may bring advice, as bits."""
    teacher, largest = teacher.during(episode), learner.largest_sigma()

    def possible(step: Int[Array, ""]) -> Bool[Array, ""]:
        coins = streams.coins(seed, episode, step, learner.action_size)
        return teacher.may_advise(coins, largest, step).any()

    offsets = jnp.arange(WINDOW, dtype=jnp.uint32)
    bits = jax.vmap(possible)(start + offsets.astype(start.dtype))
    return jnp.where(bits, jnp.uint32(1) << offsets, jnp.uint32(0)).sum(dtype=jnp.uint32)


def fresh(
    env: EnvState,
    learner: Learner,
    teacher: Teacher,
    seed: Int[Array, ""],
    episodes: int | Int[Array, ""],
    credit: Credit | None = None,
    *,
    room: int | None = None,
) -> Lane:
    """A lane at the start `env` of its first episode, its learner idle.

    `room` is for how many rows there is place: the episodes if they are known when this is traced, more if they aren't.
    """
    depth = max(teacher.reach, 0 if credit is None else credit.reach)
    zero = jnp.zeros((), jnp.int32)
    state = learner.init(streams.first_key(seed))
    numbers = jnp.zeros(episodes if room is None else room)
    rows = numbers.astype(jnp.int32)
    return Lane(
        learner=learner,
        state=state,
        controller=learner.controller(state),
        teacher=teacher,
        env=env,
        seed=seed,
        episode=zero,
        episodes=jnp.asarray(episodes, jnp.int32),
        phase=jnp.asarray(Phase.RUNNING, jnp.int32),
        status=zero,
        window_start=jnp.asarray(-WINDOW, jnp.int32),  # void: the first round draws one
        window=jnp.zeros((), jnp.uint32),
        waiting=jnp.zeros((), bool),
        action=jnp.zeros(learner.action_size),
        tally=empty_tally(),
        rows=EpisodeRows(
            returns=numbers,
            length=rows,
            corrections=rows,
            rate_sum=numbers,
            policy_points=rows,
            human_points=rows,
            clipped=rows,
            full=rows,
            asked=rows,
            chance_sum=numbers,
            own=dict.fromkeys(jax.eval_shape(lambda: learner.measure(state)), numbers),
        ),
        log=CorrectionLog(
            count=zero,
            moments=jnp.zeros((LOGGED_CORRECTIONS, 3), jnp.int32),
            values=jnp.zeros((LOGGED_CORRECTIONS, 3)),
            outcome=jnp.zeros((LOGGED_CORRECTIONS, 3), bool),
        ),
        memory=memory_of(teacher),
        history=History.empty(depth, learner.obs_size, learner.action_size),
        credit=credit,
    )


def memory_of(teacher: Teacher) -> PyTree:
    """What a teacher remembers before the first step, as arrays; nothing of one that does not watch."""
    return jax.tree.map(jnp.asarray, teacher.init()) if teacher.watches else ()


def empty_tally() -> Tally:
    """Nothing has happened in this episode."""
    return Tally(
        returns=jnp.zeros(()),
        corrections=jnp.zeros((), jnp.int32),
        rate_sum=jnp.zeros(()),
        clipped=jnp.zeros((), jnp.int32),
        full=jnp.zeros((), jnp.int32),
        asked=jnp.zeros((), jnp.int32),
        chance_sum=jnp.zeros(()),
    )
