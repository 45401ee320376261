"""A lane's bits depend on the lane alone: neighbours, place, order, chunks, promotion and refill change nothing."""

import dataclasses
import itertools
import random

import equinox as eqx
import numpy as np
import pytest

from gpcjax.engine import block as block_module
from gpcjax.engine import pool as pool_module
from gpcjax.engine.lanes import Phase
from gpcjax.envs.base import Env
from gpcjax.envs.host import HostEnv
from gpcjax.learners.base import Status
from tests.engine.tasks import EPISODES, TIERS, Drift, coins_at, kept, plain, run, starts
from tests.engine.test_cost import no_block_is_copied, no_lane_is_much_more_than_its_factors
from tests.engine.test_keeping import Grows, observe, short_chunks
from tests.trees import assert_same_bits


def assert_the_same_runs(got, expected):
    for name, lane in got.items():
        assert_same_bits(kept(lane), kept(expected[name]))


class Bits:
    """What holds for each learner. Each has a class, whose blocks are compiled once."""

    algo: str
    env: Env | HostEnv = Drift()
    compiled: int
    """Programs, when all runs were through for the first time: going on from a snapshot has some of its own."""

    def test_the_runs_are_worth_comparing(self, pool, together):
        """They pass through every tier, end at different times and for different reasons, and learn."""
        statuses = {lane.status.item() for lane in together.values()}
        assert statuses == ({Status.OK} if self.algo == "coach" else {Status.OK, Status.FULL})
        assert len({lane.rows.returns.tobytes() for lane in together.values()}) == len(together)
        assert len({lane.rows.length.tobytes() for lane in together.values()}) > 3
        assert together[6].log.count > 100 and together[5].log.count < 20
        assert len(together) > pool._blocks[0].tier.lanes
        if self.algo != "coach":
            reached = {
                lane.state.policy.points.shape[1:2] + lane.state.human.points.shape[1:2]
                for lane in together.values()
            }
            assert reached == {(tier.policy_capacity, tier.human_capacity) for tier in TIERS[self.algo]}
            assert any(lane.log.outcome[:, 1].any() for lane in together.values())

    def test_the_same_seed_repeats(self, pool, together):
        assert_the_same_runs(run(pool, starts(self.algo)), together)

    def test_seeds_differ(self, together):
        """Runs 0 and 1 differ in the seed alone."""
        first, second = together[0], together[1]
        for name in ("returns", "corrections"):
            assert (getattr(first.rows, name) != getattr(second.rows, name)).any()
        assert (first.log.moments[:10] != second.log.moments[:10]).any()
        assert not (first.log.values[:10] == second.log.values[:10])[:, 0].all()

    def test_a_seed_means_the_same_coins_for_every_teacher(self, together):
        """Advice comes only where the coin of (seed, episode, step, dimension) is below the chance."""
        for each in starts(self.algo):
            log = together[each.name].log
            drawn = np.asarray(coins_at(each.seed, log.moments[:, 0], log.moments[:, 1], 2))
            heard = drawn[np.arange(log.count), log.moments[: log.count, 2]]
            assert (heard < each.teacher.rate).all() and len(heard)

    def test_against_a_plain_loop(self, pool, together):
        """Until rounding errors have grown: the first episode and its corrections, through all tiers."""
        each, lane = starts(self.algo)[1], together[1]
        expected = plain(self.env, each, pool._blocks[-1].tier, episodes=1)
        assert expected.rows["corrections"][0] > 10
        for name, values in expected.rows.items():
            np.testing.assert_allclose(getattr(lane.rows, name)[0], values[0], rtol=1e-9, err_msg=name)
        for name, values in expected.log.items():
            np.testing.assert_allclose(
                getattr(lane.log, name)[: len(values)], values, rtol=1e-9, err_msg=name
            )

    def test_alone(self, pool, together):
        for each in starts(self.algo):
            assert_the_same_runs(run(pool, [each]), together)

    @pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
    def test_in_another_order_and_place(self, pool, together, seed):
        """With copies of other runs before it, so that every run is met at several places."""
        shuffled = starts(self.algo) + [
            dataclasses.replace(each, name=(each.name, "copy")) for each in starts(self.algo)
        ]
        random.Random(seed).shuffle(shuffled)
        for name, lane in run(pool, shuffled).items():
            assert_same_bits(kept(lane), kept(together[name[0] if isinstance(name, tuple) else name]))

    @pytest.mark.parametrize("seconds", [1e-9, 1e9], ids=["short", "long"])
    def test_chunks_of_other_lengths(self, pool, together, monkeypatch, seconds):
        for loop in tuple(block_module.CHUNK_SECONDS):
            monkeypatch.setitem(block_module.CHUNK_SECONDS, loop, seconds)
        before = pool.counters.chunks
        again = run(pool, starts(self.algo))
        assert_the_same_runs(again, together)
        assert pool.counters.chunks > before

    def test_started_late(self, pool, together):
        """Backwards: what began first takes a place that becomes free, beside lanes that are under way."""
        waiting, begun = starts(self.algo), {}

        def backwards():
            while waiting:
                begun[waiting[-1].name] = pool.counters.chunks
                yield waiting.pop()

        before = pool.counters.chunks
        assert_the_same_runs(run(pool, backwards()), together)
        assert begun[10] == before < begun[0]

    def test_beside_a_broken_neighbour(self, pool, together):
        """A neighbour whose numbers become infinite stops by itself, and what it leaves behind does no harm."""
        field = (
            (lambda learner: learner.magnitude)
            if self.algo == "coach"
            else (lambda learner: learner.constant_rate)
        )
        broken = []
        for index, each in enumerate(starts(self.algo)[:3]):
            infinite = eqx.tree_at(field, each.learner, np.full_like(field(each.learner), np.inf))
            broken.append(dataclasses.replace(each, name=("broken", index), learner=infinite))
        lanes = run(pool, [item for pair in zip(broken, starts(self.algo)[:3], strict=True) for item in pair])
        for index in range(3):
            lane = lanes.pop(("broken", index))
            assert lane.status == Status.NON_FINITE
            assert lane.rows.corrections.sum() == 0 < lane.log.count and np.isnan(lane.rows.returns[0])
        assert_the_same_runs(lanes, together)

    def test_one_compilation_of_each_program(self, pool, together):
        """One to begin a run, and for each tier one to advance and, but for the first, one to promote into it."""
        assert self.compiled == 1 + len(pool._blocks) + len(pool._blocks) - 1
        before = pool.counters.compilations
        run(pool, starts(self.algo)[::-1])
        assert pool.counters.compilations == before

    def test_counters(self, pool, together):
        before = dataclasses.replace(pool.counters)
        lanes = run(pool, starts(self.algo))
        steps = sum(int(lane.rows.length.sum()) for lane in lanes.values())
        assert pool.counters.env_steps - before.env_steps == steps
        assert pool.counters.episodes - before.episodes == EPISODES * len(lanes)
        promoted = pool.counters.promotions - before.promotions
        assert promoted == 0 if self.algo == "coach" else promoted > 4
        assert all(not block.work for block in pool._blocks)
        assert pool.counters.compile_seconds > 0

    def test_finished_lanes_are_on_the_host(self, together):
        lane = together[0]
        assert isinstance(lane.rows.returns, np.ndarray) and lane.rows.returns.shape == (EPISODES,)
        assert lane.phase == Phase.FINISHED and lane.episode == EPISODES
        assert lane.seed.shape == () and not lane.waiting


@pytest.fixture(scope="class")
def observed(request, pool, together):
    """The lanes of a run, and the snapshots of it."""
    with short_chunks(pool._blocks):
        return observe(pool, request.cls.starts())


class TestGPC(Bits, Grows):
    """Of its blocks it is also seen what they cost, and that runs go on from snapshots."""

    algo, tiers = "gpc", TIERS["gpc"]
    starts = staticmethod(lambda: starts("gpc"))

    def test_no_block_is_copied(self, pool, together):
        no_block_is_copied(pool)

    def test_bytes_of_a_lane(self, pool, together):
        no_lane_is_much_more_than_its_factors(pool)


@pytest.mark.slow
class TestGPCNS(Bits):
    algo = "gpc-ns"


@pytest.mark.slow
class TestCOACH(Bits):
    algo = "coach"


class TestTiers:
    def test_a_learner_that_normalises_begins_where_others_get_to(self):
        assert pool_module.tiers(1024, normalises=True) == pool_module.tiers(1024)[1:]

    @pytest.mark.parametrize("normalises", [False, True])
    def test_the_last_one_is_exactly_the_bound(self, normalises):
        for bound in (1, 31, 32, 33, 64, 100, 150, 1000, 1024, 3000):
            chosen = pool_module.tiers(bound, normalises=normalises)
            assert (chosen[-1].policy_capacity, chosen[-1].human_capacity) == (bound, bound)
            sizes = [(tier.policy_capacity, tier.human_capacity) for tier in chosen]
            assert sizes == sorted(set(sizes))
            for smaller, larger in itertools.pairwise(sizes):
                assert smaller[0] <= larger[0] and smaller[1] <= larger[1]
            assert all(tier.lanes >= 1 for tier in chosen)

    @pytest.mark.parametrize("lanes", [0, 4, 12])
    def test_a_width_that_vectors_do_not_fill_is_refused(self, lanes):
        with pytest.raises(ValueError, match=f"a block of {lanes} lanes: give a power of two, 8 or more"):
            block_module.Tier(8, 8, lanes)

    @pytest.mark.parametrize("normalises", [False, True])
    def test_those_below_are_the_same_tiers_cut_at_the_bound(self, normalises):
        """So that a larger bound changes nothing for runs that stay in the tiers below it."""
        large = pool_module.tiers(4096, normalises=normalises)
        for bound in (64, 200, 512, 1024):
            few = pool_module.tiers(bound, normalises=normalises)
            for small, tier in zip(few[:-1], large, strict=False):
                assert small.capacities == tuple(min(room, bound) for room in tier.capacities)
                assert small.lanes == tier.lanes
