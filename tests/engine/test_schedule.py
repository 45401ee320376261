"""A teacher whose chance changes from episode to episode, where tasks are simulated on the host."""

import pytest

from tests.engine.host_tasks import host_drift
from tests.engine.tasks import make_pool
from tests.engine.test_rollout import MANY, NARROW, each_episode_has_its_own_chance


@pytest.mark.slow
def test_a_schedule_gives_each_episode_its_own_chance():
    env = host_drift(force=0.0)
    each_episode_has_its_own_chance(env, lambda first: make_pool(env, first, (NARROW,), MANY))
