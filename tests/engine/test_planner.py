"""An expert that plans is asked for the lanes that need it alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax.engine.asking import _targets
from gpcjax.engine.lanes import fresh
from gpcjax.engine.stepping import moment_of
from gpcjax.policies.base import Planner
from tests.engine.tasks import EPISODES, Drift, expert, starts


class Thinker(Planner):
    """The expert of `Drift`, as if it had to think about it."""

    def plan(self, obs):
        return expert(obs)


def test_only_lanes_that_wait_are_thought_about():
    """The others' targets are zero; no advice is made of them."""
    env, start = Drift(), starts("coach")[0]
    learner, teacher = jax.tree.map(jnp.asarray, (start.learner, start.teacher))
    keys = jax.random.split(jax.random.key(0), 4)

    def lane(key):
        return fresh(env.reset(key), learner, teacher, jnp.asarray(0), EPISODES)

    block = jax.vmap(lane, out_axes=-1)(keys)
    waiting = jnp.array([False, True, False, True])
    block = dataclasses.replace(block, waiting=waiting)
    here = moment_of(block)
    everyone = _targets(block, expert, here)
    assert (np.asarray(everyone) != 0).all()
    np.testing.assert_array_equal(_targets(block, Thinker(), here), jnp.where(waiting[None], everyone, 0.0))
