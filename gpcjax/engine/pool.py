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

from gpcjax.engine.asking import Expert
from gpcjax.engine.host import HostLoop
from gpcjax.engine.lanes import Lane, Phase, Start, map_lanes
from gpcjax.engine.rollout import Loop
from gpcjax.envs.base import Env
from gpcjax.envs.host import HostEnv

CHUNK_SECONDS = {Loop: 0.02, HostLoop: 0.1}
"""About how long a block runs between two looks of the host, which cost simulations on the host a tick of their own."""

ENTER, ENTER_BYTES = 16, 1 << 22
"""Lanes that are put into a block by one call, at most; fewer of large ones, as each call is filled up with copies."""

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
    Tier(512, 1024, 16),
    Tier(512, 2048, 16),
    Tier(1024, 4096, 8),
)
"""Human models only append and outgrow policies, which SPARS keeps small.

Measured on a CPU (`benchmarks/README.md`): few tiers, as each costs seconds to compile; narrow ones, as time is
proportional to the width from 32 lanes on, and those few that outgrow the others run alone in the end.
"""


def tiers(max_capacity: int) -> tuple[Tier, ...]:
    """The tiers up to `max_capacity` points, the last one exactly there."""
    largest, beyond = TIERS[-1].human_capacity, [Tier(TIERS[-1].human_capacity, TIERS[-1].human_capacity, 8)]
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
class Finished:
    """A run that ended: its lane on the host, without a lanes axis (numpy)."""

    name: Any
    lane: Lane


@dataclasses.dataclass(frozen=True)
class _Occupant:
    """A run while it is in the pool."""

    name: Any
    simulation: Any
    """What it needs on the host, if anything; it goes with the lane from block to block."""


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
        env, expert: shared by all lanes. A task on the host is simulated there, between the calls of its programs.
        episodes: of every lane.
        template: a start whose structure all others share.
        tiers: capacities and widths, growing; the last one leaves a full dictionary to the learner's `on_full`.
    """

    def __init__(
        self, env: Env | HostEnv, expert: Expert, episodes: int, template: Start, tiers: Sequence[Tier]
    ):
        self.counters = Counters()

        def loop(grows: bool) -> Loop | HostLoop:
            if isinstance(env, HostEnv):
                return HostLoop(env, expert, episodes, grows)
            return Loop(env, expert, episodes, grows)

        self._blocks = [_Block(self, tier, loop(tier is not tiers[-1]), template) for tier in tiers]

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
            if not block.runs:
                continue
            for run, lane in block.chunk():
                if lane.phase == Phase.NEEDS_ROOM:
                    self.counters.promotions += 1
                    blocks[index + 1].waiting.append((run, lane))
                else:
                    deliver(Finished(run.name, lane))
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

    def __init__(self, pool: Pool, tier: Tier, loop: Loop | HostLoop, template: Start):
        self.tier = tier
        self.runs: dict[int, _Occupant] = {}
        """The run in each occupied place."""
        self.waiting: deque[tuple[_Occupant, Lane]] = deque()
        """Lanes of the smaller tier that need this one."""
        self._pool, self._loop, self._template = pool, loop, template
        self._leaves: list[Any] = []
        self._structure: Any = None
        self._programs: dict[str, Callable[..., tuple[Any, ...]]] = {}
        self._rounds = 16

    @property
    def lanes(self) -> Lane:
        """The block. Programs take and give its leaves: modules are put together when the host looks, not each time."""
        return self._structure.unflatten(self._leaves)

    @lanes.setter
    def lanes(self, block: Lane) -> None:
        self._leaves, self._structure = jax.tree.flatten(block)

    @property
    def free(self) -> int:
        """Places without a run."""
        return self.tier.lanes - len(self.runs)

    @property
    def work(self) -> int:
        return len(self.runs) + len(self.waiting)

    def begin(self, starts: Sequence[Start]) -> None:
        """Puts new lanes into free places."""
        entered = [self._loop.enter(start) for start in starts]
        runs = [
            _Occupant(start.name, simulation) for start, (simulation, _) in zip(starts, entered, strict=True)
        ]
        self._enter("begin", self._loop.begin, runs, [entry for _, entry in entered])

    def promote(self, waiting: Sequence[tuple[_Occupant, Lane]]) -> None:
        """Puts lanes that outgrew the smaller tier into free places; their corrections are still to come."""

        def make(lane: Lane) -> Lane:
            return dataclasses.replace(lane, phase=jnp.asarray(Phase.RUNNING, lane.phase.dtype))

        self._enter("promote", make, [run for run, _ in waiting], [(lane,) for _, lane in waiting])

    def chunk(self) -> list[tuple[_Occupant, Lane]]:
        """Advances all lanes for a while; gives those that leave, with their runs."""
        before = self._work_done()
        began = time.perf_counter()
        compiling = self._pool.counters.compile_seconds
        simulations = {place: run.simulation for place, run in self.runs.items()}
        self._loop.drive(self._call, simulations, self.tier.lanes, self._rounds)
        phases = np.array(self.lanes.phase)
        after = self._work_done()
        self._pool.counters.env_steps += after[0] - before[0]
        self._pool.counters.episodes += after[1] - before[1]
        elapsed = time.perf_counter() - began - (self._pool.counters.compile_seconds - compiling)
        wanted = self._rounds * CHUNK_SECONDS[type(self._loop)] / max(elapsed, 1e-6)
        self._rounds = int(np.clip(wanted, self._rounds / 2, 2 * self._rounds))
        self._rounds = min(max(self._rounds, 4), MOST_ROUNDS)
        self._pool.counters.chunks += 1
        leaving = [place for place in self.runs if phases[place] != Phase.RUNNING]
        lanes = self._take(leaving)
        result = [(self.runs.pop(place), lane) for place, lane in zip(leaving, lanes, strict=True)]
        if leaving:
            phases[leaving] = Phase.EMPTY
            self.lanes = dataclasses.replace(self.lanes, phase=jnp.asarray(phases))
        return result

    def _work_done(self) -> tuple[int, int]:
        """Steps and episodes of the lanes in the block."""
        block = self.lanes
        occupied, episode = list(self.runs), np.asarray(block.episode)
        unwritten = np.where(episode < self._loop.episodes, np.asarray(block.env.time), 0)
        steps = np.asarray(block.rows.length).sum(0) + unwritten
        return int(steps[occupied].sum()), int(episode[occupied].sum())

    def _sized(self, lane: Lane) -> Lane:
        """The lane with this tier's room."""
        state = lane.learner.resize(lane.state, self.tier.policy_capacity, self.tier.human_capacity)
        return dataclasses.replace(lane, state=state, controller=lane.learner.controller(state))

    def _enter(
        self, program: str, make: Callable[..., Lane], runs: Sequence[_Occupant], entries: Sequence[tuple]
    ) -> None:
        """Puts `make(*entry)` into a free place for each entry, several in one call."""
        if self._structure is None:
            self.lanes = self._empty()

        def enter(block: Lane, places: Any, count: Any, entries: tuple) -> tuple[Lane]:
            def one(i: Any, block: Lane) -> Lane:
                entry = jax.tree.map(lambda leaf: leaf[i], entries)
                return _insert(block, places[i], self._sized(make(*entry)))

            return (jax.lax.fori_loop(0, count, one, block),)

        size = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(entries[:1]))
        at_once = min(ENTER, self.tier.lanes, max(1, ENTER_BYTES // max(size, 1)))
        free = [place for place in range(self.tier.lanes) if place not in self.runs]
        for first in range(0, len(entries), at_once):
            batch = entries[first : first + at_once]
            places = np.resize(np.array(free[first : first + len(batch)], np.int32), at_once)
            padded = [*batch, *[batch[-1]] * (at_once - len(batch))]
            stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *padded)
            self._call(program, enter, places, np.int32(len(batch)), stacked)
        self.runs.update(zip(free, runs, strict=False))

    def _call(self, program: str, function: Callable[..., tuple[Any, ...]], *arguments: Any) -> tuple:
        """Runs a program on the block, which it replaces; gives what else it returns. Compiles it first."""
        if program not in self._programs:
            structure = self._structure

            def flat(leaves: list[Any], *arguments: Any) -> tuple[list[Any], tuple[Any, ...]]:
                block, *others = function(structure.unflatten(leaves), *arguments)
                return jax.tree.leaves(block), tuple(others)

            began = time.perf_counter()
            self._programs[program] = (
                jax.jit(flat, donate_argnums=0).lower(self._leaves, *arguments).compile()
            )
            self._pool.counters.compile_seconds += time.perf_counter() - began
            self._pool.counters.compilations += 1
        self._leaves, others = self._programs[program](self._leaves, *arguments)
        return others

    def _empty(self) -> Lane:
        """A block without runs: every place holds a copy of one idle lane."""
        start = self._template
        _, entry = self._loop.enter(start)
        shapes = jax.eval_shape(lambda *entry: self._sized(self._loop.begin(*entry)), *entry)

        def zeros(leaf: jax.ShapeDtypeStruct, axis: int) -> jax.Array:
            shape = (self.tier.lanes, *leaf.shape) if axis == 0 else (*leaf.shape, self.tier.lanes)
            return jnp.zeros(shape, leaf.dtype)

        block = map_lanes(zeros, shapes)
        return dataclasses.replace(block, phase=jnp.full(self.tier.lanes, Phase.EMPTY, jnp.int32))

    def _take(self, places: Sequence[int]) -> list[Lane]:
        """Copies of lanes, on the host."""
        if not places:
            return []
        taken = map_lanes(lambda leaf, axis: np.moveaxis(np.asarray(leaf), axis, 0)[places], self.lanes)
        leaves, structure = jax.tree.flatten(taken)
        return [structure.unflatten([leaf[i] for leaf in leaves]) for i in range(len(places))]


def _insert(block: Lane, place: Any, lane: Lane) -> Lane:
    def put(leaf: jax.Array, value: jax.Array, axis: int) -> jax.Array:
        return jax.lax.dynamic_update_index_in_dim(leaf, value, place, axis if axis == 0 else leaf.ndim - 1)

    return map_lanes(put, block, lane)
