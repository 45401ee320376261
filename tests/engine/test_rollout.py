"""The batched loop against a plain one, on recorded observations: rounding errors do not grow, so all is compared."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.engine.lanes import LOGGED_CORRECTIONS
from gpcjax.engine.pool import Tier
from gpcjax.learners.base import Status
from gpcjax.teachers.oracle import Oracle
from tests.engine.tasks import EPISODES, Drift, coins_at, kept, learner, make_pool, oracle, plain, run, start
from tests.engine.test_keeping import Keeps, observe, short_chunks
from tests.trees import assert_same_bits

RECORDED = Drift(force=0.0)
TOLERANCE = 1e-8
MANY = 6
"""Episodes, until the log of a run with a busy teacher is full."""
NARROW = Tier(1, 1, 8)
"""For COACH, which has no dictionary."""


def agrees(lane, expected, tolerance=TOLERANCE):
    """Rows, corrections, status and the policy that was learned."""
    assert lane.status == expected.status
    for name, values in expected.rows.items():
        np.testing.assert_allclose(getattr(lane.rows, name), values, atol=tolerance, rtol=0, err_msg=name)
    assert lane.log.count == len(expected.log["moments"])
    for name, values in expected.log.items():
        got = getattr(lane.log, name)
        np.testing.assert_allclose(got[: len(values)], values, atol=tolerance, rtol=0, err_msg=name)
        assert not got[len(values) :].any()
    for obs in np.array([[0.3, -0.2], [-1.0, 0.5]]):
        idle, learned, plainly, kept_beside = actions(lane, expected.state, obs)
        np.testing.assert_allclose(learned, kept_beside, atol=1e-12)
        np.testing.assert_allclose(learned, plainly, atol=tolerance)
        assert np.abs(learned - idle).max() > 1e-6


@eqx.filter_jit
def _actions(lane, state, obs):
    controllers = [lane.learner.controller(each) for each in (lane.learner.init(), lane.state, state)]
    return [controller(obs) for controller in (*controllers, lane.controller)]


def actions(lane, state, obs):
    """Of a policy that learned nothing, of the learned one, of that in `state`, and of the lane's own controller."""
    return [np.asarray(each) for each in _actions(jax.tree.map(jnp.asarray, lane), state, obs)]


def steady(rate=0.5, **numbers):
    """A teacher whose chance is the same in all episodes, as a schedule has it: one program is for all of COACH."""
    return oracle(schedule=(rate,) * 3, **numbers)


@pytest.fixture(scope="module")
def coaches():
    """A pool for COACH on the recording, whose program is compiled once."""
    return make_pool(RECORDED, start(0, learner("coach"), steady(), 0), (NARROW,), MANY)


@pytest.mark.parametrize(
    ("algo", "tier"),
    [
        pytest.param("gpc", Tier(64, 192, 8), marks=pytest.mark.slow),
        pytest.param("gpc-ns", Tier(64, 192, 8), marks=pytest.mark.slow),
        ("coach", NARROW),
    ],
)
def test_against_a_plain_loop(algo, tier, coaches):
    """With usual, wrong, quiet and busy teachers."""
    settings = [
        (3, {}),
        (3, {"error": 0.5}),
        (4, {"rate": 0.2, "delta": 0.3}),
        (5, {"rate": 1.0, "delta": 0.0}),
    ]
    large_steps, teacher = (
        ({"magnitude": 1.0}, steady) if algo == "coach" else ({"constant_rate": 0.3}, oracle)
    )
    starts = [
        start(index, learner(algo, tier.policy_capacity, **large_steps), teacher(**teaching), seed)
        for index, (seed, teaching) in enumerate(settings)
    ]
    lanes = run(coaches if algo == "coach" else make_pool(RECORDED, starts[0], (tier,), MANY), starts)
    for each in starts[1:]:  # the usual one is also beside those whose action is no number
        agrees(lanes[each.name], plain(RECORDED, each, tier, MANY))
    # The log is full where the teacher is busy, and goes no further.
    busy = lanes[3]
    assert busy.log.count == LOGGED_CORRECTIONS < busy.rows.corrections.sum()
    assert lanes[1].rows.clipped.sum() > 0


def each_episode_has_its_own_chance(env, make):
    """The last one for all that follow; and each lane has its own."""
    schedules = [(0.0, 0.9, 0.3), (0.6, 0.0, 1.0)]
    starts = [
        start(seed, learner("coach"), oracle(schedule=schedule, delta=0.0), seed)
        for seed, schedule in enumerate(schedules)
    ]
    lanes = run(make(starts[0]), starts)
    for each, schedule in zip(starts, schedules, strict=True):
        lane = lanes[each.name]
        agrees(lane, plain(env, each, NARROW, MANY))
        for episode in range(MANY):
            chance, length = (*schedule, *schedule[-1:] * MANY)[episode], int(lane.rows.length[episode])
            drawn = coins_at(each.seed, np.full(env.max_steps, episode), np.arange(env.max_steps), 2)
            below = np.asarray(drawn)[:length] < chance
            assert lane.rows.asked[episode] == below.any(1).sum()
            # An action that is the target is met with silence.
            assert (chance > 0) == (lane.rows.corrections[episode] > 0)
            assert lane.rows.corrections[episode] <= below.sum()
            np.testing.assert_allclose(lane.rows.chance_sum[episode], chance * lane.rows.asked[episode])


def test_a_schedule_gives_each_episode_its_own_chance(coaches):
    each_episode_has_its_own_chance(RECORDED, lambda first: coaches)


class TestKeeping(Keeps):
    """Of what the others run through, whose blocks keep nothing."""

    env, tiers, episodes = RECORDED, (NARROW,), MANY

    @staticmethod
    def starts():
        rates = (0.5, 0.5, 0.9, 0.05, 0.02, 0.3, 0.5, 0.7, 0.1, 0.01)
        return [start(index, learner("coach"), steady(rate), index) for index, rate in enumerate(rates)]


@pytest.fixture
def pool(coaches):
    return coaches


@pytest.fixture
def observed(request, pool):
    with short_chunks(pool._blocks):
        yield observe(pool, request.cls.starts())


class TestFull:
    """What a dictionary does that is full in the largest tier: nothing of it is silent."""

    TIER = Tier(3, 8, 8)

    def lane(self, on_full):
        each = start(0, learner("gpc", capacity=3, on_full=on_full), oracle(rate=0.8, delta=0.0), 2)
        lane = run(make_pool(RECORDED, each, (self.TIER,)), [each])[0]
        agrees(lane, plain(RECORDED, each, self.TIER))
        return lane

    @pytest.mark.slow
    def test_error_ends_the_run(self):
        lane = self.lane("error")
        assert lane.status == Status.FULL
        last = np.flatnonzero(lane.rows.length).max()
        assert last < EPISODES - 1
        assert lane.rows.full[last] > 0 and not lane.rows.full[:last].any()
        # The refused corrections are in the log, and are not counted as learned.
        refused = lane.log.outcome[: lane.log.count, 2]
        assert refused.sum() == lane.rows.full.sum() and not refused[:-2].any()
        assert lane.rows.corrections.sum() + refused.sum() == lane.log.count
        assert not lane.log.outcome[: lane.log.count][refused][:, :2].any()

    @pytest.mark.parametrize("on_full", ["replace-nearest", "drop"])
    @pytest.mark.slow
    def test_the_others_go_on(self, on_full):
        lane = self.lane(on_full)
        assert lane.status == Status.OK and (lane.rows.length > 0).all()
        assert lane.rows.full[1:].all()
        assert (lane.state.policy.count <= 3).all() and (lane.state.human.count <= 8).all()
        appended, replaced, full = lane.log.outcome[: lane.log.count].T
        assert full.sum() == lane.rows.full.sum()
        assert appended.sum() == lane.state.policy.count.sum()
        learned, rate = appended | replaced, lane.log.values[: lane.log.count, 0]
        assert ((rate > 0) == learned).all() and lane.rows.corrections.sum() == learned.sum()
        np.testing.assert_allclose(lane.rows.rate_sum.sum(), rate.sum())
        if on_full == "drop":  # neither model learns what one has no room for
            assert not (learned & full).any()
            assert (learned.sum() == lane.state.human.count.sum()) and lane.rows.corrections[-1] < full.sum()
        else:
            assert learned.all()


class Always(Oracle):
    """Works out the chance at every step: thinning must not be seen."""

    def may_advise(self, coins, largest_sigma, step):
        return jnp.ones_like(coins, bool)


def counted(lane):
    """The rows but for what thinning leaves out."""
    return {name: rows for name, rows in vars(lane.rows).items() if name not in ("asked", "chance_sum")}


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_as_shipped")
def test_active_learning():
    """Thinning changes nothing, to the bit; and a plain loop, which knows nothing of it, agrees."""
    tier, teaching = Tier(64, 64, 8), {"rate": 0.02, "delta": 0.0, "error": 0.1, "active_gain": 2.5}
    teachers, lanes = [oracle(kind, **teaching) for kind in (Oracle, Always)], []
    for teacher in teachers:
        each = start("active", learner("gpc", capacity=64), teacher, 1)
        lanes.append(run(make_pool(RECORDED, each, (tier,)), [each])["active"])
    thinned, always = ({**kept(lane), "teacher": None, "rows": counted(lane)} for lane in lanes)
    assert_same_bits(thinned, always)
    agrees(lanes[0], plain(RECORDED, dataclasses.replace(each, teacher=teachers[0]), tier))
    # The chances that thinning met are a fair sample of those of all steps.
    met, every = (lane.rows.chance_sum.sum() / lane.rows.asked.sum() for lane in lanes)
    assert lanes[1].rows.asked.sum() == lanes[1].rows.length.sum()
    assert lanes[0].rows.asked.sum() < 0.6 * lanes[1].rows.asked.sum()
    np.testing.assert_allclose(met, every, rtol=0.05)
    # Both bounds of the chance are far: it follows sigma_h, and some that thinning let pass were refused.
    rate = lanes[0].rows.corrections.sum() / (2 * lanes[0].rows.length.sum())
    largest = 0.02 + 2.5 * lanes[0].learner.largest_sigma()
    assert 0.1 < rate < 0.9 * largest


def ends_where_it_fails(env, tier, starts, lanes):
    """Each run at the first number that is none, as the plain loop, though the task itself would recover."""
    ends = set()
    for each in starts:
        lane, expected = lanes[each.name], plain(env, each, tier)
        assert lane.status == expected.status
        for name, values in expected.rows.items():
            np.testing.assert_allclose(getattr(lane.rows, name), values, atol=TOLERANCE, rtol=0, err_msg=name)
        assert np.isfinite(lane.controller.weights).all()
        if lane.status == Status.OK:
            assert np.isfinite(lane.rows.returns).all()
            continue
        assert lane.status == Status.NON_FINITE
        (last,) = np.flatnonzero(np.isnan(lane.rows.returns))
        assert not lane.rows.length[last + 1 :].any()
        ends.add((int(last), int(lane.rows.length[last])))
    assert len({episode for episode, _ in ends}) > 1 and {length for _, length in ends} == {0, 7}


def test_what_is_no_number_ends_the_run():
    """At step 7 by an observation or a reward, or at the start of an episode; the learner keeps what it knew."""
    env = Drift(force=0.0, fails_at=7)
    starts = [start(seed, learner("coach"), oracle(), seed) for seed in range(16)]
    ends_where_it_fails(env, NARROW, starts, run(make_pool(env, starts[0], (NARROW,)), starts))


def test_an_action_that_is_no_number_is_never_executed(coaches):
    """Though this task would take no notice of it, and a broken run stops beside healthy ones."""
    starts = [start(seed, learner("coach"), steady(), seed) for seed in range(4)]
    for index, value in ((1, np.nan), (2, np.inf)):
        grid = eqx.tree_at(lambda learner: learner.grid.lower, starts[index].learner, np.full(2, value))
        starts[index] = dataclasses.replace(starts[index], learner=grid)
    lanes = run(coaches, starts)
    for each in starts[1:]:
        expected = plain(RECORDED, each, NARROW, MANY)
        assert lanes[each.name].status == expected.status
        np.testing.assert_allclose(lanes[each.name].rows.returns, expected.rows["returns"])
    for index in (1, 2):
        assert lanes[index].status == Status.NON_FINITE
        assert np.isnan(lanes[index].rows.returns[0]) and not lanes[index].rows.length.any()
    agrees(lanes[3], expected)


def test_a_correction_that_is_not_finite_stops_the_run_there(coaches):
    each = start(0, learner("coach"), steady(), 0)
    infinite = eqx.tree_at(lambda learner: learner.magnitude, each.learner, np.full(2, np.inf))
    each = dataclasses.replace(each, learner=infinite)
    lane = run(coaches, [each])[0]
    assert lane.status == Status.NON_FINITE
    assert lane.rows.length[0] == lane.log.moments[0, 1] + 1 and np.isnan(lane.rows.returns[0])
    assert not lane.rows.length[1:].any() and not lane.controller.weights.any()
    assert lane.rows.corrections[0] == 0 < lane.log.count and not lane.log.values[0, 0].any()
