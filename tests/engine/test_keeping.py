"""What a run has learned is handed out while it goes on, and runs go on from snapshots: no bit of a row changes.

That of GPC, which passes through tiers, goes on in test_pool.py, and is kept for COACH in test_rollout.py: their blocks
are compiled anyway.
"""

import contextlib
import dataclasses
import json
import random

import equinox as eqx
import jax
import numpy as np
import pytest

from gpcjax.engine import block as block_module
from gpcjax.engine.history import Credit
from gpcjax.engine.keeping import Keep
from gpcjax.engine.lanes import Phase
from gpcjax.engine.pool import Pool, Tier
from gpcjax.engine.snapshots import FORMAT, NotResumed, Snapshot, pack, unpack
from gpcjax.envs.host import HostEnv
from gpcjax.learners.base import Status
from gpcjax.sweep import checkpoints
from gpcjax.teachers.oracle import synthesised
from tests.engine.host_tasks import GymDrift, host_drift
from tests.engine.tasks import Drift, expert, kept, learner, make_pool, oracle, run, start
from tests.trees import assert_same_bits

EPISODES = 5
SMALL, LARGE, NARROW = Tier(4, 4, 8), Tier(64, 64, 8), Tier(1, 1, 8)
EVERY = 2


def late(name, learner, seed):
    """A teacher that looks away at times, fades, and speaks of earlier steps; its advice is spread over several."""
    teacher = synthesised(
        rate=0.5, error=0.1, delta=0.02, delay=0.2, attention=1.0, distraction=0.5, fading=0.01, time_step=0.1
    )
    credit = Credit.of(0.1, None, 2.0, 0.1)
    return dataclasses.replace(start(name, learner, teacher, seed), credit=jax.tree.map(np.asarray, credit))


def plain_starts(algo):
    """Some that learn fast, slowly, and until a dictionary is full; more than a block has places."""
    rates = [0.5, 0.5, 0.9, 0.05, 0.02, 0.3, 0.5, 0.7, 0.1, 0.01]
    return [start(index, learner(algo), oracle(rate=rate), index) for index, rate in enumerate(rates)]


@contextlib.contextmanager
def short_chunks(blocks=()):
    """A few rounds or steps each, so that the host looks often, from the next chunk of `blocks` on."""
    for block in blocks:
        block._rounds = 4
    with pytest.MonkeyPatch.context() as patch:
        for loop in tuple(block_module.CHUNK_SECONDS):
            patch.setitem(block_module.CHUNK_SECONDS, loop, 1e-9)
        yield


@pytest.fixture(scope="module", autouse=True)
def chunks():
    with short_chunks():
        yield


@pytest.fixture(scope="class")
def pool(request, chunks):
    """For the task, the learner and the tiers of the class."""
    case = request.cls
    if case.as_shipped:
        request.getfixturevalue("class_compiled_as_shipped")
    return make_pool(case.env, case.starts()[0], case.tiers, EPISODES)


@pytest.fixture(scope="class")
def observed(request, pool):
    return observe(pool, request.cls.starts())


def observe(pool, starts):
    """The lanes of a run that nothing disturbs, and the snapshots between all of its chunks."""
    snapshots, lanes, waiting = [], {}, iter(starts)
    pool.run(
        lambda: next(waiting, None),
        lambda finished: lanes.update({finished.name: finished.lane}),
        lambda: snapshots.append(pool.snapshot()),
    )
    return lanes, [each for each in snapshots if each]


class Case:
    """A task, learners and teachers; each case has a class, whose pools are compiled once."""

    env, tiers, episodes, as_shipped = Drift(), (SMALL, LARGE), EPISODES, False

    @staticmethod
    def starts():
        raise NotImplementedError

    def go_on(self, pool, snapshots, others=()):
        """The lanes of runs that go on from what a checkpoint would have kept of them, with others beside them."""
        arrays, card = pack(snapshots)
        card, names = json.loads(json.dumps(card)), [each.name for each in snapshots]
        resumed = [pool.resume(each) for each in unpack(arrays, card, names, pool.shapes)]
        coming = [*resumed, *others]
        random.Random(0).shuffle(coming)
        return run(pool, coming)

    def agrees(self, lanes, expected):
        assert lanes
        for name, lane in lanes.items():
            assert_same_bits(kept(lane), kept(expected[name]))


class GoesOn(Case):
    """What holds of any snapshot."""

    def test_from_any_moment(self, pool, observed):
        """Some runs from the middle, some from the start, whatever else is in the pool."""
        lanes, snapshots = observed
        assert len(snapshots) > 8
        for seed in range(2):
            chosen = random.Random(seed)
            taken = chosen.choice(snapshots)
            half = chosen.sample(taken, max(1, len(taken) // 2))
            begun = [each for each in self.starts() if each.name not in {run.name for run in half}]
            again = self.go_on(pool, half, begun)
            assert len(again) == len(lanes)
            self.agrees(again, lanes)

    def test_twice_in_a_row(self, pool, observed):
        lanes, snapshots = observed
        resumed = iter([pool.resume(each) for each in snapshots[2]])
        later = []
        with short_chunks(pool._blocks):
            pool.run(
                lambda: next(resumed, None), lambda finished: None, lambda: later.append(pool.snapshot())
            )
        for taken in (later[0], later[3]):
            self.agrees(self.go_on(pool, taken), lanes)

    def test_what_is_packed_is_unpacked_to_the_bit(self, pool, observed):
        for taken in observed[1][:: len(observed[1]) // 3]:
            arrays, card = pack(taken)
            assert all(array.size for array in arrays.values())
            names = [each.name for each in taken]
            for got, given in zip(unpack(arrays, card, names, pool.shapes), taken, strict=True):
                assert_same_bits(got.lane, given.lane)
                assert (got.name, got.capacities) == (given.name, given.capacities)
                np.testing.assert_array_equal(got.executed, given.executed)
            if self.tiers[-1] == LARGE and any(each.capacities == (64, 64) for each in taken):
                held = sum(leaf.nbytes for each in taken for leaf in jax.tree.leaves(each.lane))
                assert sum(array.nbytes for array in arrays.values()) < 0.7 * held


class Keeps(Case):
    """What holds of all that is kept."""

    def test_keeping_changes_no_bit(self, pool, observed):
        """And what is kept is all that a run is at the end of that episode: from there it comes to the same end."""
        lanes, _ = observed
        starts, given = self.starts(), []
        keeping = Pool(self.env, expert, self.episodes, starts[0], self.tiers, Keep(every=EVERY, best=True))
        waiting, again = iter(starts), {}

        def deliver(finished):
            again[finished.name] = finished.lane
            given.append((finished.name, None, finished.lane))

        keeping.run(
            lambda: next(waiting, None),
            deliver,
            keep=lambda kept: given.append((kept.name, kept.episode, kept.lane)),
        )
        self.agrees(again, lanes)
        assert len(again) == len(lanes)
        middle = {}
        for name, lane in lanes.items():
            of_run = [(episode, lane) for other, episode, lane in given if other == name]
            assert of_run[-1][0] is None, "kept before it is delivered"
            assert [episode for episode, _ in of_run[:-1]] == expected_episodes(lane, self.episodes)
            for episode, at_end in of_run[:-1]:
                assert_same_bits(at_end.rows.returns[:episode], lane.rows.returns[:episode])
                assert not at_end.rows.length[episode:].any()
                if episode == EVERY:
                    middle[name] = at_end
        assert len(middle) > 3
        self.agrees(self.go_on(pool, [self.at_its_start(*each) for each in middle.items()]), lanes)

    def at_its_start(self, name, lane):
        """The snapshot of a lane that has done nothing yet in its episode."""
        assert lane.phase == Phase.RUNNING and lane.env.time == 0 and lane.episode == EVERY
        sizes = {tier.policy_capacity: tier.capacities for tier in self.tiers}
        held = lane.state.policy.points.shape[1] if self.tiers[-1] is LARGE else 1
        executed = np.zeros((0, 2)) if isinstance(self.env, HostEnv) else None
        return Snapshot(name, lane, sizes[held], executed)


def expected_episodes(lane, episodes):
    """From 1: those of `EVERY`, and each that returned more than all before it, if the run did not stop within it."""
    best, expected = -np.inf, []
    complete = episodes if lane.status == Status.OK else int(np.flatnonzero(lane.rows.length).max())
    for index, value in enumerate(lane.rows.returns[:complete].tolist()):
        if value > best or (index + 1) % EVERY == 0:
            expected.append(index + 1)
        best = max(best, value)
    return expected


class Grows(GoesOn):
    """Where lanes pass through tiers."""

    def test_a_lane_that_waits_for_a_larger_block(self, pool, observed):
        lanes, snapshots = observed
        stuck = [[each for each in taken if each.lane.phase == Phase.NEEDS_ROOM] for taken in snapshots]
        stuck = [each for each in stuck if each]
        assert stuck and all(each.capacities == self.tiers[0].capacities for each in stuck[0])
        promoted = pool.counters.promotions
        self.agrees(self.go_on(pool, stuck[0]), lanes)
        assert pool.counters.promotions == promoted, "it was counted when it left"


@pytest.mark.slow
class TestGPC(Grows, Keeps):
    starts = staticmethod(lambda: plain_starts("gpc"))


@pytest.mark.slow
class TestGPCAsShipped(TestGPC):
    """Also where XLA does its best."""

    as_shipped = True


def late_starts():
    return [late(index, learner("coach"), index) for index in range(10)]


class TestLateOnHost(GoesOn, Keeps):
    env, tiers, starts = host_drift(), (NARROW,), staticmethod(late_starts)

    @pytest.mark.slow
    def test_twice_in_a_row(self, pool, observed):
        super().test_twice_in_a_row(pool, observed)

    @pytest.mark.slow
    def test_keeping_changes_no_bit(self, pool, observed):
        super().test_keeping_changes_no_bit(pool, observed)

    def test_a_simulation_that_does_not_replay_is_named(self, pool, observed, monkeypatch):
        taken = next(each for each in observed[1][1:] if any(run.lane.env.time > 1 for run in each))
        snapshot = next(each for each in taken if each.lane.env.time > 1)
        assert len(snapshot.executed) == snapshot.lane.env.time
        for changed in (snapshot.executed[:-1], snapshot.executed * 0.5, np.tile(snapshot.executed, (40, 1))):
            with pytest.raises(NotResumed, match="does not come to the same observation"):
                pool.resume(dataclasses.replace(snapshot, executed=changed))
        step = GymDrift.step

        def paid_more(env, action):
            obs, reward, *others = step(env, action)
            return obs, reward + 1e-9, *others

        monkeypatch.setattr(GymDrift, "step", paid_more)
        with pytest.raises(NotResumed, match="does not come to the same observation"):
            pool.resume(snapshot)

    def test_what_fits_another_pool_is_named(self, pool, observed):
        snapshot = observed[1][0][0]
        other = dataclasses.replace(snapshot, capacities=(5, 5))
        with pytest.raises(NotResumed, match="room for"):
            pool.resume(other)
        lane = eqx.tree_at(lambda lane: lane.action, snapshot.lane, np.zeros(3))
        with pytest.raises(NotResumed, match=r"another structure \(action\)"):
            pool.resume(dataclasses.replace(snapshot, lane=lane))
        arrays, card = pack([snapshot])
        for broken in (
            {**card, "format": FORMAT - 1},
            {**card, "groups": []},
            {**card, "groups": [{**card["groups"][0], "leaves": {}}]},
        ):
            with pytest.raises(NotResumed):
                unpack(arrays, broken, [0], pool.shapes)
        for name in (".seed", ".env.obs"):
            missing = {key: value for key, value in arrays.items() if key != f"0{name}"}
            with pytest.raises(NotResumed, match="do not fit"):
                unpack(missing, card, [0], pool.shapes)


@pytest.mark.parametrize("numbers", [{"every": 0}, {"every": -1}, {"every": -1, "best": True}])
def test_a_keep_of_nothing_is_refused(numbers):
    with pytest.raises(ValueError, match="give episodes to keep"):
        Keep(**numbers)


def test_checkpoints_name_the_format_of_what_is_in_them():
    """So that those of another version go without a line for each of their runs."""
    assert checkpoints.SNAPSHOTS == FORMAT
    assert checkpoints.told({}, "", None)["snapshots"] == FORMAT
