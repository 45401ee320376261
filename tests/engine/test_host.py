"""The loop over a task on the host against a plain one, on recorded observations: rounding errors do not grow."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest

from gpcjax.engine import streams
from gpcjax.engine.lanes import LOGGED_CORRECTIONS
from gpcjax.engine.pool import Tier
from gpcjax.envs.host import Simulation
from gpcjax.learners.base import Status
from tests.engine.host_tasks import host_drift
from tests.engine.tasks import ALGORITHMS, TIERS, learner, make_pool, oracle, plain, run, start
from tests.engine.test_rollout import MANY, NARROW, agrees, ends_where_it_fails

RECORDED = host_drift(force=0.0)


@pytest.fixture(scope="module")
def coaches():
    """A pool for COACH on the recording, which has run: its programs are compiled."""
    first = start(0, learner("coach"), oracle(), 0)
    pool = make_pool(RECORDED, first, (NARROW,), MANY)
    run(pool, [first])
    return pool


@pytest.mark.parametrize(
    "algo", [algo if algo == "coach" else pytest.param(algo, marks=pytest.mark.slow) for algo in ALGORITHMS]
)
def test_against_a_plain_loop(algo, coaches):
    """With usual, wrong, quiet and busy teachers, GPC through two tiers; and the counters tell what was done."""
    tiers = TIERS[algo][-2:] if algo == "gpc" else TIERS[algo][-1:]
    settings = [
        (3, {}),
        (3, {"error": 0.5}),
        (4, {"rate": 0.2, "delta": 0.3}),
        (5, {"rate": 1.0, "delta": 0.0}),
    ]
    large_steps = (
        {"magnitude": 1.0} if algo == "coach" else {"constant_rate": 0.3, "on_full": "replace-nearest"}
    )
    starts = [
        start(index, learner(algo, **large_steps), oracle(**teaching), seed)
        for index, (seed, teaching) in enumerate(settings)
    ]
    pool = coaches if algo == "coach" else make_pool(RECORDED, starts[0], tiers, MANY)
    before = dataclasses.replace(pool.counters)
    lanes = run(pool, starts)
    for each in starts[1:]:  # the usual one is also among those that end where a number fails
        agrees(lanes[each.name], plain(RECORDED, each, tiers[-1], MANY))
    assert lanes[3].log.count == LOGGED_CORRECTIONS < lanes[3].rows.corrections.sum()
    assert lanes[1].rows.clipped.sum() > 0
    assert len({lane.rows.length.tobytes() for lane in lanes.values()}) == 3, (
        "seeds, not teachers, make lengths"
    )
    steps, episodes = (
        getattr(pool.counters, name) - getattr(before, name) for name in ("env_steps", "episodes")
    )
    assert steps == sum(lane.rows.length.sum() for lane in lanes.values())
    assert episodes == MANY * len(lanes)
    assert pool.counters.promotions >= (4 if algo == "gpc" else 0)


@pytest.mark.slow
def test_active_learning():
    """A chance that follows sigma_h, worked out where the coins allow advice."""
    teacher = oracle(rate=0.02, delta=0.0, error=0.1, active_gain=3.0)
    each, tier = start(0, learner("gpc", capacity=64), teacher, 1), Tier(64, 64, 8)
    lane = run(make_pool(RECORDED, each, (tier,)), [each])[0]
    agrees(lane, plain(RECORDED, each, tier))
    assert 0 < lane.rows.corrections.sum() < lane.rows.asked.sum() < lane.rows.length.sum()


def test_starts(coaches, monkeypatch):
    """Those of the seeds of a run, in order, in a simulation of its own; as many as there are episodes."""
    begun, reset = {}, Simulation.reset

    def recording(self, seed):
        begun.setdefault(self, []).append(seed)
        return reset(self, seed)

    monkeypatch.setattr(Simulation, "reset", recording)
    starts = [start(seed, learner("coach"), oracle(), seed) for seed in (0, 5, 7)]
    lanes = run(coaches, starts)
    complete = sorted(tuple(seeds) for seeds in begun.values())
    assert complete == sorted(tuple(streams.reset_seeds(seed, MANY)) for seed in (0, 5, 7))
    assert len({lane.rows.returns.tobytes() for lane in lanes.values()}) == 3


@pytest.mark.slow
def test_a_full_dictionary_ends_the_run_with_its_last_step_counted():
    each = start(0, learner("gpc", capacity=3, on_full="error"), oracle(rate=0.8, delta=0.0), 2)
    tier = Tier(3, 8, 8)
    lane, expected = run(make_pool(RECORDED, each, (tier,)), [each])[0], plain(RECORDED, each, tier)
    agrees(lane, expected)
    assert lane.status == Status.FULL
    last = np.flatnonzero(lane.rows.length).max()
    episode, step, _ = lane.log.moments[lane.log.count - 1]
    assert (last, lane.rows.length[last]) == (episode, step + 1)
    assert not lane.rows.length[last + 1 :].any()
    np.testing.assert_allclose(lane.rows.returns[last], expected.rows["returns"][last], rtol=1e-9)
    refused = lane.log.outcome[: lane.log.count, 2]
    assert refused.sum() == lane.rows.full[last] > 0 and not refused[:-2].any()


def test_what_is_no_number_ends_the_run(coaches):
    """At step 7 by an observation or a reward, or at the start of an episode; the learner keeps what it knew."""
    env = host_drift(force=0.0, fails_at=7)
    starts = [start(seed, learner("coach"), oracle(), seed) for seed in range(16)]
    pool = make_pool(env, starts[0], (NARROW,))
    (block,), (compiled,) = pool._blocks, coaches._blocks
    assert block._loop.compiled_in == compiled._loop.compiled_in
    block._programs = compiled._programs  # which know nothing of the task
    ends_where_it_fails(env, NARROW, starts, run(pool, starts))


def test_an_action_that_is_no_number_never_reaches_a_simulation(coaches, monkeypatch):
    starts = [start(seed, learner("coach"), oracle(), seed) for seed in range(2)]
    grid = eqx.tree_at(lambda learner: learner.grid.lower, starts[1].learner, np.full(2, np.nan))
    starts[1] = dataclasses.replace(starts[1], learner=grid)
    actions, step = [], Simulation.step
    monkeypatch.setattr(
        Simulation, "step", lambda self, action: (actions.append(action), step(self, action))[1]
    )
    lanes = run(coaches, starts)
    assert np.isfinite(actions).all() and lanes[0].status == Status.OK
    assert lanes[1].status == Status.NON_FINITE
    assert np.isnan(lanes[1].rows.returns[0]) and not lanes[1].rows.length.any()
