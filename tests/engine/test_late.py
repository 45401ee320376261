"""Late advice, teachers with a memory, learners that go on by themselves: the batched loops against a plain one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.engine import streams
from gpcjax.engine.history import Credit
from gpcjax.engine.pool import Tier
from gpcjax.learners.base import Info, Learner
from gpcjax.moment import Moment
from gpcjax.teachers.base import Teacher
from gpcjax.teachers.oracle import synthesised
from tests.engine.host_tasks import host_drift
from tests.engine.tasks import (
    TIERS,
    Drift,
    Plain,
    advance,
    coins,
    expert,
    kept,
    learner,
    make_pool,
    reset,
    run,
    start,
    start_key,
)
from tests.engine.test_rollout import agrees
from tests.trees import assert_same_bits

RECORDED = {"compiled": Drift(force=0.0), "host": host_drift(force=0.0)}
EPISODES = 3
WIDE = Tier(1, 1, 8)
"""For learners without dictionaries."""

COLUMNS = "returns length corrections rate_sum policy_points human_points clipped full asked chance_sum"
STEP = 0.1
"""Seconds, of the teachers and credits here."""


def person(**changes):
    return synthesised(**{"rate": 0.5, "error": 0.1, "delta": 0.02, "time_step": STEP, **changes})


def begun(name, learner, teacher, seed, credit=None):
    return dataclasses.replace(start(name, learner, teacher, seed), credit=jax.tree.map(np.asarray, credit))


draws = jax.jit(streams.draws)
act = jax.jit(lambda learner, state, obs: learner.controller(state)(obs))
target = jax.jit(expert)


def scaled(learner, weight):
    """A learner whose rates are `weight` times those of the other."""
    if weight == 1.0:
        return learner
    if hasattr(learner, "beta"):
        return dataclasses.replace(
            learner,
            beta=learner.beta * weight,
            magnitude=learner.magnitude * weight,
        )
    return dataclasses.replace(learner, static_rate=learner.static_rate * weight)


class Mind:
    """A person as one would write it: what is seen, whether it attends, and its advice on one of the steps so far."""

    def __init__(self, teacher):
        self.teacher, self.attends, self.seen = teacher, True, 0

    def advice(self, path, coins, drawn):
        """On a path of (obs, action), whose last step is the present one; and the chance of it."""
        teacher = self.teacher
        if teacher.looks_away is not None:
            self.attends = bool(
                drawn[0] >= teacher.looks_away if self.attends else drawn[0] < teacher.looks_back
            )
        chance = float(teacher.rate) * self.attends
        if teacher.fading is not None:
            chance *= np.exp(-float(teacher.fading) * self.seen)
        self.seen += 1
        back = 0 if teacher.lateness is None else int((drawn[1] >= np.asarray(teacher.lateness)).sum())
        if back >= len(path):
            return np.zeros(2), chance
        obs, action = path[-1 - back]
        gap = np.asarray(target(obs)) - action
        h = np.sign(gap) * (np.abs(gap) > teacher.delta) * (coins < chance)
        wrong = drawn[2] < teacher.error if teacher.whole else coins < chance * teacher.error
        return np.where(wrong, -h, h), chance


def teach(env, start, tier, episodes=EPISODES):
    """One run as anyone would write it, with every step of an episode kept."""
    learner, teacher = jax.tree.map(jnp.asarray, start.learner), start.teacher
    credit = [(0, 1.0)]
    if start.credit is not None:
        credit = [(start.credit.first + i, float(w)) for i, w in enumerate(start.credit.weights)]
    state = learner.resize(learner.init(), tier.policy_capacity, tier.human_capacity)
    rows = {name: np.zeros(episodes) for name in COLUMNS.split()}
    log = {"moments": [], "values": [], "outcome": []}
    mind = Mind(teacher)
    for episode in range(episodes):
        at, path = reset(env, start_key(start.seed, episode)), []
        while not at.done:
            place = (start.seed, episode, int(at.time))
            proposed = np.asarray(act(learner, state, at.obs))
            path.append((at.obs, np.clip(proposed, -1.0, 1.0)))
            drawn = np.asarray(coins(*place, 2))
            h, chance = mind.advice(path, drawn, np.asarray(draws(*place)))
            rows["asked"][episode] += (drawn < teacher.rate).any()
            rows["chance_sum"][episode] += chance * (drawn < teacher.rate).any()
            for back, weight in credit:
                if not h.any() or back >= len(path):
                    continue
                state, info = scaled(learner, weight).correct(state, *path[-1 - back], h)
                info = jax.tree.map(np.asarray, info)
                rows["rate_sum"][episode] += info.rate.sum()
                rows["full"][episode] += info.full.sum()
                for i in np.flatnonzero(h) if back == credit[0][0] else ():
                    rows["corrections"][episode] += 1
                    log["moments"].append((episode, place[2], i))
                    log["values"].append([info.rate[i], info.sigma_policy[i], info.sigma_human[i]])
                    log["outcome"].append([info.appended[i], info.replaced[i], info.full[i]])
            rows["clipped"][episode] += (np.abs(proposed) > 1.0).any()
            at = advance(env, at, path[-1][1])
            rows["returns"][episode] += at.reward
        rows["length"][episode] = at.time
        rows["policy_points"][episode], rows["human_points"][episode] = learner.points(state)
    return Plain(rows, {name: np.reshape(values, (-1, 3)) for name, values in log.items()}, 0, state), mind


LATE = {"delay": 0.2, "delay_shape": 2.0}
UNSTEADY = {"attention": 1.0, "distraction": 0.5, "fading": 0.01}


BOTH = TIERS["gpc"][-2:]


@pytest.fixture(scope="module")
def spread():
    """Late teachers, wrong as a whole, and credit for several steps; in dictionaries that outgrow a block."""
    given = learner("gpc", static_rate=0.2, on_full="replace-nearest")
    credit = Credit.of(0.1, None, 2.0, STEP)
    assert credit.moments == 6
    settings = [{}, {"error": 0.4}, {"rate": 0.02}]
    return [
        begun((index, seed), given, person(whole_error=1, **LATE, **change), seed, credit)
        for index, change in enumerate(settings)
        for seed in (3, 4)
    ]


@pytest.fixture(scope="module")
def pool(spread):
    return make_pool(RECORDED["compiled"], spread[0], BOTH, EPISODES)


@pytest.fixture(scope="module")
def together(pool, spread):
    return run(pool, spread)


@pytest.mark.slow
class TestSpread:
    def test_against_a_plain_loop(self, spread, pool, together):
        assert pool.counters.promotions >= 4
        for each in spread[:1] + spread[3:4]:
            agrees(together[each.name], teach(RECORDED["compiled"], each, BOTH[-1])[0])

    def test_a_lane_depends_on_itself_alone(self, spread, pool, together):
        assert len({lane.rows.rate_sum.tobytes() for lane in together.values()}) == len(spread)
        for each in spread[2:4]:
            assert_same_bits(kept(run(pool, [each])[each.name]), kept(together[each.name]))
        for name, lane in run(pool, spread[::-1]).items():
            assert_same_bits(kept(lane), kept(together[name]))


def test_an_unsteady_teacher():
    """That is late too, of which the learner knows nothing."""
    teacher = person(rate=0.9, delay=0.0, delay_longest=0.3, **UNSTEADY)
    starts = [begun(seed, learner("coach"), teacher, seed) for seed in (3, 4)]
    lanes = run(make_pool(RECORDED["compiled"], starts[0], (WIDE,), EPISODES), starts)
    for each in starts:
        (expected, mind), lane = teach(RECORDED["compiled"], each, WIDE), lanes[each.name]
        agrees(lane, expected)
        assert (lane.memory.steps, lane.memory.attending) == (mind.seen, mind.attends)
        assert lane.memory.steps == lane.rows.length.sum() and lane.log.count > 20
        assert lane.rows.chance_sum.sum() < 0.8 * 0.9 * lane.rows.asked.sum()


@pytest.mark.slow
def test_on_the_host():
    """All of it, where another loop keeps the steps; the learner reckons with one delay."""
    teacher, credit = person(rate=0.9, delay=0.2, **UNSTEADY), Credit.of(0.2, None, None, STEP)
    starts = [begun(seed, learner("coach"), teacher, seed, credit) for seed in (3, 4)]
    lanes = run(make_pool(RECORDED["host"], starts[0], (WIDE,), EPISODES), starts)
    for each in starts:
        (expected, mind), lane = teach(RECORDED["host"], each, WIDE), lanes[each.name]
        agrees(lane, expected)
        assert (lane.memory.steps, lane.memory.attending) == (mind.seen, mind.attends)
        # Nothing is said, nor learned, of what was before the first step.
        assert lane.log.moments[: lane.log.count, 1].min() >= 2 and lane.log.count > 20


class Counting(Teacher):
    """Says "more" at every step whose count is odd, of all that it has seen; with a checksum of these steps."""

    rate: jax.Array
    seen: jax.Array | None = None

    def init(self):
        return {"seen": jnp.zeros((), jnp.int32), "sum": jnp.zeros(())}

    def watch(self, memory, moment):
        place = 100.0 * moment.episode + moment.step + moment.obs[0] + moment.action[1]
        return {"seen": memory["seen"] + 1, "sum": memory["sum"] + place}

    def recalling(self, memory):
        return dataclasses.replace(self, seen=memory["seen"])

    def may_advise(self, coins, largest_sigma, step):
        return coins < self.rate[None]

    def advise(self, coins, moment):
        return jnp.where((coins < self.rate[None]) & (self.seen % 2 == 1)[None], 1.0, 0.0)


class Restless(Learner):
    """A policy of one number, whose changes by learning and by idling do not commute; both draw.

    It keeps all advice, and waits for room where there is none.
    """

    idle_every = 4

    def init(self, key=None):
        none = jnp.zeros((), jnp.int32)
        return {"gain": jnp.zeros(()), "idled": none, "count": none, "kept": jnp.zeros(4)}

    def propose(self, state, obs):
        return 0.1 * state["gain"] * obs

    def learn(self, state, moment, advice, key):
        drawn = jax.random.uniform(key)
        gain = 0.9 * state["gain"] + advice.sum() + 0.1 * drawn + 0.01 * moment.step + moment.obs[0]
        kept = state["kept"].at[state["count"]].set(advice.sum(), mode="drop")
        return {**state, "gain": gain, "kept": kept, "count": state["count"] + 1}, Info.of(jnp.abs(advice))

    def idle(self, state, key):
        gain = 0.5 * state["gain"] - jax.random.uniform(key) + state["kept"].sum() / 50
        return {**state, "gain": gain, "idled": state["idled"] + 1}

    def has_room(self, state, corrections=1):
        return state["count"] + (corrections - 1) < state["kept"].shape[0]

    def resize(self, state, policy_capacity, human_capacity):
        missing = max(policy_capacity - state["kept"].shape[0], 0)
        return {**state, "kept": jnp.concatenate([state["kept"], jnp.zeros(missing)])}


@pytest.mark.slow
@pytest.mark.parametrize("where", RECORDED)
def test_a_teacher_and_a_learner_of_ones_own(where):
    """A memory that takes each step once, idling at each fourth step after the advice of that step: plainly.

    Also where a lane waits for room, and comes back to the step in another block. Credit goes to two steps.
    """
    env, given, seed = RECORDED[where], Restless(obs_size=2, action_size=2), 5
    each = begun(0, given, Counting(jnp.asarray(0.6)), seed, Credit.of(0.0, 0.1, None, STEP))
    pool = make_pool(env, each, (Tier(4, 4, 8), Tier(256, 256, 8)), EPISODES)
    lane = run(pool, [each])[0]
    assert pool.counters.promotions == 1
    assert lane.memory["seen"] == lane.rows.length.sum()
    assert lane.state["idled"] == (lane.rows.length // 4).sum() > 5
    learn, idle, propose = (jax.jit(method) for method in (_learn(given), given.idle, given.propose))
    state, seen, total = given.resize(given.init(), 256, 256), 0, 0.0
    for episode in range(EPISODES):
        at, path = reset(env, start_key(seed, episode)), []
        while not at.done:
            time = int(at.time)
            path.append((jnp.asarray(at.obs), jnp.clip(propose(state, jnp.asarray(at.obs)), -1.0, 1.0)))
            seen += 1
            total += 100.0 * episode + time + float(at.obs[0] + path[-1][1][1])
            h = np.where(np.asarray(coins(seed, episode, time, 2)) < 0.6, 1.0, 0.0) * (seen % 2)
            for back in range(min(2, time + 1)) if h.any() else ():
                state = learn(state, *path[-1 - back], 0.5 * h, seed, episode, time, back)
            if time % 4 == 3:
                state = idle(state, streams.learner_key(seed, episode, time, use=1))
            at = advance(env, at, path[-1][1])
    assert lane.memory["seen"] == seen
    np.testing.assert_allclose(lane.memory["sum"], total, rtol=1e-9)
    for name, value in lane.state.items():
        np.testing.assert_allclose(value, state[name], rtol=1e-9, err_msg=name)
    assert lane.state["count"] > 20


def _learn(given):
    def learn(state, obs, action, advice, seed, episode, time, back):
        key = jax.random.fold_in(streams.learner_key(seed, episode, time), back)
        moment = Moment(obs=obs, action=action, episode=jnp.asarray(episode), step=jnp.asarray(time - back))
        return given.learn(state, moment, jnp.asarray(advice), key)[0]

    return learn


@pytest.mark.parametrize("where", ["compiled", pytest.param("host", marks=pytest.mark.slow)])
def test_what_nobody_uses_is_not_there(where):
    """A lane without these things has no array for them."""
    pool = make_pool(RECORDED[where], begun(0, learner("coach"), person(), 0), (WIDE,), EPISODES)
    lane = pool._blocks[0]._empty()
    assert lane.history is None and lane.memory == () and lane.credit is None
    late = make_pool(RECORDED[where], begun(0, learner("coach"), person(delay=0.5), 0), (WIDE,), EPISODES)
    assert late._blocks[0]._empty().history.obs.shape == (5, 2, 8)


class ForOneLane(Teacher):
    """Written for one lane throughout: what it computes would mix lanes, or fail, if it were given several."""

    rate: jax.Array
    far: jax.Array | None = None

    reach = 1

    def init(self):
        return {"furthest": jnp.zeros(())}

    def watch(self, memory, moment):
        return {"furthest": jnp.maximum(memory["furthest"], jnp.linalg.norm(moment.obs))}

    def recalling(self, memory):
        return dataclasses.replace(self, far=memory["furthest"])

    def may_advise(self, coins, largest_sigma, step):
        return coins < self.rate

    def about(self, moment):
        return (jnp.linalg.norm(moment.obs) > 1).astype(jnp.int32)

    def chance(self, sigma_human):
        return self.rate * sigma_human.size * jnp.ones(2)

    def advise(self, coins, moment):
        speaks = (
            (coins < self.rate) & (jnp.linalg.norm(moment.obs) > 0.5 * self.far) & (moment.target.size == 2)
        )
        return jnp.where(speaks, jnp.sign(moment.target - moment.action), 0.0)


def test_a_teacher_of_ones_own_sees_one_lane():
    """Alone and among others it says the same, and learners learn the same of it."""
    each = [begun(seed, learner("coach"), ForOneLane(jnp.asarray(0.5)), seed) for seed in range(5)]
    pool = make_pool(RECORDED["compiled"], each[0], (WIDE,), 2)
    among, alone = run(pool, each), run(pool, each[:1])
    for got, expected in zip(*(jax.tree.leaves(kept(lanes[0])) for lanes in (among, alone)), strict=True):
        np.testing.assert_array_equal(got, expected)
    lane = alone[0]
    assert lane.rows.corrections.sum() > 0
    np.testing.assert_allclose(lane.rows.chance_sum, 2 * 0.5 * lane.rows.asked)
    assert len({float(each.memory["furthest"]) for each in among.values()}) == 5
