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
from gpcjax.engine.keeping import Keep
from gpcjax.engine.lanes import Lane, Phase, Start, fresh, room_for
from gpcjax.engine.snapshots import NotResumed
from gpcjax.engine.stepping import acting, count_clipped, moment_of, propose, remember, watch
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
    """The simulation of one lane, which is one episode ahead of it where an episode has just ended.

    Once the lane has taken in what the last step brought, as it has whenever the host looks, both are in the same one.
    """

    def __init__(self, env: HostEnv, seed: int, episodes: int, episode: int = 0):
        self._simulation, self._episode = env.simulate(), episode
        self._seeds = streams.reset_seeds(seed, episodes)
        self._executed = bytearray()
        """The actions of this episode so far: from them and its seed a simulation can be rebuilt."""
        self.obs = self._simulation.reset(self._seeds[episode])

    def executed(self, action_size: int) -> Float[np.ndarray, "steps action"]:
        """The actions of this episode so far, between the bounds of the task."""
        return np.frombuffer(bytes(self._executed)).reshape(-1, action_size)

    def replay(self, executed: Float[np.ndarray, "steps action"], lane: Lane) -> None:
        """Executes these actions in an episode that has just begun, up to where the lane is.

        Raises:
            NotResumed: what comes of it is not what the lane has seen: the episode ends before, or the last observation
                or the sum of the rewards are others.
        """
        obs, returns, over = self.obs, 0.0, False
        for action in executed:
            if over:
                break
            obs, reward, terminated, truncated = self._simulation.step(action)
            self._executed += action.tobytes()
            returns, over = returns + reward, terminated or truncated
        same = not over and len(executed) == lane.env.time
        seen = np.append(obs, returns), np.append(lane.env.obs, lane.tally.returns)
        if not (same and np.array_equal(*seen, equal_nan=True)):
            raise NotResumed(
                f"episode {self._episode + 1}, step {int(lane.env.time)}: the simulation does not come to the same "
                "observation when its actions are executed once more"
            )

    def step(self, place: int, action: Float[np.ndarray, " action"], news: News) -> None:
        """One step with an action between the bounds of the task, written into the news of the lane at `place`.

        If the episode is over, a new one begins.
        """
        outcome = self._simulation.step(action)
        self._executed += action.tobytes()
        news.obs[:, place], news.reward[place] = outcome.obs, outcome.reward
        news.terminated[place], news.truncated[place] = outcome.terminated, outcome.truncated
        if outcome.terminated or outcome.truncated:
            self._episode += 1
            self._executed.clear()
            if self._episode < len(self._seeds):
                news.start[:, place] = self._simulation.reset(self._seeds[self._episode])


class HostLoop(eqx.Module):
    """What all lanes of a block share: see `gpcjax.engine.rollout.Loop`."""

    env: HostEnv = eqx.field(static=True)
    expert: Expert
    episodes: int = eqx.field(static=True)
    grows: bool = eqx.field(static=True, default=True)
    keep: Keep | None = eqx.field(static=True, default=None)

    def enter(self, start: Start) -> tuple[Run, tuple[Any, ...]]:
        """The simulation of a run that begins, and what `begin` takes."""
        run = Run(self.env, start.seed, self.episodes)
        numbers = np.int64(start.seed), np.int32(self.episodes)
        return run, (start.learner, start.teacher, *numbers, start.credit, run.obs)

    def executed(self, simulation: Run) -> Float[np.ndarray, "steps action"]:
        """What rebuilds a simulation between two chunks, beside its lane: the actions of its present episode."""
        return simulation.executed(self.env.action_size)

    def rebuild(self, lane: Lane, executed: Float[np.ndarray, "steps action"]) -> Run:
        """The simulation of a lane on the host, by replay. Raises `NotResumed`."""
        run = Run(self.env, int(lane.seed), self.episodes, int(lane.episode))
        run.replay(executed, lane)
        return run

    @property
    def compiled_in(self) -> tuple[Any, ...]:
        """All that the programs of this loop depend on."""
        return self.env.obs_size, self.expert, room_for(self.episodes), self.grows, self.keep

    def begin(
        self, learner: Learner, teacher: Teacher, seed: Any, episodes: Any, credit: Credit | None, obs: Any
    ) -> Lane:
        """A lane at its first episode."""
        room = room_for(self.episodes)
        return fresh(begin((), obs), learner, teacher, seed, episodes, credit, room=room)

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
            block,
            lambda block, _: jax.vmap(_begin, in_axes=-1, out_axes=-1)(told.start),
            self.keep,
        )
        running = (block.phase == Phase.RUNNING) & ~last
        proposed, finite = propose(acting(block, running), block.env.obs, block.tally.returns)
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
