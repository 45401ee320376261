"""Policies of more points than are summed at once, in blocks: what a lane comes to does not depend on the others'."""

import numpy as np
import pytest

from gpcjax.engine.pool import Tier
from gpcjax.policies.kernel import PART
from tests.engine.tasks import Drift, kept, learner, make_pool, oracle, run, start
from tests.trees import assert_same_bits

ROOM = 3 * PART
EPISODES = 12


def taught(name, seed, rate):
    """One that keeps a point of every correction, of which there are more or fewer."""
    options = {"sparsify": False, "constant_rate": 0.1}
    return start(name, learner("gpc", capacity=ROOM, **options), oracle(rate=rate, delta=0.0), seed)


@pytest.mark.slow
def test_a_lane_is_what_it_is_alone_whatever_parts_others_use():
    """Whether a part is summed is the block's affair; `tests/policies/test_kernel.py` says it of one sum."""
    starts = [taught(seed, seed, rate) for seed, rate in enumerate((0.03, 0.15, 0.25, 0.5, 0.9))]
    pool = make_pool(Drift(), starts[0], (Tier(ROOM, ROOM, 8),), EPISODES)
    together = run(pool, starts)
    used = [np.max(together[each.name].rows.policy_points) for each in starts]
    assert used[0] < PART < max(used[1:3]) and max(used) > 2 * PART, used
    for some in ([0], [1], [0, 2], [1, 3]):
        for name, lane in run(pool, [starts[i] for i in some]).items():
            assert_same_bits(kept(lane), kept(together[name]))
