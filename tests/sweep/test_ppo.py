"""Policy optimisation on a task whose answer is known, and its parts against plain loops."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.base import Env, State, begin
from gpcjax.policies.base import Policy
from gpcjax.sweep.ppo import Parameters, Step, Training, _advantages, train
from tests.trees import assert_same_bits

TRAINING = Training(
    scale=(2.0,),
    reward_scale=1.0,
    discount=0.5,
    updates=120,
    lanes=16,
    unroll=16,
    epochs=4,
    minibatches=4,
    hidden=(8,),
)


class Match(Env):
    """Say half of the number shown: an episode of `max_steps` steps, each with a number of its own."""

    max_steps: int = 4

    name = property(lambda self: "match")
    obs_size = property(lambda self: 1)
    action_size = property(lambda self: 1)

    def reset(self, key):
        start = jax.random.uniform(key, (1,), minval=-1.0, maxval=1.0)
        return begin(start, start)

    def step(self, state, action):
        miss = jnp.clip(action[0], -1.0, 1.0) - 0.5 * state.obs[0]
        time = state.time + 1
        after = jnp.stack([(state.obs[0] + 1.7) % 2.0 - 1.0])
        return State(after, after, -miss * miss, jnp.zeros((), bool), time >= self.max_steps, time)


@pytest.fixture(scope="module")
def trained():
    return train(Match(), TRAINING, jax.random.key(0))


def test_it_learns(trained):
    controller, rewards = trained
    policy = Policy(controller)
    for number in (-0.8, -0.1, 0.5):
        np.testing.assert_allclose(policy(jnp.array([number])), [0.5 * number], atol=0.12)
    assert rewards.shape == (120,) and rewards[-5:].mean() > rewards[:5].mean()


def test_the_same_key_repeats_and_keys_differ(trained):
    assert_same_bits(train(Match(), TRAINING, jax.random.key(0)), trained)
    other, _ = train(Match(), TRAINING, jax.random.key(1))
    assert not np.allclose(other.weights[0], trained[0].weights[0])


@pytest.mark.slow
def test_what_observations_are_scaled_by_is_in_the_first_layer():
    """Before the first move of the network, so that its layers are known."""
    idle = dataclasses.replace(TRAINING, learning_rate=0.0, updates=1)
    doubled = dataclasses.replace(idle, scale=(4.0,))
    (plain, _), (wide, _) = (train(Match(), each, jax.random.key(0)) for each in (idle, doubled))
    np.testing.assert_allclose(wide.weights[0], 2 * plain.weights[0])
    np.testing.assert_allclose(wide(jnp.array([0.2])), plain(jnp.array([0.4])), atol=1e-14)


def test_advantages_against_a_plain_loop():
    """An end by the task is worth nothing afterwards; one by the clock is worth what would have followed."""
    rng = np.random.default_rng(0)
    training = dataclasses.replace(TRAINING, unroll=7, lanes=3, discount=0.9, trace=0.8, reward_scale=0.5)
    obs, following = rng.normal(size=(2, 7, 3, 1))
    terminated = rng.random((7, 3)) < 0.2
    done = terminated | (rng.random((7, 3)) < 0.2)
    assert terminated.any() and (done & ~terminated).any() and not done[-1].all()
    reward = rng.normal(size=(7, 3))
    weight, bias = rng.normal(size=(1, 1)), rng.normal(size=1)
    value = [(jnp.asarray(weight), jnp.asarray(bias))]
    steps = Step(*(jnp.asarray(x) for x in (obs, obs, reward, reward, terminated, done, following)))
    given = _advantages(training, Parameters([], value, jnp.zeros(1)), steps)
    advantage, target = map(np.asarray, given)
    worth = lambda x: (weight @ (2.0 * x) + bias).item()  # noqa: E731
    for lane in range(3):
        for first in range(7):
            total, factor = 0.0, 1.0
            for step in range(first, 7):
                after = 0.0 if terminated[step, lane] else worth(following[step, lane])
                total += factor * (0.5 * reward[step, lane] + 0.9 * after - worth(obs[step, lane]))
                factor *= 0.9 * 0.8
                if done[step, lane]:
                    break
            assert advantage[first, lane] == pytest.approx(total, abs=1e-12)
            assert target[first, lane] == pytest.approx(total + worth(obs[first, lane]), abs=1e-12)
