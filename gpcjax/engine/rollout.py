"""The batched loop: many lanes of one block, each on its own episode and step, in one compiled program.

Most steps of a lane need nothing but its controller and its task. So a round lets all lanes step until they meet a coin
that may bring advice (or the end of an episode, or of a few steps), then turns to those that wait: it asks the teacher,
takes out the few lanes that are really corrected, one at a time, updates their learners, and puts them back. Whatever
a lane computes depends on that lane alone; its neighbours decide only when.

A lane whose dictionary has no room for the correction that waits stops with `Phase.NEEDS_ROOM`, to be moved into a
block of larger capacity (`gpcjax.engine.pool`). On the largest capacity `grows` is false, and the learner's own
`on_full` decides.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from gpcjax.engine import streams
from gpcjax.engine.lanes import LOGGED_CORRECTIONS, WINDOW, CorrectionLog, Lane, Phase, Tally, coin_window
from gpcjax.envs.base import Env
from gpcjax.learners.base import Info, Learner, Status

Expert = Callable[[Float[Array, " obs"]], Float[Array, " action"]]


class Loop(eqx.Module):
    """What all lanes of a block share.

    Fields:
        env: the task.
        expert: what the teacher would do, obs (obs_size,) -> action (action_size,).
        episodes: of every lane. Static.
        grows: lanes without room leave the block. Static.
        stride: steps between two looks at the waiting lanes, less than `WINDOW`. Static.
    """

    env: Env
    expert: Expert
    episodes: int = eqx.field(static=True)
    grows: bool = eqx.field(static=True, default=True)
    stride: int = eqx.field(static=True, default=8)

    def advance(self, block: Lane, rounds: Int[Array, ""]) -> Lane:
        """Up to `rounds` rounds, fewer if no lane is running any more."""

        def more(carry: tuple[Int[Array, ""], Lane]) -> Bool[Array, ""]:
            done, block = carry
            return (done < rounds) & (block.phase == Phase.RUNNING).any()

        def body(carry: tuple[Int[Array, ""], Lane]) -> tuple[Int[Array, ""], Lane]:
            done, block = carry
            return done + 1, self.round(block)

        return lax.while_loop(more, body, (jnp.zeros((), jnp.int32), block))[1]

    def round(self, block: Lane) -> Lane:
        """Steps, advice, corrections, and new episodes, for every lane that is due."""
        block = self._draw_coins(block)
        block = self._step(block)
        block, advice = self._ask(block)
        block = self._correct(block, advice)
        block = self._execute(block)
        return self._begin_episodes(block)

    def _draw_coins(self, block: Lane) -> Lane:
        """Moves every window to its lane's present step, if any lane may otherwise run past its own."""
        due = (block.env.time + self.stride + 1 > block.window_start + WINDOW) & (
            block.phase == Phase.RUNNING
        )
        window, start = lax.cond(
            due.any(), lambda: self._windows(block), lambda: (block.window, block.window_start)
        )
        return dataclasses.replace(block, window=window, window_start=start)

    def _windows(self, block: Lane) -> tuple[UInt32[Array, " lanes"], Int[Array, " lanes"]]:
        window = jax.vmap(coin_window, in_axes=(-1, 0, -1, -1, -1))(
            block.teacher, block.learner, block.seed, block.episode, block.env.time
        )
        return window, block.env.time

    def _step(self, block: Lane) -> Lane:
        """A few steps of every running lane, up to its next coin or the end of its episode."""
        window, start, running = block.window, block.window_start, block.phase == Phase.RUNNING
        controller = block.controller

        def body(_: Int[Array, ""], carry: PyTree) -> PyTree:
            env, tally, waiting, action = carry
            moving = running & ~waiting & ~env.done
            proposed = controller(env.obs)
            offset = (env.time - start).astype(jnp.uint32)
            meets = moving & (((window >> offset) & 1) == 1)
            action = jnp.where(meets[None], jnp.clip(proposed, -1.0, 1.0), action)
            tally = self._count_clipped(tally, proposed, moving)
            env, tally = self._act(env, tally, proposed, moving & ~meets)
            return env, tally, waiting | meets, action

        carry = (block.env, block.tally, block.waiting, block.action)
        env, tally, waiting, action = lax.fori_loop(0, self.stride, body, carry)
        return dataclasses.replace(block, env=env, tally=tally, waiting=waiting, action=action)

    def _count_clipped(
        self, tally: Tally, proposed: Float[Array, "action lanes"], moving: Bool[Array, " lanes"]
    ):
        beyond = (jnp.abs(proposed) > 1.0).any(0) & moving
        return dataclasses.replace(tally, clipped=tally.clipped + beyond)

    def _act(
        self,
        env: PyTree,
        tally: Tally,
        action: Float[Array, "action lanes"],
        where: Bool[Array, " lanes"],
    ) -> tuple[PyTree, Tally]:
        """One step of the task, for the lanes `where`."""
        after = jax.vmap(self.env.step, in_axes=-1, out_axes=-1)(env, action)
        env = jax.tree.map(lambda new, old: jnp.where(where, new, old), after, env)
        return env, dataclasses.replace(tally, returns=tally.returns + jnp.where(where, after.reward, 0.0))

    def _ask(self, block: Lane) -> tuple[Lane, Float[Array, "action lanes"]]:
        """The teacher's advice to the lanes that wait, zero for the others."""
        coins = jax.vmap(
            lambda seed, episode, step: streams.coins(seed, episode, step, block.action.shape[0]),
            out_axes=-1,
        )(block.seed, block.episode, block.env.time)
        target = jax.vmap(self.expert, in_axes=-1, out_axes=-1)(block.env.obs)
        sigma = self._uncertainty(block)
        advice = block.teacher.advise(coins, block.action, target, sigma)
        advice = jnp.where(block.waiting[None], advice, 0.0)
        if self.grows:
            room = jax.vmap(lambda learner, state: learner.has_room(state))(block.learner, block.state)
            stuck = (advice != 0).any(0) & ~room
            block = dataclasses.replace(
                block, phase=jnp.where(stuck, jnp.int32(Phase.NEEDS_ROOM), block.phase)
            )
            advice = jnp.where(stuck[None], 0.0, advice)
        return block, advice

    def _uncertainty(self, block: Lane) -> Float[Array, "action lanes"]:
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

    def _correct(self, block: Lane, advice: Float[Array, "action lanes"]) -> Lane:
        """Alg. 2's lines 6 to 14 (Alg. 1's 6 to 13) for the lanes that were given advice."""

        def correct(learner: Learner, state: PyTree, obs: Array, action: Array, h: Array) -> PyTree:
            change, info = learner._correct(state, obs, action, h)
            return change, learner.controller(learner._write(state, (), change)), info

        def body(lane: Int[Array, ""], carry: PyTree) -> PyTree:
            states, controllers, tally, log, status = carry
            h = _take(advice, lane, -1)
            change, controller, info = _opaque(
                lane,
                correct,
                _take(block.learner, lane, 0),
                _take(states, lane, 0),
                _take(block.env.obs, lane, -1),
                _take(block.action, lane, -1),
                h,
            )
            return (
                block.learner._write(states, (lane,), change),
                _put(controllers, lane, controller, -1),
                _count_corrections(tally, lane, info, h != 0),
                _log(log, lane, info, h != 0, block.episode[lane], block.env.time[lane]),
                status.at[lane].set(info.status),
            )

        carry = (block.state, block.controller, block.tally, block.log, block.status)
        state, controller, tally, log, status = _each((advice != 0).any(0), body, carry)
        stopped = (status != Status.OK) & (block.phase == Phase.RUNNING)
        return dataclasses.replace(
            block,
            state=state,
            controller=controller,
            tally=tally,
            log=log,
            status=status,
            phase=jnp.where(stopped, jnp.int32(Phase.FINISHED), block.phase),
        )

    def _execute(self, block: Lane) -> Lane:
        """The step that the waiting lanes have chosen before they were corrected."""
        going = block.waiting & (block.phase != Phase.NEEDS_ROOM)
        env, tally = self._act(block.env, block.tally, block.action, going)
        return dataclasses.replace(block, env=env, tally=tally, waiting=block.waiting & ~going)

    def _begin_episodes(self, block: Lane) -> Lane:
        """Writes the rows of the episodes that ended, and starts the next ones; a learner that stopped ends its run."""
        over = block.env.done & (block.phase == Phase.RUNNING)
        stopped = (block.phase == Phase.FINISHED) & (block.episode < self.episodes)
        # The condition guards small arrays only: a matrix that passes through it might be copied.
        names = ("env", "tally", "rows", "episode", "phase", "status", "window_start")
        values = lax.cond(
            (over | stopped).any(),
            lambda: self._end_episodes(block, over, stopped),
            lambda: tuple(getattr(block, name) for name in names),
        )
        return dataclasses.replace(block, **dict(zip(names, values, strict=True)))

    def _end_episodes(
        self, block: Lane, over: Bool[Array, " lanes"], stopped: Bool[Array, " lanes"]
    ) -> tuple:
        ended = over | stopped
        points = jax.vmap(lambda learner, state: learner.points(state))(block.learner, block.state)
        values = {
            **vars(block.tally),
            "length": block.env.time,
            "policy_points": points[0],
            "human_points": points[1],
        }
        here = (jnp.arange(self.episodes)[:, None] == block.episode[None]) & ended[None]
        written = {
            name: jnp.where(
                here, value[None].astype(getattr(block.rows, name).dtype), getattr(block.rows, name)
            )
            for name, value in values.items()
        }
        tally = jax.tree.map(lambda value: jnp.where(ended, jnp.zeros_like(value), value), block.tally)

        finite = jnp.isfinite(block.tally.returns) & jnp.isfinite(block.env.obs).all(0)
        broken = over & ~finite
        status = jnp.where(broken, jnp.int32(Status.NON_FINITE), block.status)
        episode = jnp.where(stopped | broken, self.episodes, block.episode + over)
        finished = ended & (episode >= self.episodes)
        begins = over & ~finished
        start = jax.vmap(lambda seed, episode: self.env.reset(streams.start_key(seed, episode)), out_axes=-1)(
            block.seed, episode
        )
        env = jax.tree.map(lambda new, old: jnp.where(begins, new, old), start, block.env)
        phase = jnp.where(finished, jnp.int32(Phase.FINISHED), block.phase)
        # A window of the last episode is void: the next round draws another.
        window_start = jnp.where(begins, -WINDOW, block.window_start)
        return env, tally, dataclasses.replace(block.rows, **written), episode, phase, status, window_start


def _each(
    pending: Bool[Array, " lanes"], body: Callable[[Int[Array, ""], PyTree], PyTree], carry: PyTree
) -> PyTree:
    """`body(lane, carry)` for each pending lane. Most rounds have none or one."""

    def one(loop: tuple[Bool[Array, " lanes"], PyTree]) -> tuple[Bool[Array, " lanes"], PyTree]:
        pending, carry = loop
        lane = pending.argmax().astype(jnp.int32)
        return pending.at[lane].set(False), body(lane, carry)

    return lax.while_loop(lambda loop: loop[0].any(), one, (pending, carry))[1]


def _opaque(lane: Int[Array, ""], function: Callable[..., PyTree], *operands: PyTree) -> PyTree:
    """`function(*operands)` behind a condition that always holds, which XLA does not know.

    It has to finish the operands before, and the results before anything is made of them. Otherwise it fuses the
    reading of a lane into its update, can then no longer update the block in place, and copies all of it: ten times the
    time of a correction (`benchmarks/README.md`).
    """
    result = jax.eval_shape(function, *operands)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), result)
    return lax.cond(lane >= 0, function, lambda *_: nothing, *operands)


def _take(tree: PyTree, lane: Int[Array, ""], axis: int) -> PyTree:
    def take(leaf: Array) -> Array:
        return lax.dynamic_index_in_dim(leaf, lane, axis % leaf.ndim, keepdims=False)

    return jax.tree.map(take, tree)


def _put(tree: PyTree, lane: Int[Array, ""], values: PyTree, axis: int) -> PyTree:
    def put(leaf: Array, value: Array) -> Array:
        return lax.dynamic_update_index_in_dim(leaf, value, lane, axis % leaf.ndim)

    return jax.tree.map(put, tree, values)


def _count_corrections(
    tally: Tally, lane: Int[Array, ""], info: Info, given: Bool[Array, " action"]
) -> Tally:
    learned = given & ~(info.full & (info.status == Status.FULL))
    added = {
        "corrections": learned.sum(),
        "rate_sum": jnp.where(learned, info.rate, 0.0).sum(),
        "full": info.full.sum(),
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
    given: Bool[Array, " action"],
    episode: Int[Array, ""],
    step: Int[Array, ""],
) -> CorrectionLog:
    for dimension in range(given.shape[0]):
        # A place behind the last one is dropped.
        position = jnp.where(given[dimension], log.count[lane], LOGGED_CORRECTIONS)
        where = jnp.stack([episode, step, jnp.full_like(step, dimension)])
        values = jnp.stack([info.rate, info.sigma_policy, info.sigma_human])[:, dimension]
        outcome = jnp.stack([info.appended, info.replaced, info.full])[:, dimension]
        log = CorrectionLog(
            count=log.count.at[lane].add((position < LOGGED_CORRECTIONS).astype(jnp.int32)),
            where=log.where.at[lane, position].set(where, mode="drop"),
            values=log.values.at[lane, position].set(values, mode="drop"),
            outcome=log.outcome.at[lane, position].set(outcome, mode="drop"),
        )
    return log
