"""The return of a fixed policy."""

import jax.numpy as jnp
import numpy as np

from gpcjax.engine import streams
from gpcjax.engine.evaluate import evaluate, idle
from gpcjax.envs.cartpole import CartPole
from tests.engine.tasks import Drift, advance, expert, reset


def test_against_a_plain_loop():
    """One episode each, from the first start of seeds 0, 1, ...; steps after its end count for nothing."""
    env = Drift()
    got = evaluate(env, expert, starts=6)
    for seed in range(6):
        state, total = reset(env, streams.start_key(seed, 0)), 0.0
        while not state.done:
            state = advance(env, state, expert(state.obs))
            total += state.reward
        np.testing.assert_allclose(got.returns[seed], total, rtol=1e-12)
        assert got.length[seed] == state.time
    assert len(set(np.asarray(got.returns))) == 6


def test_the_number_of_starts_changes_none_of_them():
    env = Drift()
    few, many = evaluate(env, expert, starts=3), evaluate(env, expert, starts=10)
    np.testing.assert_allclose(many.returns[:3], few.returns, rtol=1e-12)


def test_idle_does_nothing():
    env = CartPole()
    assert idle(env)(jnp.ones(4)).tolist() == [0.0]
    returns = evaluate(env, idle(env), starts=20)
    assert returns.returns.shape == (20,)
    np.testing.assert_array_equal(returns.returns, returns.length)
    assert 20 < returns.returns.mean() < 80
