"""An expert that plans is asked by the lanes that need it, and teaches like any other."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax.engine.lanes import fresh
from gpcjax.engine.pool import Pool
from gpcjax.engine.teaching import _targets
from gpcjax.policies.base import Planner
from tests.engine.tasks import EPISODES, TIERS, Drift, expert, kept, make_pool, run, starts
from tests.trees import assert_same_bits


class Thinker(Planner):
    """The expert of `Drift`, as if it had to think about it."""

    def __call__(self, obs):
        return expert(obs)


def test_it_teaches_like_an_expert_that_does_not_plan():
    given = starts("coach")[:3]
    fast = make_pool(Drift(), given[0], TIERS["coach"])
    slow = Pool(Drift(), Thinker(), EPISODES, given[0], TIERS["coach"])
    expected, got = run(fast, given), run(slow, given)
    assert all(lane.log.count > 10 for lane in expected.values())
    for name, lane in got.items():
        assert_same_bits(kept(lane), kept(expected[name]))


def test_only_lanes_that_wait_are_thought_about():
    """The others' targets are zero; no advice is made of them."""
    each = jax.tree.map(jnp.asarray, starts("coach")[0])
    env = Drift()
    keys = jax.random.split(jax.random.key(0), 4)

    def lane(key):
        return fresh(env.reset(key), each.learner, each.teacher, jnp.asarray(0), EPISODES)

    block = jax.vmap(lane, out_axes=-1)(keys)
    waiting = jnp.array([False, True, False, True])
    block = dataclasses.replace(block, waiting=waiting)
    everyone = _targets(block, expert)
    assert (np.asarray(everyone) != 0).all()
    np.testing.assert_array_equal(_targets(block, Thinker()), jnp.where(waiting[None], everyone, 0.0))
