"""The same teaching for tasks that are simulated on the host: one compiled tick, then a step of every simulation.

A tick takes in what the last step of each lane brought, ends the episodes that are over, and chooses the next actions,
with the advice and the corrections that this meets. A simulation goes with its lane from block to block.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gpcjax.engine import streams
from gpcjax.engine.asking import Expert, ask, block_coins, may_advise
from gpcjax.engine.correcting import correct, idle_is_due
from gpcjax.engine.episodes import end_episodes
from gpcjax.engine.history import Credit
from gpcjax.engine.lanes import Lane, Phase, Start, fresh
from gpcjax.engine.stepping import count_clipped, moment_of, propose, remember, watch
from gpcjax.envs.base import State, begin
from gpcjax.envs.host import HostEnv
from gpcjax.learners.base import Learner, Status
from gpcjax.teachers.base import Teacher

_FLAGS = np.bool_(False), np.bool_(True)


class News:
    """What the last step of each lane brought: views of one array, which crosses to the compiled tick as a whole.

    | Field        | Shape        | Meaning                                                      |
    |--------------|--------------|--------------------------------------------------------------|
    | `obs`        | (obs, lanes) | after the step                                               |
    | `start`      | (obs, lanes) | first observation of the next episode, where this one ended  |
    | `reward`     | (lanes,)     | of the step                                                  |
    | `terminated`, `truncated` | (lanes,) | 0 or 1                                              |
    | `stepped`    | (lanes,)     | 0 where there was no step, and nothing else counts           |
    """

    def __init__(self, array: Any, obs_size: int):
        self.array = array
        self.obs, self.start = array[:obs_size], array[obs_size : 2 * obs_size]
        self.reward, self.terminated, self.truncated, self.stepped = (
            array[2 * obs_size + row] for row in range(4)
        )

    @classmethod
    def none(cls, obs_size: int, lanes: int) -> "News":
        """No lane has stepped."""
        return cls(np.zeros((2 * obs_size + 4, lanes)), obs_size)


class Run:
    """The simulation of one lane, which is one episode ahead of it where an episode has just ended."""

    def __init__(self, env: HostEnv, seed: int, episodes: int):
        self._simulation, self._episode = env.simulate(), 0
        self._seeds = streams.reset_seeds(seed, episodes)
        self.obs = self._simulation.reset(self._seeds[0])

    def step(self, place: int, action: Float[np.ndarray, " action"], news: News) -> None:
        """One step with an action between the bounds of the task, written into the news of the lane at `place`.

        If the episode is over, a new one begins.
        """
        outcome = self._simulation.step(action)
        news.obs[:, place], news.reward[place] = outcome.obs, outcome.reward
        news.terminated[place], news.truncated[place] = outcome.terminated, outcome.truncated
        if outcome.terminated or outcome.truncated:
            self._episode += 1
            if self._episode < len(self._seeds):
                news.start[:, place] = self._simulation.reset(self._seeds[self._episode])


class HostLoop(eqx.Module):
    """What all lanes of a block share: see `gpcjax.engine.rollout.Loop`."""

    env: HostEnv = eqx.field(static=True)
    expert: Expert
    episodes: int = eqx.field(static=True)
    grows: bool = eqx.field(static=True, default=True)

    def enter(self, start: Start) -> tuple[Run, tuple[Any, ...]]:
        """The simulation of a run that begins, and what `begin` takes."""
        run = Run(self.env, start.seed, self.episodes)
        return run, (start.learner, start.teacher, np.int64(start.seed), start.credit, run.obs)

    def begin(self, learner: Learner, teacher: Teacher, seed: Any, credit: Credit | None, obs: Any) -> Lane:
        """A lane at its first episode."""
        return fresh(begin((), obs), learner, teacher, seed, self.episodes, credit)

    def drive(
        self, call: Callable[..., tuple[Any, ...]], runs: Mapping[int, Run], lanes: int, rounds: int
    ) -> None:
        """Up to `rounds` ticks and steps, fewer if no lane is running any more; the last step is always taken in."""
        news = News.none(self.env.obs_size, lanes)
        for last in [*[False] * rounds, True]:
            (choice,) = call("tick", lambda *arguments: self.tick(*arguments), news.array, _FLAGS[last])
            chosen = np.asarray(choice)
            news.stepped[:] = chosen[-1]
            places = np.flatnonzero(news.stepped).tolist()
            if not places:
                return
            actions = self.env.scaled(chosen[:-1])
            for place in places:
                runs[place].step(place, actions[:, place], news)

    def tick(
        self, block: Lane, news: Float[Array, "rows lanes"], last: Bool[Array, ""]
    ) -> tuple[Lane, Float[Array, "choice lanes"]]:
        """Takes in the news and chooses: the actions, and as a last row 1 for the lanes that go on with them.

        The `last` tick before the host looks at the lanes takes in the news alone.
        """
        told = News(news, self.env.obs_size)
        block = self._take_in(block, told)
        block = end_episodes(
            block, self.episodes, lambda block, _: jax.vmap(_begin, in_axes=-1, out_axes=-1)(told.start)
        )
        running = (block.phase == Phase.RUNNING) & ~last
        proposed, finite = propose(block.controller, block.env.obs, block.tally.returns)
        broken = running & ~finite
        running = running & ~broken
        may = may_advise(block.teacher, block.learner, block.episode, block.env.time, block_coins(block))
        if block.learner.idle_every:
            may |= idle_is_due(block.learner, block.env.time)
        block = dataclasses.replace(
            block,
            waiting=running & may,
            action=jnp.clip(proposed, -1.0, 1.0),
            status=jnp.where(broken, jnp.int32(Status.NON_FINITE), block.status),
        )
        moment, before = moment_of(block), block.memory
        block = dataclasses.replace(block, memory=watch(block, before, moment, running))
        block, advice = ask(block, self.expert, self.grows)
        block = correct(block, advice)
        stuck = block.phase == Phase.NEEDS_ROOM
        going = running & ~stuck
        block = dataclasses.replace(
            block,
            tally=count_clipped(block.tally, proposed, going),
            waiting=block.waiting & ~going,
            # A lane that is stuck comes back to this step, and its teacher sees it then.
            memory=jax.tree.map(lambda new, old: jnp.where(stuck, old, new), block.memory, before),
            history=remember(block.history, moment, going),
        )
        return block, jnp.concatenate([block.action, going[None].astype(block.action.dtype)])

    def _take_in(self, block: Lane, news: News) -> Lane:
        stepped = news.stepped != 0

        def newer(value: Array, old: Array) -> Array:
            return jnp.where(stepped, value.astype(old.dtype), old)

        env = eqx.tree_at(
            lambda env: (env.obs, env.reward, env.terminated, env.truncated, env.time),
            block.env,
            (
                newer(news.obs, block.env.obs),
                newer(news.reward, block.env.reward),
                newer(news.terminated, block.env.terminated),
                newer(news.truncated, block.env.truncated),
                block.env.time + stepped,
            ),
        )
        returns = block.tally.returns + jnp.where(stepped, news.reward, 0.0)
        return dataclasses.replace(block, env=env, tally=dataclasses.replace(block.tally, returns=returns))


def _begin(obs: Float[Array, " obs"]) -> State:
    return begin((), obs)
