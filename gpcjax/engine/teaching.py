"""What teaching does to the lanes that are due, wherever their tasks are simulated: ask, correct, end an episode.

Lanes are corrected one at a time, since in most rounds few or none are; whatever a lane computes depends on that lane
alone. A lane whose observation, action or return is no number goes no further: comparisons with NaN are false, so that
its episode might never end, and what it returned would look like any other. A lane whose dictionary has no room for the
correction that waits stops with `Phase.NEEDS_ROOM`, to be moved into a block of larger capacity (`gpcjax.engine.pool`).
"""

import dataclasses
import functools
import operator
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree

from gpcjax.engine import streams
from gpcjax.engine.lanes import LOGGED_CORRECTIONS, WINDOW, CorrectionLog, Lane, Phase, Tally
from gpcjax.envs.base import State as EnvState
from gpcjax.learners.base import Info, Learner, Moment, Status
from gpcjax.policies.base import Planner

Expert = Callable[[Float[Array, " obs"]], Float[Array, " action"]]


def ask(block: Lane, expert: Expert, grows: bool) -> tuple[Lane, Float[Array, "action lanes"]]:
    """The teacher's advice to the lanes that wait, zero for the others.

    With `grows`, a lane that has no room for it stops, and is asked again when it has.
    """
    coins = block_coins(block)
    target = _targets(block, expert)
    sigma = _uncertainty(block)
    teacher = block.teacher.during(block.episode)
    advice = teacher.advise(coins, block.action, target, sigma)
    advice = jnp.where(block.waiting[None], advice, 0.0)
    asked = block.waiting
    if grows:
        room = jax.vmap(lambda learner, state: learner.has_room(state))(block.learner, block.state)
        stuck = (advice != 0).any(0) & ~room
        phase = jnp.where(stuck, jnp.int32(Phase.NEEDS_ROOM), block.phase)
        block = dataclasses.replace(block, phase=phase)
        advice, asked = jnp.where(stuck[None], 0.0, advice), asked & ~stuck
    chance = teacher.chance(sigma).mean(0)
    tally = dataclasses.replace(
        block.tally,
        asked=block.tally.asked + asked,
        chance_sum=block.tally.chance_sum + jnp.where(asked, chance, 0.0),
    )
    return dataclasses.replace(block, tally=tally), advice


def block_coins(block: Lane) -> Float[Array, "action lanes"]:
    """The coins of every lane's present step."""
    size = block.action.shape[0]
    return jax.vmap(lambda seed, episode, step: streams.coins(seed, episode, step, size), out_axes=-1)(
        block.seed, block.episode, block.env.time
    )


def correct(block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
    """Alg. 2's lines 6 to 14 (Alg. 1's 6 to 13) for the lanes and action dimensions that were given advice."""
    if block.learner.joint:
        return _correct_jointly(block, advice)
    size = advice.shape[0]

    def body(index: Int[Array, ""], carry: PyTree) -> PyTree:
        states, controllers, tally, log, status = carry
        lane, dimension = index // size, index % size
        learner = _take(block.learner, lane, 0)
        change, info = _opaque(
            index,
            lambda learner, *arguments: learner._correct(*arguments),
            learner,
            states,
            (lane, dimension),
            _take(block.env.obs, lane, -1),
            block.action[dimension, lane],
            advice[dimension, lane],
        )
        states = block.learner._write(states, (lane, dimension), change)
        return (
            states,
            _put(controllers, lane, learner.controller(_take(states, lane, 0)), -1),
            _count_corrections(tally, lane, info),
            _log(log, lane, info, (block.episode[lane], block.env.time[lane], dimension)),
            status.at[lane].max(jnp.where(_goes_on(learner, info), jnp.int32(Status.OK), info.status)),
        )

    carry = (block.state, block.controller, block.tally, block.log, block.status)
    state, controller, tally, log, status = _each((advice != 0).T.reshape(-1), body, carry)
    return dataclasses.replace(block, state=state, controller=controller, tally=tally, log=log, status=status)


def _correct_jointly(block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
    """The same for learners that take all action dimensions at once."""

    def body(lane: Int[Array, ""], carry: PyTree) -> PyTree:
        states, controllers, tally, log, status = carry
        learner, given = _take(block.learner, lane, 0), _take(advice, lane, -1)
        moment = Moment(
            obs=_take(block.env.obs, lane, -1),
            action=_take(block.action, lane, -1),
            episode=block.episode[lane],
            step=block.env.time[lane],
        )
        key = streams.learner_key(block.seed[lane], moment.episode, moment.step)
        state, info = _opaque(
            lane,
            lambda learner, *others: learner._learn(*others),
            learner,
            _take(states, lane, 0),
            moment,
            given,
            key,
        )
        for dimension in range(given.shape[0]):
            each = _of_dimension(info, dimension)
            advised = given[dimension] != 0
            tally = _count_corrections(tally, lane, each, advised)
            log = _log(log, lane, each, (moment.episode, moment.step, jnp.int32(dimension)), advised)
        return (
            _put(states, lane, state, 0),
            _put(controllers, lane, learner.controller(state), -1),
            tally,
            log,
            status.at[lane].max(jnp.where(_goes_on(learner, info), jnp.int32(Status.OK), info.status)),
        )

    carry = (block.state, block.controller, block.tally, block.log, block.status)
    state, controller, tally, log, status = _each((advice != 0).any(0), body, carry)
    return dataclasses.replace(block, state=state, controller=controller, tally=tally, log=log, status=status)


def _of_dimension(info: Info, dimension: int) -> Info:
    """Of a correction of all action dimensions, what concerns one."""
    return jax.tree.map(lambda leaf: leaf[dimension] if leaf.ndim else leaf, info)


def all_finite(*values: Float[Array, "_ lanes"]) -> Bool[Array, " lanes"]:
    """Whether a lane has only numbers in all of them."""
    # Term by term, and zero times a number: so it joins the loop over lanes that reads them anyway.
    rows = [value[i] for value in values for i in range(value.shape[0])]
    return functools.reduce(operator.add, (0.0 * row for row in rows)) == 0.0


def end_episodes(block: Lane, episodes: int, start: Callable[[Lane, Int[Array, " lanes"]], EnvState]) -> Lane:
    """Writes the rows of the episodes that ended, and starts the next ones; a lane with a status ends its run.

    `start` gives the states in which lanes begin the episodes of these indices.
    """
    running = block.phase == Phase.RUNNING
    over, stopped = block.env.done & running, (block.status != Status.OK) & running
    # The condition guards small arrays only: a matrix that passes through it might be copied.
    names = ("env", "tally", "rows", "episode", "phase", "status", "window_start")
    values = lax.cond(
        (over | stopped).any(),
        lambda: _end(block, over, stopped, episodes, start),
        lambda: tuple(getattr(block, name) for name in names),
    )
    return dataclasses.replace(block, **dict(zip(names, values, strict=True)))


def count_clipped(
    tally: Tally, proposed: Float[Array, "action lanes"], where: Bool[Array, " lanes"]
) -> Tally:
    """One more step for the lanes `where` whose action is beyond [-1, 1]."""
    beyond = (jnp.abs(proposed) > 1.0).any(0) & where
    return dataclasses.replace(tally, clipped=tally.clipped + beyond)


def _end(
    block: Lane,
    over: Bool[Array, " lanes"],
    stopped: Bool[Array, " lanes"],
    episodes: int,
    start: Callable[[Lane, Int[Array, " lanes"]], EnvState],
) -> tuple:
    ended = over | stopped
    finite = all_finite(block.env.obs, block.tally.returns[None])
    broken = over & ~stopped & ~finite
    status = jnp.where(broken, jnp.int32(Status.NON_FINITE), block.status)
    points = jax.vmap(lambda learner, state: learner.points(state))(block.learner, block.state)
    own = jax.vmap(lambda learner, state: learner.measure(state))(block.learner, block.state)
    values = {
        **vars(block.tally),
        # What an episode returned until then is no return of an episode.
        "returns": jnp.where(status == Status.NON_FINITE, jnp.nan, block.tally.returns),
        "length": block.env.time,
        "policy_points": points[0],
        "human_points": points[1],
    }
    here = (jnp.arange(episodes)[:, None] == block.episode[None]) & ended[None]
    written = {
        name: jnp.where(here, value[None].astype(getattr(block.rows, name).dtype), getattr(block.rows, name))
        for name, value in values.items()
    }
    measured = {
        name: jnp.where(here, jnp.asarray(value, float)[None], block.rows.own[name])
        for name, value in own.items()
    }
    tally = jax.tree.map(lambda value: jnp.where(ended, jnp.zeros_like(value), value), block.tally)

    episode = jnp.where(stopped | broken, episodes, block.episode + over)
    finished = ended & (episode >= episodes)
    begins = over & ~finished
    env = jax.tree.map(lambda new, old: jnp.where(begins, new, old), start(block, episode), block.env)
    phase = jnp.where(finished, jnp.int32(Phase.FINISHED), block.phase)
    # A window of the last episode is void: the next round draws another.
    window_start = jnp.where(begins, -WINDOW, block.window_start)
    return (
        env,
        tally,
        dataclasses.replace(block.rows, **written, own=measured),
        episode,
        phase,
        status,
        window_start,
    )


def _targets(block: Lane, expert: Expert) -> Float[Array, "action lanes"]:
    """What the expert would do in each lane; a planner thinks about the lanes that wait only, zero for the others."""
    if not isinstance(expert, Planner):
        return jax.vmap(expert, in_axes=-1, out_axes=-1)(block.env.obs)

    def body(lane: Int[Array, ""], target: Float[Array, "action lanes"]) -> Float[Array, "action lanes"]:
        return _put(target, lane, expert(_take(block.env.obs, lane, -1)), -1)

    return _each(block.waiting, body, jnp.zeros_like(block.action))


def _uncertainty(block: Lane) -> Float[Array, "action lanes"]:
    """sigma_h where a teacher needs it: at the lanes that wait, if the learning is active."""
    sigma = jnp.zeros_like(block.action)
    if not block.teacher.active:
        return sigma

    def body(lane: Int[Array, ""], sigma: Float[Array, "action lanes"]) -> Float[Array, "action lanes"]:
        value = _opaque(
            lane,
            lambda learner, state, obs, action: learner._uncertainty(state, obs, action),
            _take(block.learner, lane, 0),
            _take(block.state, lane, 0),
            _take(block.env.obs, lane, -1),
            _take(block.action, lane, -1),
        )
        return _put(sigma, lane, value, -1)

    return _each(block.waiting, body, sigma)


def _each(
    pending: Bool[Array, " n"], body: Callable[[Int[Array, ""], PyTree], PyTree], carry: PyTree
) -> PyTree:
    """`body(index, carry)` for each that is pending. Most rounds have none or one."""

    def one(loop: tuple[Bool[Array, " n"], PyTree]) -> tuple[Bool[Array, " n"], PyTree]:
        pending, carry = loop
        index = pending.argmax().astype(jnp.int32)
        return pending.at[index].set(False), body(index, carry)

    return lax.while_loop(lambda loop: loop[0].any(), one, (pending, carry))[1]


def _opaque(index: Int[Array, ""], function: Callable[..., PyTree], *operands: PyTree) -> PyTree:
    """`function(*operands)` behind a condition that always holds, which XLA does not know.

    It has to finish the operands before, and the results before anything is made of them. Otherwise it fuses the
    reading of a lane into its update, can then no longer update the block in place, and copies all of it: ten times the
    time of a correction (`benchmarks/README.md`).
    """
    result = jax.eval_shape(function, *operands)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), result)
    return lax.cond(index >= 0, function, lambda *_: nothing, *operands)


def _take(tree: PyTree, index: Int[Array, ""], axis: int) -> PyTree:
    def take(leaf: Array) -> Array:
        return lax.dynamic_index_in_dim(leaf, index, axis % leaf.ndim, keepdims=False)

    return jax.tree.map(take, tree)


def _put(tree: PyTree, lane: Int[Array, ""], values: PyTree, axis: int) -> PyTree:
    def put(leaf: Array, value: Array) -> Array:
        return lax.dynamic_update_index_in_dim(leaf, value, lane, axis % leaf.ndim)

    return jax.tree.map(put, tree, values)


def _goes_on(learner: Learner, info: Info) -> Bool[Array, ""]:
    """Whether what a correction met does not end the run."""
    return (info.status == Status.FULL) & learner.goes_on_when_full


def _count_corrections(
    tally: Tally, lane: Int[Array, ""], info: Info, advised: Bool[Array, ""] | None = None
) -> Tally:
    """One more correction, if it was `advised`; without a value it was."""
    learned = info.status == Status.OK
    if advised is not None:
        learned &= advised
    added = {
        "corrections": learned,
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
    advised: Bool[Array, ""] | None = None,
) -> CorrectionLog:
    # A place behind the last one is dropped.
    position = log.count[lane]
    if advised is not None:
        position = jnp.where(advised, position, LOGGED_CORRECTIONS)
    values = jnp.stack([info.rate, info.sigma_policy, info.sigma_human])
    outcome = jnp.stack([info.appended, info.replaced, info.full])
    return CorrectionLog(
        count=log.count.at[lane].add((position < LOGGED_CORRECTIONS).astype(jnp.int32)),
        where=log.where.at[lane, position].set(jnp.stack(where), mode="drop"),
        values=log.values.at[lane, position].set(values, mode="drop"),
        outcome=log.outcome.at[lane, position].set(outcome, mode="drop"),
    )
