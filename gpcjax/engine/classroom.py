"""Many sessions in one process, each learner a lane of a block that others share.

Every step of all that are due is one call of a program, and so is every correction. A pupil whose dictionary is full
moves to the block of the next room before the correction that may not fit: a matter of its own counts, as in a pool
(`gpcjax.engine.pool`). Blocks have 8 lanes or more, a power of two, so that the bits of a lane do not depend on who
else is there: the recording of a session here is made again in a classroom with one pupil.

Methods may be called from several threads. Of each pupil one thing happens at a time, which its caller sees to; the
steps of others do not wait for a correction.
"""

import functools
import threading
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from gpcjax.engine import streams
from gpcjax.engine.bench import Bench, Known, Programs, Standing
from gpcjax.engine.desk import Advised, Desk
from gpcjax.engine.history import Credit
from gpcjax.engine.pool import Tier
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State

ROOMS = ((64, 64), (128, 256), (256, 512), (1024, 1024))
"""Points of each policy and each human model, as dictionaries grow. Human models only append and outgrow policies.

A correction of GPC takes 7 ms with the last, 0.1 ms with the first; few of them, as each costs seconds to compile.
"""

LEAST, BENCH_BYTES = 8, 1 << 28
"""Lanes of a block at least, and bytes of what is learned in one at most: beyond that there are more of them."""


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
    ) -> "Pupil":
        """Gives a free place to a learner of this structure, with `state` or untaught.

        Raises:
            UserError: there is none.
        """
        if state is None:
            state = learner.init(streams.first_key(seed))
        return self._place(Pupil(self, learner, seed, credit), state)

    def leave(self, pupil: "Pupil") -> None:
        """Gives its place back."""
        with self.lock:
            pupil.bench.leave(pupil.lane)
            self._taken -= 1

    def promote(self, pupil: "Pupil") -> bool:
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

    def _place(self, pupil: "Pupil", state: State) -> "Pupil":
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
        return min(lanes_for(self.places), max(LEAST, 1 << (most.bit_length() - 1)))


class Pupil(Desk):
    """One learner in a classroom, and where it stands: a `Desk` that moves itself."""

    def __init__(self, classroom: Classroom, learner: Learner, seed: int, credit: Credit | None):
        self.learner, self.seed, self.credit = learner, seed, credit
        self._classroom, self.lock = classroom, classroom.lock
        self.bench: Bench
        self.lane: int
        self.known: Known
        self._episode = self._time = 0
        self._obs, self._action = np.zeros(learner.obs_size), np.zeros(learner.action_size)
        self._depth = 0 if credit is None else credit.reach
        self._past_obs = np.zeros((self._depth, learner.obs_size))
        self._past_action = np.zeros((self._depth, learner.action_size))

    @property
    def episode(self) -> int:
        return self._episode

    @property
    def time(self) -> int:
        return self._time

    @property
    def obs(self) -> Float[np.ndarray, " obs"]:
        return self._obs.copy()

    @property
    def action(self) -> Float[np.ndarray, " action"]:
        return self._action.copy()

    @property
    def idle_is_due(self) -> bool:
        every = self.learner.idle_every
        return bool(every) and (self._time + 1) % every == 0

    def idled(self) -> "Pupil":
        idle([self])
        return self

    def stepped(
        self, obs: Float[np.ndarray, " obs"], begins: bool, another: bool
    ) -> "tuple[Pupil, Float[np.ndarray, ' action'], bool]":
        ((proposed,), (finite,)) = propose([self], obs[None])
        if finite:
            self.move(obs, proposed.clip(-1.0, 1.0), begins, another)
        return self, proposed, bool(finite)

    def move(
        self,
        obs: Float[np.ndarray, " obs"],
        action: Float[np.ndarray, " action"],
        begins: bool,
        another: bool,
    ) -> None:
        """To the next step, at which this is executed."""
        if self._depth and not begins:
            place = self._time % self._depth
            self._past_obs[place], self._past_action[place] = self._obs, self._action
        self._obs, self._action = obs, action
        self._time = 0 if begins else self._time + 1
        self._episode += another

    def executed(self, action: Float[np.ndarray, " action"]) -> "Pupil":
        self._action = np.array(action)
        return self

    def advised(
        self, advice: Float[np.ndarray, " action"], about: Float[np.ndarray, " obs"] | None = None
    ) -> "tuple[Pupil, Advised]":
        with self.lock:
            while not self.known.room and self._classroom.promote(self):
                pass
            at = self._obs if about is None else about
            counts = np.array([self.lane, self.seed, self._episode, self._time])
            now = np.concatenate([self._obs, self._action, advice, at])
            learned = self.bench.correct(Standing(counts, now, self._past_obs, self._past_action))
            self.known = learned.known
        return self, Advised(learned.info, learned.corrections, learned.before, learned.after)

    def taken_back(self, before: Any) -> "Pupil":
        raise UserError("in a classroom nothing that was learned is taken back")

    def acts(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        return np.array(self.bench.acts_at(self.lane, obs[:, None])[:, 0])

    def acts_at(self, obs: Float[np.ndarray, "obs points"]) -> Float[np.ndarray, "action points"]:
        return np.array(self.bench.acts_at(self.lane, obs))

    def uncertain(self) -> Float[np.ndarray, " action"]:
        with self.lock:
            return self.bench.uncertain(self.lane, self._obs, self._action)

    @property
    def state(self) -> State:
        with self.lock:
            return self.bench.state(self.lane)

    @property
    def points(self) -> tuple[int, int]:
        return self.known.points

    def measured(self) -> dict[str, float]:
        return dict(self.known.measured)

    def place(self) -> dict[str, Any]:
        history = None
        if self._depth:
            history = {"obs": self._past_obs.tolist(), "action": self._past_action.tolist()}
        return {
            "episode": self._episode,
            "time": self._time,
            "obs": self._obs.tolist(),
            "action": self._action.tolist(),
            "history": history,
        }

    def placed(self, place: Mapping[str, Any]) -> "Pupil":
        def like(values: Any, array: np.ndarray) -> np.ndarray:
            numbers = np.array(values, array.dtype)
            if numbers.shape != array.shape or not np.isfinite(numbers).all():
                raise ValueError("another shape, or what is no number")
            return numbers

        if self._depth:
            self._past_obs = like(place["history"]["obs"], self._past_obs)
            self._past_action = like(place["history"]["action"], self._past_action)
        self._obs, self._action = like(place["obs"], self._obs), like(place["action"], self._action)
        self._episode, self._time = int(place["episode"]), int(place["time"])
        return self

    def warm_up(self, ahead: bool) -> None:
        self._classroom.compile(None if ahead else 1)

    def leave(self) -> None:
        """Gives its place back."""
        self._classroom.leave(self)


def propose(
    pupils: Sequence[Pupil], observations: Float[np.ndarray, "pupils obs"]
) -> tuple[Float[np.ndarray, "pupils action"], Bool[np.ndarray, " pupils"]]:
    """What the policies of pupils of one classroom propose at their observations, before it is clipped.

    Gives with each whether it is a number. Nobody moves.
    """
    actions = np.zeros((len(pupils), pupils[0].learner.action_size if pupils else 0))
    finite = np.zeros(len(pupils), bool)
    for bench, members in _by_bench(pupils).items():
        lanes = [pupils[index].lane for index in members]
        obs = np.zeros((observations.shape[1], bench.tier.lanes))
        obs[:, lanes] = observations[members].T
        proposed, sound = bench.propose(obs)
        actions[members], finite[members] = proposed[:, lanes].T, sound[lanes]
    return actions, finite


def idle(pupils: Sequence[Pupil]) -> None:
    """Lets the learners of these pupils of one classroom go on by themselves, at the end of their steps."""
    for bench, members in _by_bench(pupils).items():
        lanes = bench.tier.lanes
        seeds, episodes, times = (np.zeros(lanes, kind) for kind in (np.int64, np.int32, np.int32))
        waiting = np.zeros(lanes, bool)
        for index in members:
            pupil = pupils[index]
            seeds[pupil.lane], episodes[pupil.lane] = pupil.seed, pupil.episode
            times[pupil.lane], waiting[pupil.lane] = pupil.time, True
        with pupils[members[0]].lock:
            bench.idle(seeds, episodes, times, waiting)
            for index in members:
                pupils[index].known = bench.known(pupils[index].lane)


def _by_bench(pupils: Sequence[Pupil]) -> dict[Bench, list[int]]:
    groups: dict[Bench, list[int]] = {}
    for index, pupil in enumerate(pupils):
        groups.setdefault(pupil.bench, []).append(index)
    return groups
