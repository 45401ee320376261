"""What the public functions give can be copied, and sent to another process."""

import copy
import pickle

import jax
import numpy as np
import pytest

import gpcjax
from tests.trees import assert_same_bits


def things():
    learner = gpcjax.make_learner("gpc", "cartpole", capacity=16)
    state, info = learner.correct(learner.init(), np.zeros(4), [0.0], [1])
    env = gpcjax.make_env("cartpole", pole_mass=0.3)
    yield from (env, gpcjax.make_env("pendulum"), env.reset(jax.random.key(0)))
    yield from (learner, gpcjax.make_learner("gpc-ns", "cartpole"), gpcjax.make_learner("coach", "cartpole"))
    yield from (state, info, learner.policy_of(state))
    yield from (gpcjax.make_oracle("cartpole", rate=0.3), gpcjax.make_oracle("lunarlander"))
    yield gpcjax.make_expert("pendulum", "energy")


@pytest.mark.parametrize("again", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.deepcopy, copy.copy])
def test_to_the_bit(again):
    for thing in things():
        assert_same_bits(again(thing), thing)


@pytest.mark.parametrize("again", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.deepcopy, copy.copy])
def test_a_task_of_the_host(again):
    env = gpcjax.make_env("lunarlander", max_steps=30)
    other = again(env)
    assert other == env and hash(other) == hash(env) and other.max_steps == 30
    np.testing.assert_array_equal(other.simulate().reset(3), env.simulate().reset(3))
    np.testing.assert_array_equal(other.scaled(np.array([0.5, -2.0])), env.scaled(np.array([0.5, -2.0])))
    with pytest.raises(TypeError):
        other.options["continuous"] = False
