"""Runs any number of lanes through blocks of fixed width, from the host.

A block is a compiled program for a number of lanes and a capacity. Between chunks of some tens of milliseconds the
host takes out lanes that have finished, gives their places to the next ones, and moves lanes whose dictionary is full
into the block of the next capacity. Widths and capacities are fixed, a lane's tier follows from its own counts, and
empty places are masked: so the bits of a lane do not depend on what else is run, nor on when the host looks.
"""

import dataclasses
import itertools
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax.engine.lanes import Lane, Phase, fresh, map_lanes
from gpcjax.engine.rollout import Expert, Loop
from gpcjax.envs.base import Env
from gpcjax.learners.base import Learner
from gpcjax.teachers.base import Teacher

CHUNK_SECONDS = 0.02
"""About how long the compiled program runs between two looks of the host."""

ENTER = 16
"""Lanes that are put into a block by one call, at most."""

MOST_ROUNDS = 4096
"""Rounds between two looks at most: a chunk that ends early, for want of lanes, tells nothing of their length."""


@dataclasses.dataclass(frozen=True)
class Tier:
    """One block: room for these points in each dictionary, and its width.

    The width is a power of two, and a full vector at least. Then all lanes go through the same instructions; otherwise
    some may be left to scalar ones, which round differently, and the bits of a run would depend on its place.
    """

    policy_capacity: int
    human_capacity: int
    lanes: int

    def __post_init__(self) -> None:
        if self.lanes < 8 or self.lanes & (self.lanes - 1):
            raise ValueError(f"a block of {self.lanes} lanes: give a power of two, 8 or more")


TIERS = (
    Tier(48, 64, 32),
    Tier(96, 128, 16),
    Tier(128, 256, 16),
    Tier(256, 512, 16),
    Tier(512, 1024, 8),
    Tier(1024, 1024, 8),
)
"""Human models only append and outgrow policies, which SPARS keeps small.

Measured on a CPU (`benchmarks/README.md`): few tiers, as each costs seconds to compile; narrow ones, as time is
proportional to the width from 32 lanes on, and those few that outgrow the others run alone in the end.
"""


def tiers(max_capacity: int) -> tuple[Tier, ...]:
    """The tiers up to `max_capacity` points, the last one exactly there."""
    largest, beyond = TIERS[-1].policy_capacity, list[Tier]()
    while largest < max_capacity:
        largest *= 2
        beyond.append(Tier(largest, largest, 8))
    chosen: list[Tier] = []
    for tier in (*TIERS, *beyond):
        policy, human = min(tier.policy_capacity, max_capacity), min(tier.human_capacity, max_capacity)
        if not chosen or (policy, human) != (chosen[-1].policy_capacity, chosen[-1].human_capacity):
            chosen.append(dataclasses.replace(tier, policy_capacity=policy, human_capacity=human))
    return tuple(chosen)


@dataclasses.dataclass(frozen=True)
class Start:
    """A run to begin.

    Numbers of `learner` and `teacher` may differ between the starts of one pool, their structure may not.
    """

    name: Any
    """The caller's own, handed back with the result."""
    learner: Learner
    teacher: Teacher
    seed: int


@dataclasses.dataclass(frozen=True)
class Finished:
    """A run that ended: its lane on the host, without a lanes axis (numpy)."""

    name: Any
    lane: Lane


@dataclasses.dataclass
class Counters:
    """What a pool has done so far."""

    env_steps: int = 0
    episodes: int = 0
    compile_seconds: float = 0.0
    compilations: int = 0
    chunks: int = 0
    promotions: int = 0


class Pool:
    """Blocks of all tiers for starts of one structure (env, learner, sizes, episodes).

    Args:
        env, expert: shared by all lanes.
        episodes: of every lane.
        template: a start whose structure all others share.
        tiers: capacities and widths, growing; the last one leaves a full dictionary to the learner's `on_full`.
    """

    def __init__(self, env: Env, expert: Expert, episodes: int, template: Start, tiers: Sequence[Tier]):
        self.counters = Counters()
        self._env, self._episodes = env, episodes
        self._blocks = [_Block(self, tier, expert, template, last=tier is tiers[-1]) for tier in tiers]

    def run(
        self,
        next_start: Callable[[], Start | None],
        deliver: Callable[[Finished], None],
        look: Callable[[], None] = lambda: None,
    ) -> None:
        """Runs starts until `next_start` has no more and all have been delivered; calls `look` after every chunk."""
        blocks, exhausted = self._blocks, False
        while True:
            index = self._choose(exhausted)
            if index is None:
                return
            block = blocks[index]
            if index == 0 and not exhausted:
                starts = list(itertools.islice(iter(next_start, None), block.free))
                exhausted = len(starts) < block.free
                block.begin(starts)
            else:
                block.promote([block.waiting.popleft() for _ in range(min(block.free, len(block.waiting)))])
            if not block.names:
                continue
            for name, lane in block.chunk():
                if lane.phase == Phase.NEEDS_ROOM:
                    self.counters.promotions += 1
                    blocks[index + 1].waiting.append((name, lane))
                else:
                    deliver(Finished(name, lane))
            look()

    def _choose(self, exhausted: bool) -> int | None:
        """The largest tier that can be filled; else the smallest with any work, so that larger ones fill up."""
        blocks = self._blocks
        for index in reversed(range(1, len(blocks))):
            if blocks[index].work >= blocks[index].tier.lanes:
                return index
        if not exhausted:
            return 0
        return next((index for index, block in enumerate(blocks) if block.work), None)


class _Block:
    """The lanes of one tier, and the programs that move them."""

    def __init__(self, pool: Pool, tier: Tier, expert: Expert, template: Start, last: bool):
        self.tier = tier
        self.names: dict[int, Any] = {}
        """Name of the run in each occupied place."""
        self.waiting: deque[tuple[Any, Lane]] = deque()
        """Lanes of the smaller tier that need this one."""
        self._pool, self._template = pool, template
        self._loop = Loop(env=pool._env, expert=expert, episodes=pool._episodes, grows=not last)
        self._lanes: Lane | None = None
        self._programs: dict[str, Callable[..., Lane]] = {}
        self._rounds = 16

    @property
    def free(self) -> int:
        """Places without a run."""
        return self.tier.lanes - len(self.names)

    @property
    def work(self) -> int:
        return len(self.names) + len(self.waiting)

    def begin(self, starts: Sequence[Start]) -> None:
        """Puts new lanes into free places."""

        def make(learner: Learner, teacher: Teacher, seed: Any) -> Lane:
            return fresh(self._loop.env, learner, teacher, seed, self._loop.episodes)

        entries = [(start.learner, start.teacher, np.int64(start.seed)) for start in starts]
        self._enter("begin", make, [start.name for start in starts], entries)

    def promote(self, waiting: Sequence[tuple[Any, Lane]]) -> None:
        """Puts lanes that outgrew the smaller tier into free places; their corrections are still to come."""

        def make(lane: Lane) -> Lane:
            return dataclasses.replace(lane, phase=jnp.asarray(Phase.RUNNING, lane.phase.dtype))

        self._enter("promote", make, [name for name, _ in waiting], [(lane,) for _, lane in waiting])

    def chunk(self) -> list[tuple[Any, Lane]]:
        """Advances all lanes for a while; gives those that leave, with their names."""
        assert self._lanes is not None
        before = self._work_done()
        began = time.perf_counter()
        compiling = self._pool.counters.compile_seconds
        self._lanes = self._call(
            "advance", lambda block, rounds: self._loop.advance(block, rounds), np.int32(self._rounds)
        )
        phases = np.array(self._lanes.phase)
        after = self._work_done()
        self._pool.counters.env_steps += after[0] - before[0]
        self._pool.counters.episodes += after[1] - before[1]
        elapsed = time.perf_counter() - began - (self._pool.counters.compile_seconds - compiling)
        self._rounds = int(
            np.clip(self._rounds * CHUNK_SECONDS / max(elapsed, 1e-6), self._rounds / 2, 2 * self._rounds)
        )
        self._rounds = min(max(self._rounds, 4), MOST_ROUNDS)
        self._pool.counters.chunks += 1
        leaving = [place for place in self.names if phases[place] != Phase.RUNNING]
        lanes = self._take(leaving)
        result = [(self.names.pop(place), lane) for place, lane in zip(leaving, lanes, strict=True)]
        if leaving:
            phases[leaving] = Phase.EMPTY
            self._lanes = dataclasses.replace(self._lanes, phase=jnp.asarray(phases))
        return result

    def _work_done(self) -> tuple[int, int]:
        """Steps and episodes of the lanes in the block."""
        assert self._lanes is not None
        occupied, episode = list(self.names), np.asarray(self._lanes.episode)
        unwritten = np.where(episode < self._loop.episodes, np.asarray(self._lanes.env.time), 0)
        steps = np.asarray(self._lanes.rows.length).sum(0) + unwritten
        return int(steps[occupied].sum()), int(episode[occupied].sum())

    def _sized(self, lane: Lane) -> Lane:
        """The lane with this tier's room."""
        state = lane.learner.resize(lane.state, self.tier.policy_capacity, self.tier.human_capacity)
        return dataclasses.replace(lane, state=state, controller=lane.learner.controller(state))

    def _enter(
        self, program: str, make: Callable[..., Lane], names: Sequence[Any], entries: Sequence[tuple]
    ) -> None:
        """Puts `make(*entry)` into a free place for each entry, several in one call."""
        if self._lanes is None:
            self._lanes = self._empty()

        def enter(block: Lane, places: Any, count: Any, entries: tuple) -> Lane:
            def one(i: Any, block: Lane) -> Lane:
                entry = jax.tree.map(lambda leaf: leaf[i], entries)
                return _insert(block, places[i], self._sized(make(*entry)))

            return jax.lax.fori_loop(0, count, one, block)

        at_once = min(ENTER, self.tier.lanes)
        free = [place for place in range(self.tier.lanes) if place not in self.names]
        for first in range(0, len(entries), at_once):
            batch = entries[first : first + at_once]
            places = np.resize(np.array(free[first : first + len(batch)], np.int32), at_once)
            padded = [*batch, *[batch[-1]] * (at_once - len(batch))]
            stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *padded)
            self._lanes = self._call(program, enter, places, np.int32(len(batch)), stacked)
        self.names.update(zip(free, names, strict=False))

    def _call(self, program: str, function: Callable[..., Lane], *arguments: Any) -> Lane:
        """Runs a program on the block, which it consumes; compiles it the first time."""
        if program not in self._programs:
            began = time.perf_counter()
            lowered = jax.jit(function, donate_argnums=0).lower(self._lanes, *arguments)
            self._programs[program] = lowered.compile()
            self._pool.counters.compile_seconds += time.perf_counter() - began
            self._pool.counters.compilations += 1
        return self._programs[program](self._lanes, *arguments)

    def _empty(self) -> Lane:
        """A block without runs: every place holds a copy of one idle lane."""
        start = self._template
        shapes = jax.eval_shape(
            lambda learner, teacher, seed: self._sized(
                fresh(self._loop.env, learner, teacher, seed, self._loop.episodes)
            ),
            start.learner,
            start.teacher,
            np.int64(start.seed),
        )

        def zeros(leaf: jax.ShapeDtypeStruct, axis: int) -> jax.Array:
            shape = (self.tier.lanes, *leaf.shape) if axis == 0 else (*leaf.shape, self.tier.lanes)
            return jnp.zeros(shape, leaf.dtype)

        block = map_lanes(zeros, shapes)
        return dataclasses.replace(block, phase=jnp.full(self.tier.lanes, Phase.EMPTY, jnp.int32))

    def _take(self, places: Sequence[int]) -> list[Lane]:
        """Copies of lanes, on the host."""
        if not places:
            return []
        assert self._lanes is not None
        taken = map_lanes(lambda leaf, axis: np.moveaxis(np.asarray(leaf), axis, 0)[places], self._lanes)
        leaves, structure = jax.tree.flatten(taken)
        return [structure.unflatten([leaf[i] for leaf in leaves]) for i in range(len(places))]


def _insert(block: Lane, place: Any, lane: Lane) -> Lane:
    def put(leaf: jax.Array, value: jax.Array, axis: int) -> jax.Array:
        return jax.lax.dynamic_update_index_in_dim(leaf, value, place, axis if axis == 0 else leaf.ndim - 1)

    return map_lanes(put, block, lane)
