"""Many sessions in one process, each learner a lane of a block that others share.

The steps of all that are due are one call of a program for each block, and a correction is one call. A pupil whose
dictionary is full moves to the block of the next room before the correction that may not fit: a matter of its own
counts, as in a pool (`gpcjax.engine.pool`). Blocks have 8 or 16 lanes, so that the bits of a lane do not depend on who
else is there: the recording of a session here is made again in a classroom with one pupil.

Methods may be called from several threads. Of each pupil one thing happens at a time, which its caller sees to; the
steps of others do not wait for a correction.
"""

import functools
import threading
from collections.abc import Hashable, Sequence
from typing import Any

import jax
import numpy as np

from gpcjax.engine import streams
from gpcjax.engine.bench import Bench
from gpcjax.engine.bench_programs import Programs
from gpcjax.engine.history import Credit
from gpcjax.engine.pool import Tier
from gpcjax.engine.pupil import Pupil
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State
from gpcjax.learners.recipes import in_arrays

ROOMS = ((64, 64), (128, 256), (256, 512), (1024, 1024))
"""Points of each policy and each human model, as dictionaries grow. Human models only append and outgrow policies.

A correction of GPC takes 7 ms with the last, 0.1 ms with the first; few of them, as each costs seconds to compile.
"""

LEAST, MOST, BENCH_BYTES = 8, 16, 1 << 28
"""Lanes of a block, at least and at most, and bytes of what is learned in one: beyond that there are more of them.

A row of more than four vectors (64 lanes, or 32 where vectors have four numbers) is compiled to another loop, with
other last bits.
"""


Rooms = Sequence[tuple[int, int]]


def rooms_of(given: Any) -> Rooms:
    """The rooms that a recording names. Raises TypeError or ValueError for what is no list of them."""
    rooms = tuple((int(policy), int(human)) for policy, human in given)
    if list(rooms) != sorted(set(rooms)):
        raise ValueError("they do not grow")
    return rooms


def lanes_for(places: int) -> int:
    """The width of a block with so many places: a power of two, a full vector at least (`gpcjax.engine.pool.Tier`)."""
    return max(LEAST, 1 << (places - 1).bit_length())


@functools.lru_cache(maxsize=64)
def _programs(tier: Tier, kind: "_Kind") -> Programs:
    """Those of all benches of one kind: a classroom for one pupil comes and goes with each recording."""
    return Programs(tier, *kind.given)


class _Kind:
    """Learners and credit of one structure are equal, whatever their numbers."""

    def __init__(self, learner: Learner, credit: Credit | None):
        self.given = learner, credit
        leaves, structure = jax.tree.flatten(self.given)
        self._key = structure, tuple((np.shape(leaf), np.asarray(leaf).dtype.name) for leaf in leaves)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kind) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


def kind_of(learner: Learner, credit: Credit | None) -> Hashable:
    """What all who share a classroom have in common."""
    return _Kind(learner, credit)


class Classroom:
    """Places for learners of one structure: of one kind, for one task.

    Args:
        learner: whose structure all have; room for points is a matter of `rooms`.
        credit: likewise, how they reckon with late advice.
        rooms: points of each policy and each human model, growing; the last leaves a full dictionary to the learner.
            None of a learner without dictionaries.
        places: how many at most.
    """

    def __init__(
        self, learner: Learner, credit: Credit | None, rooms: Sequence[tuple[int, int]], places: int
    ):
        self.rooms = [list(room) for room in rooms]
        """As a recording names them."""
        self.places = places
        learner = in_arrays(learner)  # no block has lanes of numbers of Python's
        self._learner, self._credit = learner, credit
        tiers = [Tier(*room, self._width(room)) for room in rooms or [(1, 1)]]
        self._programs = [_programs(tier, _Kind(learner, credit)) for tier in tiers]
        self._tiers = tiers
        self._benches: list[list[Bench]] = [[] for _ in tiers]
        self._taken = 0
        self.lock = threading.RLock()
        """Held by whoever changes what is learned, or where: proposing does not."""

    def compile(self, rooms: int | None = None) -> None:
        """All that pupils need in the first so many rooms, or in all."""
        for tier, programs in list(enumerate(self._programs))[:rooms]:
            programs.compile(self._programs[tier - 1] if tier else None)

    def enter(
        self, learner: Learner, seed: int, credit: Credit | None = None, state: State | None = None
    ) -> Pupil:
        """Gives a free place to a learner of this structure, with `state` or untaught.

        Raises:
            UserError: there is none.
        """
        learner = in_arrays(learner)  # no block has lanes of numbers of Python's
        if state is None:
            state = learner.init(streams.first_key(seed))
        return self._place(Pupil(self, learner, seed, credit), state)

    def leave(self, pupil: Pupil) -> None:
        """Gives its place back."""
        with self.lock:
            pupil.bench.leave(pupil.lane)
            self._taken -= 1

    def promote(self, pupil: Pupil) -> bool:
        """Moves it to the next room; False where there is none."""
        with self.lock:
            tier = self._tiers.index(pupil.bench.tier) + 1
            if tier == len(self._tiers):
                return False
            state, bench = pupil.bench.state(pupil.lane), self._bench(tier)
            lane, known = bench.enter(pupil.learner, pupil.credit, state)
            pupil.bench.leave(pupil.lane)
            pupil.bench, pupil.lane, pupil.known = bench, lane, known
            return True

    def _place(self, pupil: Pupil, state: State) -> Pupil:
        with self.lock:
            if self._taken >= self.places:
                raise UserError(f"all {self.places:,} places are taken: try again when somebody has left")
            tier = self._tier_of(state)
            bench = self._bench(tier)
            lane, known = bench.enter(pupil.learner, pupil.credit, state)
            pupil.bench, pupil.lane, pupil.known = bench, lane, known
            self._taken += 1
        return pupil

    def _tier_of(self, state: State) -> int:
        for tier, programs in enumerate(self._programs):
            if programs.holds(state):
                return tier
        raise UserError("a state with this room was learned in no classroom")

    def _bench(self, tier: int) -> Bench:
        benches = self._benches[tier]
        found = next((bench for bench in benches if bench.free), None)
        if found is None:
            found = Bench(self._tiers[tier], self._learner, self._credit, self._programs[tier])
            benches.append(found)
        return found

    def _width(self, room: tuple[int, int]) -> int:
        """Lanes of a block with this room: enough for all, unless that were too large."""
        most = BENCH_BYTES // (16 * self._learner.action_size * max(room) ** 2)
        return min(lanes_for(self.places), MOST, max(LEAST, 1 << (most.bit_length() - 1)))
