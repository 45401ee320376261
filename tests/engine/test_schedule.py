"""A teacher whose chance changes from episode to episode, in both kinds of pool."""

import numpy as np
import pytest

from tests.engine.host_tasks import host_drift
from tests.engine.tasks import Drift, coins_at, learner, make_pool, oracle, plain, run, start
from tests.engine.test_rollout import NARROW, agrees


@pytest.mark.parametrize(
    "env",
    [Drift(force=0.0), pytest.param(host_drift(force=0.0), marks=pytest.mark.slow)],
    ids=["compiled", "host"],
)
def test_a_schedule_gives_each_episode_its_own_chance(env):
    """The last one for all that follow; and each lane has its own."""
    schedules, episodes = [(0.0, 0.9, 0.3), (0.6, 0.0, 1.0)], 5
    starts = [
        start(seed, learner("coach"), oracle(schedule=schedule, delta=0.0), seed)
        for seed, schedule in enumerate(schedules)
    ]
    lanes = run(make_pool(env, starts[0], (NARROW,), episodes), starts)
    for each, schedule in zip(starts, schedules, strict=True):
        lane = lanes[each.name]
        agrees(lane, plain(env, each, NARROW, episodes))
        for episode in range(episodes):
            chance, length = (*schedule, *schedule[-1:] * 2)[episode], int(lane.rows.length[episode])
            drawn = coins_at(each.seed, np.full(env.max_steps, episode), np.arange(env.max_steps), 2)
            below = np.asarray(drawn)[:length] < chance
            assert lane.rows.asked[episode] == below.any(1).sum()
            # An action that is the target is met with silence.
            assert (chance > 0) == (lane.rows.corrections[episode] > 0)
            assert lane.rows.corrections[episode] <= below.sum()
            np.testing.assert_allclose(lane.rows.chance_sum[episode], chance * lane.rows.asked[episode])
