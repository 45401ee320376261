"""What the batched loop must not do, in counts and not in seconds: trace again, correct in vain, or copy blocks."""

import dataclasses
import re

import jax
import numpy as np
import pytest

from gpcjax.engine.pool import Finished, Pool, Start, Tier
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.learners.base import Learner
from gpcjax.learners.coach import COACH
from gpcjax.learners.factory import make_learner
from gpcjax.learners.gpc import GPC
from gpcjax.sweep.build import make_oracle

TIERS = Tier(16, 16, 8), Tier(48, 64, 8)
TRACED: list[str] = []
EXECUTED: list[int] = []


class Counting(Learner):
    """Tells when a correction is traced, and when one is computed."""

    def _correct(self, *given):
        TRACED.append("correct")
        jax.debug.callback(lambda: EXECUTED.append(1))
        return super()._correct(*given)


class CountingGPC(Counting, GPC):
    pass


class CountingCOACH(Counting, COACH):
    pass


def pool_of(learner, starts, episodes=2, tiers=TIERS, **teaching):
    """A pool on cart-pole, and as many starts of `learner`, with seeds from 0."""
    oracle = jax.tree.map(np.asarray, make_oracle("cartpole", "lqr", **teaching).oracle)
    numbers = jax.tree.map(np.asarray, learner)
    begun = [Start(name=seed, learner=numbers, teacher=oracle, seed=seed) for seed in range(starts)]
    env, expert = make_env("cartpole"), make_expert("cartpole", "lqr")
    return Pool(env=env, expert=expert, episodes=episodes, template=begun[0], tiers=tiers), begun


def finish(pool, starts):
    waiting, finished = iter(starts), list[Finished]()
    pool.run(lambda: next(waiting, None), finished.append)
    return [each.lane for each in finished]


@pytest.mark.parametrize(
    ("counting", "learner"),
    [
        (CountingCOACH, lambda: make_learner("coach", "cartpole")),
        pytest.param(
            CountingGPC, lambda: make_learner("gpc", "cartpole", capacity=16), marks=pytest.mark.slow
        ),
    ],
    ids=["coach", "gpc"],
)
def test_a_correction_is_computed_where_there_is_advice_and_nowhere_else(compiled_plainly, counting, learner):
    """Not for each lane, round or step; and nothing is traced once more for more runs."""
    plain = learner()
    learner = counting(**{field.name: getattr(plain, field.name) for field in dataclasses.fields(plain)})
    pool, starts = pool_of(learner, 24, tiers=TIERS[1:])
    TRACED.clear(), EXECUTED.clear()
    lanes = finish(pool, starts)
    jax.effects_barrier()
    corrections = sum(int(lane.rows.corrections.sum()) for lane in lanes)
    assert len(EXECUTED) == corrections > 100
    assert sum(int(lane.rows.length.sum()) for lane in lanes) > 3 * corrections
    traced = len(TRACED)
    assert 0 < traced <= 4
    finish(pool, starts[::-1])
    assert len(TRACED) == traced


@pytest.fixture(
    scope="module",
    params=[("gpc", TIERS[1:]), ("gpc", TIERS), ("gpc-ns", TIERS)],
    ids=lambda given: f"{given[0]}-{len(given[1])}",
)
def used(request):
    """A pool that has run through its tiers."""
    algo, tiers = request.param
    pool, starts = pool_of(make_learner(algo, "cartpole", capacity=16), 24, episodes=4, tiers=tiers)
    lanes = finish(pool, starts)
    assert {lane.state.human.points.shape[1] for lane in lanes} == {tier.human_capacity for tier in tiers}
    return pool


def no_block_is_copied(pool):
    """The matrices of all lanes are updated in place: a copy at each correction would cost more than all else."""
    for block in pool._blocks:
        text = block._programs["advance"].as_text()
        state = block.lanes.state
        matrices = [matrix for matrix in (state.policy.matrix, state.human.matrix) if matrix.size]
        assert matrices
        for matrix in matrices:
            shape = re.escape(f"f64[{','.join(map(str, matrix.shape))}]")
            assert re.search(shape, text)
            assert not re.search(rf"= {shape}\S* copy\(", text)


def no_lane_is_much_more_than_its_factors(pool):
    """A lane is little more than the two factors of each dimension of its action."""
    for block in pool._blocks:
        tier, actions = block.tier, block.lanes.action.shape[0]
        held = sum(leaf.nbytes for leaf in jax.tree.leaves(block.lanes)) / tier.lanes
        factors = 8 * (tier.policy_capacity**2 + tier.human_capacity**2)
        vectors = 8 * (tier.policy_capacity * 12 + tier.human_capacity * 8)
        log = 200 * (3 * 4 + 3 * 8 + 3)
        assert held < actions * (factors + vectors + 800) + log + 1100


@pytest.mark.slow
def test_no_block_is_copied(used):
    no_block_is_copied(used)


@pytest.mark.slow
def test_bytes_of_a_lane(used):
    no_lane_is_much_more_than_its_factors(used)


def test_no_lane_is_cut_out_where_learning_is_active():
    """Each look at sigma_h would copy all that a lane has learned, which took four times as long as all else."""
    pool, starts = pool_of(make_learner("gpc", "cartpole", capacity=16), 1, 1, TIERS[1:], active_gain=1.0)
    finish(pool, starts)
    (block,) = pool._blocks
    text, state = block._programs["advance"].as_text(), block.lanes.state
    for matrix in (state.policy.matrix, state.human.matrix):
        _, *one = matrix.shape
        assert f"f64[{','.join(map(str, matrix.shape))}]" in text
        for shape in (one, [1, *one], one[1:]):
            assert f"f64[{','.join(map(str, shape))}]" not in text
