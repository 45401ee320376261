"""The lanes of one width and capacity, and the programs that put them there, advance them and take them out.

Over 300 lines: one class, as all that moves lanes must keep the same invariants.
"""

import dataclasses
import functools
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax.engine.host import HostLoop
from gpcjax.engine.identity import Keeper, Unknown, digest
from gpcjax.engine.lanes import LEARNED, Lane, Phase, Start, map_by_field, map_lanes
from gpcjax.engine.pace import Pace
from gpcjax.engine.rollout import Loop
from gpcjax.gp.batching import together

CHUNK_SECONDS = {Loop: 0.02, HostLoop: 0.1}
"""About how long a block runs between two looks of the host, which cost simulations on the host a tick of their own."""

ENTER, ENTER_BYTES = 16, 1 << 22
"""Lanes that are put into a block by one call, at most; fewer of large ones, as each call is filled up with copies."""

TOGETHER, TOGETHER_BYTES = 256, 1 << 26
"""The same where lanes are computed together, and lanes that are taken out by one call: each call costs more there."""

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

    @property
    def capacities(self) -> tuple[int, int]:
        """Points of each policy, and of each human model."""
        return self.policy_capacity, self.human_capacity


@dataclasses.dataclass(frozen=True)
class Occupant:
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
    kept: int = 0
    """Of these, those that are kept for other processes."""
    chunks: int = 0
    promotions: int = 0


class Block:
    """The lanes of one tier, and the programs that move them; what it does is counted in `counters`.

    Programs are looked for in `kept` before they are traced, and go there.
    """

    def __init__(
        self,
        tier: Tier,
        loop: Loop | HostLoop,
        template: Start,
        counters: Counters,
        kept: Keeper | None = None,
    ):
        self.tier = tier
        self.runs: dict[int, Occupant] = {}
        """The run in each occupied place."""
        self.waiting: deque[tuple[Occupant, Lane]] = deque()
        """Lanes of the smaller tier that need this one, and lanes of this tier that go on from a snapshot."""
        self._counters, self._loop, self._template, self._kept = counters, loop, template, kept
        self._leaves: list[Any] = []
        self._looked_at: Lane | None = None
        """The leaves as a block, if the host has looked at them since a program gave them."""
        self._structure: Any = None
        self._programs: dict[str, Callable[..., Any]] = {}
        self._rounds = 16
        self._pace = Pace(tier.lanes)

    @property
    def lanes(self) -> Lane:
        """The block. Programs take and give its leaves: modules are put together when the host looks, not each time."""
        block = self._looked_at
        if block is None:
            block = self._looked_at = self._structure.unflatten(self._leaves)
        return block

    @lanes.setter
    def lanes(self, block: Lane) -> None:
        self._leaves, self._structure = jax.tree.flatten(block)
        self._looked_at = block

    @property
    def free(self) -> int:
        """Places without a run."""
        return self.tier.lanes - len(self.runs)

    @property
    def work(self) -> int:
        return len(self.runs) + len(self.waiting)

    @property
    def pace(self) -> Pace:
        """How fast its lanes go, and what they and those that wait have left."""
        if not self.work:
            return self._pace
        left = [int(lane.episodes) - int(lane.episode) for _, lane in self.waiting]
        if self.runs:
            block, places = self.lanes, list(self.runs)
            left += (np.asarray(block.episodes) - np.asarray(block.episode))[places].tolist()
        return self._pace.with_left(left)

    def begin(self, starts: Sequence[Start]) -> None:
        """Puts new lanes into free places."""
        entered = [self._loop.enter(start) for start in starts]
        runs = [
            Occupant(start.name, simulation) for start, (simulation, _) in zip(starts, entered, strict=True)
        ]
        entries = [entry for _, entry in entered]
        self._enter("begin", lambda *entry: self._sized(self._loop.begin(*entry)), runs, entries)

    def admit(self) -> None:
        """Puts waiting lanes into free places."""
        coming = [self.waiting.popleft() for _ in range(min(self.free, len(self.waiting)))]

        def promoted(lane: Lane) -> Lane:
            # It outgrew the smaller tier, and its correction is still to come.
            return self._sized(dataclasses.replace(lane, phase=jnp.asarray(Phase.RUNNING, lane.phase.dtype)))

        for program, make, grown in (("promote", promoted, True), ("resume", lambda lane: lane, False)):
            chosen = [each for each in coming if (each[1].phase == Phase.NEEDS_ROOM) == grown]
            if chosen:
                self._enter(program, make, [run for run, _ in chosen], [(lane,) for _, lane in chosen])

    def advance(self) -> None:
        """Advances all lanes for a while; then those that `paused`, and those that are `leaving`, are to be taken."""
        before = self._work_done()
        began = time.perf_counter()
        compiling = self._counters.compile_seconds
        simulations = {place: run.simulation for place, run in self.runs.items()}
        self._loop.drive(self._call, simulations, self.tier.lanes, self._rounds)
        after = self._work_done()
        self._counters.env_steps += after[0] - before[0]
        self._counters.episodes += after[1] - before[1]
        elapsed = time.perf_counter() - began - (self._counters.compile_seconds - compiling)
        wanted = self._rounds * CHUNK_SECONDS[type(self._loop)] / max(elapsed, 1e-6)
        self._rounds = int(np.clip(wanted, self._rounds / 2, 2 * self._rounds))
        self._rounds = min(max(self._rounds, 4), MOST_ROUNDS)
        self._counters.chunks += 1
        pace = self._pace
        self._pace = pace._replace(
            seconds=pace.seconds + elapsed,
            lane_seconds=pace.lane_seconds + elapsed * len(self.runs),
            episodes=pace.episodes + after[1] - before[1],
        )

    def paused(self) -> list[tuple[Occupant, Lane]]:
        """Copies of the lanes that wait to be kept, with their runs; they go on where they are."""
        places = self._places(Phase.PAUSED)
        self._set_phase(places, Phase.RUNNING)
        return list(zip((self.runs[place] for place in places), self._take(places), strict=True))

    def leaving(self, learned: bool = True) -> list[tuple[Occupant, Lane]]:
        """Takes out the lanes that go no further here, with their runs.

        Of those that ended what they `learned` stays behind where nobody wants it.
        """
        ended, outgrown = self._places(Phase.FINISHED), self._places(Phase.NEEDS_ROOM)
        places = ended + outgrown
        lanes = self._take(ended, learned) + self._take(outgrown)
        self._set_phase(places, Phase.EMPTY)
        left = [int(lane.episodes - lane.episode) for lane in lanes if lane.phase == Phase.NEEDS_ROOM]
        self._pace = self._pace._replace(
            outgrown=self._pace.outgrown + len(left),
            then_left=self._pace.then_left + sum(left),
            ended=self._pace.ended + len(lanes) - len(left),
        )
        return [(self.runs.pop(place), lane) for place, lane in zip(places, lanes, strict=True)]

    def snapshots(self) -> list[tuple[Occupant, Lane, Any]]:
        """Copies of all lanes here, with their runs and what rebuilds their simulations; first those in the block."""
        lanes = zip(self.runs.values(), self._take(list(self.runs)), strict=True)
        return [(run, lane, self._loop.executed(run.simulation)) for run, lane in (*lanes, *self.waiting)]

    def resume(self, name: Any, lane: Lane, executed: Any) -> tuple[Occupant, Lane]:
        """A lane of this tier, or of the smaller one if it needs room, and its run: what `waiting` takes.

        Raises:
            NotResumed: the simulation does not come to where it was.
        """
        return Occupant(name, self._loop.rebuild(lane, executed)), lane

    def has_shapes_of(self, state: Any) -> bool:
        """Whether a lane here may hold this state."""
        given, wanted = jax.tree.leaves(state), jax.tree.leaves(self.shapes.state)
        return [np.shape(leaf) for leaf in given] == [leaf.shape for leaf in wanted]

    def taught(self, start: Start) -> tuple[Occupant, Lane]:
        """A run that begins with a state of these shapes, as `waiting` takes it."""

        def begin(entry: tuple[Any, ...], state: Any) -> Lane:
            lane = self._loop.begin(*entry)
            return dataclasses.replace(lane, state=state, controller=lane.learner.controller(state))

        simulation, entry = self._loop.enter(start)
        if "taught" not in self._programs:
            with self._compiling():
                self._programs["taught"] = jax.jit(begin).lower(entry, start.state).compile()
                self._counters.compilations += 1
        lane = self._programs["taught"](entry, start.state)
        return Occupant(start.name, simulation), jax.tree.map(np.asarray, lane)

    @functools.cached_property
    def shapes(self) -> Lane:
        """The shape of one lane."""
        _, entry = self._loop.enter(self._template)
        return jax.eval_shape(lambda *entry: self._sized(self._loop.begin(*entry)), *entry)

    def _places(self, *phases: Phase) -> list[int]:
        """The occupied places whose lanes are in one of these phases."""
        among = np.isin(np.asarray(self.lanes.phase), [int(phase) for phase in phases]).tolist()
        return [place for place in self.runs if among[place]]

    def _set_phase(self, places: Sequence[int], phase: Phase) -> None:
        if places:
            phases = np.array(self.lanes.phase)
            phases[places] = phase
            self.lanes = dataclasses.replace(self.lanes, phase=jax.device_put(phases))

    def _work_done(self) -> tuple[int, int]:
        """Steps and episodes of the lanes in the block."""
        block = self.lanes
        occupied, episode = list(self.runs), np.asarray(block.episode)
        unwritten = np.where(episode < np.asarray(block.episodes), np.asarray(block.env.time), 0)
        steps = np.asarray(block.rows.length).sum(0) + unwritten
        return int(steps[occupied].sum()), int(episode[occupied].sum())

    def _sized(self, lane: Lane) -> Lane:
        """The lane with this tier's room."""
        state = lane.learner.resize(lane.state, self.tier.policy_capacity, self.tier.human_capacity)
        return dataclasses.replace(lane, state=state, controller=lane.learner.controller(state))

    def _enter(
        self, program: str, make: Callable[..., Lane], runs: Sequence[Occupant], entries: Sequence[tuple]
    ) -> None:
        """Puts `make(*entry)`, of this tier's shapes, into a free place for each entry, several in one call."""
        if self._structure is None:
            self.lanes = self._empty()

        def enter(block: Lane, places: Any, count: Any, entries: tuple) -> tuple[Lane]:
            def one(i: Any, block: Lane) -> Lane:
                entry = jax.tree.map(lambda leaf: leaf[i], entries)
                return _insert(block, places[i], make(*entry))

            return (jax.lax.fori_loop(0, count, one, block),)

        def enter_together(block: Lane, places: Any, count: Any, entries: tuple) -> tuple[Lane]:
            nowhere = jnp.int32(self.tier.lanes)
            places = jnp.where(jnp.arange(places.shape[0]) < count, places, nowhere)
            return (_insert_all(block, places, jax.vmap(make)(*entries)),)

        size = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(entries[:1]))
        most, most_bytes = (TOGETHER, TOGETHER_BYTES) if together() else (ENTER, ENTER_BYTES)
        at_once = min(most, self.tier.lanes, max(1, most_bytes // max(size, 1)))
        entering = enter_together if together() else enter
        free = [place for place in range(self.tier.lanes) if place not in self.runs]
        for first in range(0, len(entries), at_once):
            batch = entries[first : first + at_once]
            places = np.resize(np.array(free[first : first + len(batch)], np.int32), at_once)
            padded = [*batch, *[batch[-1]] * (at_once - len(batch))]
            stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *padded)
            self._call(program, entering, places, np.int32(len(batch)), stacked)
        self.runs.update(zip(free, runs, strict=False))

    def _call(self, program: str, function: Callable[..., tuple[Any, ...]], *arguments: Any) -> tuple:
        """Runs a program on the block, which it replaces; gives the arrays that it returns besides."""
        given = jax.tree.leaves(arguments)
        if program not in self._programs:
            with self._compiling():
                self._programs[program] = self._compiled(program, function, arguments, given)
        self._looked_at = None  # its arrays are given away
        self._leaves, others = self._programs[program](self._leaves, given)
        return tuple(others)

    def _compiled(
        self,
        program: str,
        function: Callable[..., tuple[Any, ...]],
        arguments: tuple[Any, ...],
        given: list[Any],
    ) -> Callable[..., tuple[list[Any], list[Any]]]:
        """A program of the leaves of the block and those of its arguments: one that was kept, or compiled now."""
        structure, form, others = self._structure, jax.tree.structure(arguments), 0

        def flat(leaves: list[Any], given: list[Any]) -> tuple[list[Any], list[Any]]:
            nonlocal others
            block, *besides = function(structure.unflatten(leaves), *form.unflatten(given))
            others = len(besides)
            return jax.tree.leaves(block), besides

        key = None if self._kept is None else self._digest(program, arguments)
        if self._kept is not None and key is not None and (found := self._kept.find(key)) is not None:
            return found
        # With unused arguments: the same text must mean the same use of the same ones.
        lowered = jax.jit(flat, donate_argnums=0, keep_unused=True).lower(self._leaves, given)
        self._counters.compilations += 1
        if self._kept is None or key is None:
            return lowered.compile()
        self._counters.kept += 1
        return self._kept.compiled(key, lowered, len(self._leaves), len(given), others)

    @contextmanager
    def _compiling(self) -> Iterator[None]:
        """What this takes is no time of runs."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._counters.compile_seconds += time.perf_counter() - began

    def _digest(self, program: str, arguments: tuple[Any, ...]) -> str | None:
        """All that a program of this block depends on; None where it is somebody else's code."""
        template = self._template.learner, self._template.teacher, self._template.credit
        try:
            compiled_in = (program, self.tier, type(self._loop), self._loop.compiled_in)
            return digest(compiled_in, (template, arguments))
        except Unknown:
            return None

    def _empty(self) -> Lane:
        """A block without runs: every place holds a copy of one idle lane."""

        def zeros(leaf: jax.ShapeDtypeStruct, axis: int) -> jax.Array:
            shape = (self.tier.lanes, *leaf.shape) if axis == 0 else (*leaf.shape, self.tier.lanes)
            return jax.device_put(np.zeros(shape, leaf.dtype))  # of jnp each shape would be compiled

        block = map_lanes(zeros, self.shapes)
        return dataclasses.replace(
            block, phase=jax.device_put(np.full(self.tier.lanes, Phase.EMPTY, np.int32))
        )

    def _take(self, places: Sequence[int], learned: bool = True) -> list[Lane]:
        """Copies of lanes, on the host, with or without what they learned."""
        if not places:
            return []
        if together():
            return self._take_from_device(places)
        block = self.lanes
        if not learned:
            block = map_by_field(lambda leaf, field: None if field in LEARNED else leaf, block)
        taken = map_lanes(lambda leaf, axis: np.moveaxis(np.asarray(leaf), axis, 0)[places], block)
        return _apart(taken, len(places))

    def _take_from_device(self, places: Sequence[int]) -> list[Lane]:
        """The same, where a block is far from the host: no other lane comes along, but for a few to fill up."""

        def take(block: Lane, places: Any) -> tuple[Any, ...]:
            taken = map_lanes(lambda leaf, axis: jnp.moveaxis(leaf, axis, 0)[places], block)
            return block, *jax.tree.leaves(taken)

        lanes, at_once = [], min(TOGETHER, self.tier.lanes)
        for first in range(0, len(places), at_once):
            batch = places[first : first + at_once]
            taken = self._call("take", take, np.resize(np.array(batch, np.int32), at_once))
            lanes += _apart(self._structure.unflatten(jax.device_get(list(taken))), len(batch))
        return lanes


def _apart(lanes: Lane, count: int) -> list[Lane]:
    """The first of these lanes, whose first axis in every leaf is that of the lanes, each for itself."""
    leaves, structure = jax.tree.flatten(lanes)
    return [structure.unflatten([leaf[i] for leaf in leaves]) for i in range(count)]


def _insert_all(block: Lane, places: Any, lanes: Lane) -> Lane:
    """The block with lanes at these places; what has no such place is left out."""

    def put(leaf: jax.Array, values: jax.Array, axis: int) -> jax.Array:
        if axis == 0:
            return leaf.at[places].set(values, mode="drop")
        return leaf.at[..., places].set(jnp.moveaxis(values, 0, -1), mode="drop")

    return map_lanes(put, block, lanes)


def _insert(block: Lane, place: Any, lane: Lane) -> Lane:
    def put(leaf: jax.Array, value: jax.Array, axis: int) -> jax.Array:
        return jax.lax.dynamic_update_index_in_dim(leaf, value, place, axis if axis == 0 else leaf.ndim - 1)

    return map_lanes(put, block, lane)
