"""The batched loop: many lanes of one block, each on its own episode and step, in one compiled program.

Most steps of a lane need nothing but its controller and its task. So a round lets all lanes step until they meet a coin
that may bring advice (or the end of an episode, or of a few steps), then turns to those that wait: it asks the teacher,
corrects the few lanes that are given advice, and lets them step too. Whatever a lane computes depends on that lane
alone; its neighbours decide only when.

On the largest capacity `grows` is false, and the learner's own `on_full` decides what a full dictionary does.
"""

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from gpcjax.engine import streams
from gpcjax.engine.asking import Expert, ask
from gpcjax.engine.correcting import correct, idle_is_due
from gpcjax.engine.episodes import end_episodes
from gpcjax.engine.history import Credit
from gpcjax.engine.keeping import Keep
from gpcjax.engine.lanes import WINDOW, Lane, Phase, Start, Tally, coin_window, fresh, room_for
from gpcjax.engine.stepping import acting, count_clipped, moment_of, propose, remember, seen, watch
from gpcjax.envs.base import Env, started, stepped
from gpcjax.learners.base import Learner, Status
from gpcjax.teachers.base import Teacher


class Loop(eqx.Module):
    """What all lanes of a block share.

    Fields:
        env: the task.
        expert: what the teacher would do, obs (obs_size,) -> action (action_size,).
        episodes: of every lane. Nothing that is compiled depends on it, but for their `room`.
        grows: lanes without room leave the block. Static.
        stride: steps between two looks at the waiting lanes, less than `WINDOW`. Static.
        keep: after which episodes lanes wait for the host; None is never. Static.
    """

    env: Env
    expert: Expert
    episodes: int = eqx.field(static=True)
    grows: bool = eqx.field(static=True, default=True)
    stride: int = eqx.field(static=True, default=8)
    keep: Keep | None = eqx.field(static=True, default=None)

    def enter(self, start: Start) -> tuple[None, tuple[Any, ...]]:
        """Nothing on the host, and what `begin` takes."""
        numbers = np.int64(start.seed), np.int32(self.episodes)
        return None, (start.learner, start.teacher, *numbers, start.credit)

    def executed(self, simulation: None) -> None:
        """Nothing: a lane of a compiled task is all there is of it."""

    def rebuild(self, lane: Lane, executed: None) -> None:
        """Nothing is on the host."""

    @property
    def compiled_in(self) -> tuple[Any, ...]:
        """All that the programs of this loop depend on."""
        return self.env, self.expert, room_for(self.episodes), self.grows, self.stride, self.keep

    def begin(
        self, learner: Learner, teacher: Teacher, seed: Any, episodes: Any, credit: Credit | None = None
    ) -> Lane:
        """A lane at its first episode."""
        start = started(self.env, streams.start_key(seed, 0))
        return fresh(start, learner, teacher, seed, episodes, credit, room=room_for(self.episodes))

    def drive(
        self, call: Callable[..., tuple[Any, ...]], runs: Mapping[int, None], lanes: int, rounds: int
    ) -> None:
        """Up to `rounds` rounds in one call."""
        call("advance", lambda block, rounds: (self.advance(block, rounds),), np.int32(rounds))

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
        block, advice = ask(block, self.expert, self.grows)
        block = correct(block, advice)
        block = self._execute(block)
        return end_episodes(block, self._begin, self.keep)

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
        """A few steps of every running lane, up to its next coin, the end of its episode, or what is no number.

        Lanes that met such a thing take their steps once more, and stop before it: all lanes walk again by the same
        code, and whatever it computes for the others is the same once more. In it nothing depends on whether the
        values of a step are numbers: a mask that did would be compiled into the physics, and round them differently.
        """

        def again(carry: tuple[Int[Array, ""], Int[Array, " lanes"], PyTree]) -> Bool[Array, ""]:
            walks, steps, _ = carry
            return (walks == 0) | ((walks == 1) & (steps < self.stride).any())

        def walk(carry: tuple[Int[Array, ""], Int[Array, " lanes"], PyTree]) -> tuple[Array, Array, PyTree]:
            walks, steps, _ = carry
            walked, sound = self._walk(block, steps)
            return walks + 1, sound, walked

        present = (block.env, block.tally, block.waiting, block.action, block.memory, block.history)
        all_of_them = jnp.full_like(block.episode, self.stride)
        _, steps, walked = lax.while_loop(again, walk, (jnp.int32(0), all_of_them, present))
        env, tally, waiting, action, memory, history = walked
        return dataclasses.replace(
            block,
            env=env,
            tally=tally,
            waiting=waiting,
            action=action,
            memory=memory,
            history=history,
            status=jnp.where(steps < self.stride, jnp.int32(Status.NON_FINITE), block.status),
        )

    def _walk(
        self, block: Lane, steps: Int[Array, " lanes"]
    ) -> tuple[tuple[PyTree, ...], Int[Array, " lanes"]]:
        """So many steps of each lane, a stride at most; and how many it takes before it meets what is no number."""
        window, start, running = block.window, block.window_start, block.phase == Phase.RUNNING
        controller = acting(block, running)

        def body(step: Int[Array, ""], carry: PyTree) -> PyTree:
            (env, tally, waiting, action, memory, history), sound = carry
            moving = running & ~waiting & ~env.done & (step < steps)
            proposed, finite = propose(controller, env.obs, tally.returns)
            sound = jnp.where(moving & ~finite, jnp.minimum(sound, step), sound)
            offset = (env.time - start).astype(jnp.uint32)
            meets = moving & (((window >> offset) & 1) == 1)
            if block.learner.idle_every:
                meets |= moving & idle_is_due(block.learner, env.time)
            chosen = jnp.clip(proposed, -1.0, 1.0)
            action = jnp.where(meets[None], chosen, action)
            tally = count_clipped(tally, proposed, moving)
            if block.teacher.watches or history is not None:
                moment = seen(block, env.obs, chosen, env.time)
                memory = watch(block, memory, moment, moving)
                history = remember(history, moment, moving & ~meets)
            env, tally = self._act(env, tally, proposed, moving & ~meets)
            return (env, tally, waiting | meets, action, memory, history), sound

        walked = (block.env, block.tally, block.waiting, block.action, block.memory, block.history)
        return lax.fori_loop(0, self.stride, body, (walked, steps))

    def _act(
        self,
        env: PyTree,
        tally: Tally,
        action: Float[Array, "action lanes"],
        mask: Bool[Array, " lanes"],
    ) -> tuple[PyTree, Tally]:
        """One step of the task, for the lanes `mask`."""
        after = jax.vmap(partial(stepped, self.env), in_axes=-1, out_axes=-1)(env, action)
        env = jax.tree.map(lambda new, old: jnp.where(mask, new, old), after, env)
        return env, dataclasses.replace(tally, returns=tally.returns + jnp.where(mask, after.reward, 0.0))

    def _execute(self, block: Lane) -> Lane:
        """The step that the waiting lanes have chosen before they were corrected."""
        going = block.waiting & (block.phase != Phase.NEEDS_ROOM)
        history = remember(block.history, moment_of(block), going)
        env, tally = self._act(block.env, block.tally, block.action, going)
        return dataclasses.replace(
            block, env=env, tally=tally, history=history, waiting=block.waiting & ~going
        )

    def _begin(self, block: Lane, episode: Int[Array, " lanes"]) -> PyTree:
        """The state in which each lane begins this episode."""

        def start(seed: Int[Array, ""], episode: Int[Array, ""]) -> PyTree:
            return started(self.env, streams.start_key(seed, episode))

        return jax.vmap(start, out_axes=-1)(block.seed, episode)
