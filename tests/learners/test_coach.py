"""What a COACH learner promises beside its numbers, which test_parity compares."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.learners.base import Status
from gpcjax.learners.coach import COACH
from gpcjax.learners.factory import make_learner
from gpcjax.policies.grid import Grid
from tests.trees import assert_close, assert_same_bits

features_at = jax.jit(Grid.features)
propose = jax.jit(lambda learner, state, obs: learner.controller(state)(obs))


def taught(learner, count=10, seed=0):
    rng, state = np.random.default_rng(seed), learner.init()
    for _ in range(count):
        obs = rng.normal(size=learner.obs_size)
        state, _ = learner.correct(
            state, obs, np.zeros(learner.action_size), rng.choice([-1.0, 1.0], learner.action_size)
        )
    return state


def test_without_advice_a_dimension_is_untouched_to_the_bit():
    learner = make_learner("coach", "lunarlander")
    state, obs = taught(learner), np.linspace(-1, 1, 8)
    for advice in ([0, 0], [1, 0], [0, -1]):
        after, info = learner.correct(state, obs, np.zeros(2), advice)
        for i in range(2):
            before, now = (
                jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], each) for each in (state, after)
            )
            if advice[i] == 0:
                assert_same_bits(now, before)
                assert info.rate[i] == 0
            else:
                assert (now.policy != before.policy).any() and (now.human != before.human).any()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(value):
    learner = make_learner("coach", "cartpole")
    state = taught(learner)
    after, info = learner.correct(state, [0, value, 0, 0], [0.0], [1])
    assert_same_bits(after, state)
    assert info.status == Status.NON_FINITE


def test_the_rate_is_the_change_of_the_action():
    """alpha e (phi . phi), with line 7's H: small at first, larger with consistent advice."""
    learner = make_learner("coach", "pendulum")
    state, obs, rates = learner.init(), np.array([0.2, -0.4, 1.0]), []
    for _ in range(4):
        before = propose(learner, state, obs)
        state, info = learner.correct(state, obs, [0.0], [1])
        np.testing.assert_allclose(info.rate, propose(learner, state, obs) - before, rtol=1e-12)
        rates.append(float(info.rate[0]))
    features = np.asarray(features_at(learner.grid, obs))
    assert rates[0] == pytest.approx(1.8 * 5.0 * float((features * features).sum()))
    assert rates == sorted(rates) and rates[3] > 1.1 * rates[0]


def test_it_knows_no_uncertainty_and_no_dictionary():
    learner = make_learner("coach", "cartpole")
    state = taught(learner)
    assert np.isnan(learner.uncertainty(state, np.zeros(4), [0.0])).all()
    _, info = learner.correct(state, np.zeros(4), [0.0], [1])
    assert np.isnan(info.sigma_policy).all() and np.isnan(info.sigma_human).all()
    assert not (info.appended | info.replaced | info.full).any()
    assert learner.points(state) == (0, 0) and learner.has_room(state) and learner.largest_sigma() == 0
    assert learner.grow(state) is state and learner.resize(state, 1, 1) is state


def test_direct_jitted_and_batched_calls_agree():
    learner = make_learner("coach", "lunarlander")
    states = [taught(learner, seed=seed) for seed in range(3)]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
    rng = np.random.default_rng(5)
    obs, h = rng.normal(size=(3, 8)), rng.choice([-1.0, 0.0, 1.0], size=(3, 2))
    jitted = jax.jit(learner.correct)
    together = jax.jit(jax.vmap(lambda *arguments: learner.correct(*arguments)))(
        stacked, obs, np.zeros((3, 2)), h
    )
    for i in range(3):
        direct = learner.correct(states[i], obs[i], np.zeros(2), h[i])
        assert_close(jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], together), direct, 1e-12)
        assert_close(jitted(states[i], obs[i], np.zeros(2), h[i]), direct, 1e-12)


def test_one_trace(monkeypatch):
    traces = []
    original = COACH._correct
    monkeypatch.setattr(COACH, "_correct", lambda self, *rest: traces.append(self) or original(self, *rest))
    for beta in (1.0, 2.0):
        learner = make_learner(
            "coach", obs_size=2, action_size=1, lower=(0, 0), upper=(1, 1), counts=(3, 7), beta=beta
        )
        state = learner.init()
        for step in range(3):
            state, _ = learner.correct(state, [0.1 * step, 0.5], [0.0], [1])
    assert len(traces) == 1


class TestGrid:
    def test_features_are_normalised_gaussians_at_the_centres(self):
        """(2.4), the dense way; the spacing of each dimension is its width."""
        grid = Grid(lower=jnp.array([-1.0, 0.0, 2.0]), upper=jnp.array([1.0, 3.0, 6.0]), counts=(3, 4, 2))
        axes = [np.linspace(-1, 1, 3), np.linspace(0, 3, 4), np.linspace(2, 6, 2)]
        centres, width = np.stack(np.meshgrid(*axes, indexing="ij"), -1), np.array([1.0, 1.0, 4.0])
        for obs in np.random.default_rng(6).normal(size=(5, 3)):
            weights = np.exp(-0.5 * (((obs - centres) / width) ** 2).sum(-1))
            np.testing.assert_allclose(features_at(grid, obs), weights / weights.sum(), rtol=1e-12)

    @pytest.mark.parametrize("far", [1e3, 1e8])
    def test_far_outside_they_still_sum_to_one(self, far):
        """The nearest corner takes it all."""
        grid = Grid(lower=jnp.zeros(2), upper=jnp.ones(2), counts=(3, 3))
        features = np.asarray(features_at(grid, np.array([far, -far])))
        assert features.sum() == 1.0 and features[2, 0] == 1.0

    def test_the_controller_is_the_dot_product_with_lanes_last(self):
        learner = make_learner("coach", "pendulum")
        state = taught(learner)
        obs = np.random.default_rng(7).normal(size=(3, 5))
        lanes = jax.tree.map(lambda leaf: jnp.asarray(np.stack([leaf] * 5, -1)), learner.controller(state))
        policy = np.asarray(state.policy)
        expected = [
            (policy * np.asarray(features_at(learner.grid, each))).sum(tuple(range(1, 4))) for each in obs.T
        ]
        got = jax.jit(lambda lanes, obs: lanes(obs))(lanes, obs)
        np.testing.assert_allclose(got, np.stack(expected, -1), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("advice", [[0.5], [3], [np.nan]])
def test_advice_is_checked(advice):
    learner = make_learner("coach", "cartpole")
    with pytest.raises(ValueError, match=r"each entry must be -1, 0 or 1"):
        learner.correct(learner.init(), np.zeros(4), [0.0], advice)
