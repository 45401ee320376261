"""Runs any number of lanes through blocks of fixed width, from the host.

A block is a compiled program for a number of lanes and a capacity. Between chunks of some tens of milliseconds the
host takes out lanes that have finished, gives their places to the next ones, and moves lanes whose dictionary is full
into the block of the next capacity. Widths and capacities are fixed, a lane's tier follows from its own counts, and
empty places are masked: so the bits of a lane do not depend on what else is run, nor on when the host looks.
It may copy a lane at the end of an episode (`Keep`), or all of them wherever it looks (`snapshot`), and go on from
there (`resume`). A run may begin with what was learned elsewhere (`Start.state`): it goes where such lanes go too.
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp

from gpcjax.engine.asking import Expert
from gpcjax.engine.block import Block, Counters, Occupant, Tier
from gpcjax.engine.host import HostLoop
from gpcjax.engine.identity import Keeper
from gpcjax.engine.keeping import Keep
from gpcjax.engine.lanes import Lane, Phase, Start, map_by_field
from gpcjax.engine.pace import Pace
from gpcjax.engine.rollout import Loop
from gpcjax.engine.snapshots import NotResumed, Snapshot, fitted
from gpcjax.envs.base import Env
from gpcjax.envs.host import HostEnv
from gpcjax.learners.base import Status

TIERS = (
    Tier(48, 64, 32),
    Tier(192, 512, 16),
    Tier(256, 1024, 16),
    Tier(512, 2048, 16),
    Tier(1024, 4096, 8),
)
"""Human models only append and outgrow policies, which SPARS keeps small; their room costs memory, and no time. What
none of a block's policies has learned costs hardly any either (`gpcjax.policies.kernel`).

Measured on a CPU (`benchmarks/README.md`): few tiers, as each costs seconds to compile; narrow ones, as time is
proportional to the width from 32 lanes on, and those few that outgrow the others run alone in the end.
"""

NORMALISED = TIERS[1:]
"""For GPC-NS, whose runs nearly all outgrow the first one, and whose steps are no shorter there."""

TIERS_TOGETHER = (
    Tier(48, 64, 4096),
    Tier(96, 128, 4096),
    Tier(128, 256, 2048),
    Tier(256, 512, 1024),
    Tier(512, 1024, 512),
    Tier(512, 2048, 256),
    Tier(1024, 4096, 64),
)
"""The same where lanes are computed together (`gpcjax.gp.batching`), with whole factors, whose room is time as well.

Measured on one GPU (`benchmarks/README.md`): there a round takes as long for a thousand lanes as for ten.
"""


def tiers(max_capacity: int, together: bool = False, normalises: bool = False) -> tuple[Tier, ...]:
    """The tiers up to `max_capacity` points, the last one exactly there; `together` for where lanes are.

    `normalises` for learners that do.
    """
    measured, wide = (TIERS_TOGETHER, 64) if together else (NORMALISED if normalises else TIERS, 8)
    largest = measured[-1].human_capacity
    beyond = [Tier(largest, largest, wide)]
    while largest < max_capacity:
        largest *= 2
        beyond.append(Tier(largest, largest, wide))
    chosen: list[Tier] = []
    for tier in (*measured, *beyond):
        policy, human = min(tier.policy_capacity, max_capacity), min(tier.human_capacity, max_capacity)
        if not chosen or (policy, human) != chosen[-1].capacities:
            chosen.append(dataclasses.replace(tier, policy_capacity=policy, human_capacity=human))
    return tuple(chosen)


@dataclasses.dataclass(frozen=True)
class Finished:
    """A run that ended: its lane on the host, without a lanes axis (numpy).

    Where nobody wants what it learned, its `state` and `controller` have no arrays.
    """

    name: Any
    lane: Lane


@dataclasses.dataclass(frozen=True)
class Kept:
    """What a run had learned at the end of an episode: a copy of its lane, like that of one that ended.

    Rows are those of the episodes so far; unless it was the last one, the lane is at the start of the next.
    """

    name: Any
    episode: int
    """From 1, as in rows."""
    lane: Lane


@dataclasses.dataclass(frozen=True)
class Resumed:
    """A run that goes on from a snapshot, for `Pool.run`; `Pool.resume` makes it."""

    tier: int
    """Index of the block that it goes into."""
    waiting: tuple[Occupant, Lane]


class Pool:
    """Blocks of all tiers for starts of one structure (env, learner, sizes, episodes).

    Args:
        env, expert: shared by all lanes. A task on the host is simulated there, between the calls of its programs.
        episodes: of every lane.
        template: a start whose structure all others share.
        tiers: capacities and widths, growing; the last one leaves a full dictionary to the learner's `on_full`.
        keep: after which episodes `run` hands out what was learned; the rows of a run are the same without.
        kept: where compiled programs are looked for, and go. In processes that all compute alike.
        learned: whether what a run has learned is wanted of those that ended, which takes copies of large dictionaries.
    """

    def __init__(
        self,
        env: Env | HostEnv,
        expert: Expert,
        episodes: int,
        template: Start,
        tiers: Sequence[Tier],
        keep: Keep | None = None,
        kept: Keeper | None = None,
        learned: bool = True,
    ):
        self.counters = Counters()
        self.template = template
        self._keep, self._learned = keep, learned or keep is not None

        def loop(grows: bool) -> Loop | HostLoop:
            if isinstance(env, HostEnv):
                return HostLoop(env, expert, episodes, grows, keep)
            return Loop(env, expert, episodes, grows, keep=keep)

        self._blocks = [
            Block(tier, loop(tier is not tiers[-1]), template, self.counters, kept) for tier in tiers
        ]

    def run(
        self,
        next_start: Callable[[], Start | Resumed | None],
        deliver: Callable[[Finished], None],
        look: Callable[[], None] = lambda: None,
        keep: Callable[[Kept], None] = lambda kept: None,
    ) -> None:
        """Runs starts until `next_start` has no more and all have been delivered.

        Args:
            next_start: the next run to begin, or to go on with (`resume`); None if there is no more.
            deliver: takes each run that ended.
            look: called after every chunk; it may take a `snapshot`.
            keep: takes what the pool's own `keep` asks for, of each run in the order of its episodes, and before it
                is delivered.
        """
        blocks, exhausted = self._blocks, False
        while True:
            index = self._choose(exhausted)
            if index is None:
                return
            block = blocks[index]
            if index == 0 and not exhausted:
                # Those that go on here wait for no chunk: there are never more of them than free places.
                starts = list(itertools.islice(iter(next_start, None), block.free))
                exhausted = len(starts) < block.free
                block.begin([each for each in starts if isinstance(each, Start) and each.state is None])
                for start in starts:
                    if isinstance(start, Start) and start.state is not None:
                        start = self._taught(start)
                    if isinstance(start, Resumed):
                        blocks[start.tier].waiting.append(start.waiting)
            block.admit()
            if not block.runs:
                continue
            block.advance()
            for run, lane in block.paused():
                keep(Kept(run.name, int(lane.episode), _without_room(lane)))
            for run, lane in block.leaving(self._learned):
                if lane.phase == Phase.NEEDS_ROOM:
                    self.counters.promotions += 1
                    blocks[index + 1].waiting.append((run, lane))
                    continue
                lane = _without_room(lane)
                if self._keeps_last(lane):
                    keep(Kept(run.name, int(lane.episode), lane))
                deliver(Finished(run.name, lane))
            look()

    def paces(self) -> tuple[Pace, ...]:
        """How fast the lanes of each tier go, and what they have left; for `look`, too."""
        return tuple(block.pace for block in self._blocks)

    def snapshot(self) -> list[Snapshot]:
        """Every run that is in the pool, as it is between two chunks: for `look`, which is called there.

        All of it is copied: the pool goes on beside it.
        """
        taken = []
        for index, block in enumerate(self._blocks):
            for run, lane, executed in block.snapshots():
                tier = self._blocks[index - (lane.phase == Phase.NEEDS_ROOM)].tier
                taken.append(Snapshot(run.name, lane, tier.capacities, executed))
        return taken

    def resume(self, snapshot: Snapshot) -> Resumed:
        """What `run` takes to go on with a run, to the same bits as if it had never been interrupted.

        The snapshot is of a pool like this one; what else was in that pool, or is in this one, does not matter. A
        simulation is rebuilt here, by replaying the present episode, which takes as long as that took.

        Raises:
            NotResumed: the snapshot is of a pool with other tiers, or its lane of another structure than those here; or
                the simulation does not come to where it was. The run is to be begun anew.
        """
        lane = fitted(snapshot.lane, self.shapes(snapshot.capacities))
        tier = self._tier_of(snapshot.capacities) + int(lane.phase == Phase.NEEDS_ROOM)
        if tier == len(self._blocks):
            raise NotResumed(
                f"a run that needs room for more than {snapshot.capacities} points has none here"
            )
        return Resumed(tier, self._blocks[tier].resume(snapshot.name, lane, snapshot.executed))

    def shapes(self, capacities: tuple[int, int]) -> Lane:
        """The shapes of a lane in the tier with room for these points: what `unpack` needs.

        Raises:
            NotResumed: there is no such tier.
        """
        return self._blocks[self._tier_of(capacities)].shapes

    def _taught(self, start: Start) -> Resumed:
        """A run that begins with what was learned before, in the tier whose room its state has."""
        for tier, block in enumerate(self._blocks):
            if block.has_shapes_of(start.state):
                return Resumed(tier, block.taught(start))
        raise ValueError(f"{start.name}: its state has the shapes of no tier here")

    def _tier_of(self, capacities: tuple[int, int]) -> int:
        rooms = [block.tier.capacities for block in self._blocks]
        if capacities not in rooms:
            raise NotResumed(f"a snapshot with room for {capacities} points: here is room for {rooms}")
        return rooms.index(capacities)

    def _choose(self, exhausted: bool) -> int | None:
        """The largest tier that can be filled; else the smallest with any work, so that larger ones fill up."""
        blocks = self._blocks
        for index in reversed(range(1, len(blocks))):
            if blocks[index].work >= blocks[index].tier.lanes:
                return index
        if not exhausted:
            return 0
        return next((index for index, block in enumerate(blocks) if block.work), None)

    def _keeps_last(self, lane: Lane) -> bool:
        """Whether the last episode of a run that ended is one to keep; none is of a run that stopped within it."""
        if self._keep is None or lane.status != Status.OK:
            return False
        returns = jnp.asarray(lane.rows.returns)[:, None]
        last = returns.shape[0] - 1
        return bool(self._keep.due(returns[last], returns, jnp.full(1, last, jnp.int32))[0])


def _without_room(lane: Lane) -> Lane:
    """A lane on the host with the rows of its own episodes."""
    episodes = int(lane.episodes)
    return map_by_field(lambda leaf, field: leaf[:episodes] if field == "rows" else leaf, lane)
