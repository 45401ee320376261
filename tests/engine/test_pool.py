"""A lane's bits depend on the lane alone: neighbours, place, order, chunks, promotion and refill change nothing."""

import dataclasses
import random

import equinox as eqx
import numpy as np
import pytest

from gpcjax.engine import pool as pool_module
from gpcjax.engine.lanes import Phase
from gpcjax.learners.base import Status
from tests.engine import tasks
from tests.engine.tasks import COACH_TIERS, EPISODES, TIERS, Drift, kept, make_pool, run, starts
from tests.trees import assert_same_bits

# All tests of one learner in one process: its blocks are compiled once.
each_algorithm = pytest.mark.parametrize(
    "algo",
    [pytest.param(algo, marks=pytest.mark.xdist_group(f"pool-{algo}")) for algo in tasks.ALGORITHMS],
    scope="module",
)


@pytest.fixture(scope="module")
def pool(algo):
    return make_pool(Drift(), starts(algo)[0], COACH_TIERS if algo == "coach" else TIERS)


@pytest.fixture(scope="module")
def together(algo, pool):
    """Every run of `starts`, side by side; more than the first block has places."""
    return run(pool, starts(algo))


def assert_the_same_runs(got, expected):
    for name, lane in got.items():
        assert_same_bits(kept(lane), kept(expected[name]))


@each_algorithm
class TestBits:
    def test_the_runs_are_worth_comparing(self, algo, pool, together):
        """They pass through every tier, end at different times, and learn."""
        assert {lane.status.item() for lane in together.values()} == {Status.OK}
        assert all((lane.rows.length > 0).all() for lane in together.values())
        lengths = [tuple(lane.rows.length) for lane in together.values()]
        assert len(set(lengths)) == len(lengths)
        assert together[6].log.count > 100 and together[5].log.count < 20
        assert len(together) > pool._blocks[0].tier.lanes
        if algo != "coach":
            reached = {lane.state.policy.points.shape[1:2] + lane.state.human.points.shape[1:2] for lane in together.values()}
            assert reached == {(tier.policy_capacity, tier.human_capacity) for tier in TIERS}
            assert any(lane.log.outcome[:, 1].any() for lane in together.values())

    def test_the_same_seed_repeats(self, algo, pool, together):
        assert_the_same_runs(run(pool, starts(algo)), together)

    def test_seeds_differ(self, algo, together):
        """Runs 0 and 1 differ in the seed alone."""
        first, second = together[0], together[1]
        for name in ("returns", "corrections"):
            assert (getattr(first.rows, name) != getattr(second.rows, name)).any()
        assert (first.log.where[:10] != second.log.where[:10]).any()
        assert not (first.log.values[:10] == second.log.values[:10])[:, 0].all()

    def test_teachers_share_the_starts_and_coins_of_a_seed(self, together):
        """Runs 0, 3 and 4 have one seed: the first episode starts alike, and no one hears of what another's coin forbids."""
        assert together[0].env.obs.tolist() != together[1].env.obs.tolist()
        heard = [{tuple(row) for row in lane.log.where[: lane.log.count] if row[0] == 0} for lane in together.values()]
        steps = {step for _, step, _ in heard[0]}
        assert len(heard[3]) > len(heard[0]) > len(heard[4]) and steps

    def test_alone(self, algo, pool, together):
        for each in starts(algo):
            assert_the_same_runs(run(pool, [each]), together)

    @pytest.mark.parametrize("seed", range(3))
    def test_in_another_order_and_place(self, algo, pool, together, seed):
        """With copies of other runs before it, so that every run is met at several places."""
        shuffled = starts(algo) + [dataclasses.replace(each, name=(each.name, "copy")) for each in starts(algo)]
        random.Random(seed).shuffle(shuffled)
        for name, lane in run(pool, shuffled).items():
            assert_same_bits(kept(lane), kept(together[name[0] if isinstance(name, tuple) else name]))

    @pytest.mark.parametrize("seconds", [1e-9, 1e9], ids=["short", "long"])
    def test_chunks_of_other_lengths(self, algo, pool, together, monkeypatch, seconds):
        monkeypatch.setattr(pool_module, "CHUNK_SECONDS", seconds)
        before = pool.counters.chunks
        again = run(pool, starts(algo))
        assert_the_same_runs(again, together)
        assert pool.counters.chunks > before

    def test_started_late(self, algo, pool, together):
        """Backwards: what began first takes a place that becomes free, beside lanes that are under way."""
        waiting, begun = starts(algo), {}

        def backwards():
            while waiting:
                begun[waiting[-1].name] = pool.counters.chunks
                yield waiting.pop()

        before = pool.counters.chunks
        assert_the_same_runs(run(pool, backwards()), together)
        assert begun[6] == before < begun[0]

    def test_beside_a_broken_neighbour(self, algo, pool, together):
        """A neighbour whose numbers become infinite stops by itself, and what it leaves behind does no harm."""
        field = (lambda learner: learner.magnitude) if algo == "coach" else (lambda learner: learner.constant_rate)
        broken = []
        for index, each in enumerate(starts(algo)[:3]):
            infinite = eqx.tree_at(field, each.learner, np.full_like(field(each.learner), np.inf))
            broken.append(dataclasses.replace(each, name=("broken", index), learner=infinite))
        lanes = run(pool, [item for pair in zip(broken, starts(algo)[:3], strict=True) for item in pair])
        for index in range(3):
            lane = lanes.pop(("broken", index))
            assert lane.status == Status.NON_FINITE
            assert lane.rows.corrections.sum() == lane.log.count >= 1
        assert_the_same_runs(lanes, together)

    def test_one_compilation_of_each_program(self, algo, pool, together):
        """One to begin a run, and for each tier one to advance and, but for the first, one to promote into it."""
        count = 1 + len(pool._blocks) + len(pool._blocks) - 1
        assert pool.counters.compilations == count
        run(pool, starts(algo)[::-1])
        assert pool.counters.compilations == count

    def test_counters(self, algo, pool, together):
        before = dataclasses.replace(pool.counters)
        lanes = run(pool, starts(algo))
        steps = sum(int(lane.rows.length.sum()) for lane in lanes.values())
        assert pool.counters.env_steps - before.env_steps == steps
        assert pool.counters.episodes - before.episodes == EPISODES * len(lanes)
        promoted = pool.counters.promotions - before.promotions
        assert promoted == 0 if algo == "coach" else promoted > len(TIERS)
        assert all(not block.work for block in pool._blocks)
        assert pool.counters.compile_seconds > 0

    def test_finished_lanes_are_on_the_host(self, together):
        lane = together[0]
        assert isinstance(lane.rows.returns, np.ndarray) and lane.rows.returns.shape == (EPISODES,)
        assert lane.phase == Phase.FINISHED and lane.episode == EPISODES
        assert lane.seed.shape == () and not lane.waiting


class TestTiers:
    def test_the_last_one_is_exactly_the_bound(self):
        for bound in (1, 31, 32, 33, 64, 100, 1000, 1024, 3000):
            chosen = pool_module.tiers(bound)
            assert (chosen[-1].policy_capacity, chosen[-1].human_capacity) == (bound, bound)
            sizes = [(tier.policy_capacity, tier.human_capacity) for tier in chosen]
            assert sizes == sorted(set(sizes))
            for smaller, larger in zip(sizes, sizes[1:], strict=False):
                assert smaller[0] <= larger[0] and smaller[1] <= larger[1]
            assert all(1 <= tier.group <= tier.lanes for tier in chosen)

    def test_those_below_do_not_depend_on_the_bound(self):
        """So that a larger bound changes the bits of no run that never needed it."""
        small, large = pool_module.tiers(200), pool_module.tiers(1024)
        shared = [tier for tier in small if tier in large]
        assert list(large[: len(shared)]) == shared and len(shared) >= 3
