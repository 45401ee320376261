"""Runs that begin with what was learned elsewhere."""

import dataclasses

import jax
import numpy as np
import pytest

from tests.engine.tasks import Drift, learner, make_pool, oracle, plain, run, start
from tests.engine.test_keeping import EPISODES, LARGE, SMALL
from tests.trees import assert_same_bits

TIERS = SMALL, LARGE
"""As there, and as many episodes: the same programs, which XLA has compiled then."""


@pytest.mark.slow
def test_a_run_begins_with_its_state_in_the_tier_that_fits():
    gpc = learner("gpc")
    begun = [start(seed, gpc, oracle(rate=0.5), seed) for seed in range(2)]
    pool = make_pool(Drift(), begun[0], TIERS, EPISODES)
    lanes = run(pool, begun)
    small = dataclasses.replace(start("small", gpc, oracle(rate=0.5), 5), state=host(gpc.init()))
    silent = start("silent", gpc, oracle(rate=0.0), 3)
    taught = dataclasses.replace(silent, state=lanes[0].state)
    assert lanes[0].state.policy.points.shape[1] == 64
    again = run(pool, [taught, small, *begun])
    assert_same_bits(again["silent"].state, lanes[0].state)
    assert again["silent"].rows.corrections.sum() == 0
    untaught = plain(Drift(), silent, TIERS[-1], EPISODES)
    assert (again["silent"].rows.returns != untaught.rows["returns"]).all()
    # An empty state is no state, to the bit; and what is beside them changes nothing for the others.
    expected = run(pool, [dataclasses.replace(small, state=None)])["small"]
    for lane, reference in ((again["small"], expected), (again[0], lanes[0]), (again[1], lanes[1])):
        assert_same_bits((lane.rows, lane.state, lane.log), (reference.rows, reference.state, reference.log))
    other = dataclasses.replace(silent, state=host(gpc.resize(gpc.init(), 5, 5)))
    with pytest.raises(ValueError, match="shapes of no tier"):
        run(pool, [other])


def host(state):
    return jax.tree.map(np.asarray, state)
