"""The synthesised teacher: Alg. 4 with the active-learning chance (3.6)."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.registry import make_expert
from gpcjax.moment import Moment
from gpcjax.sweep.build import make_oracle
from gpcjax.teachers.oracle import Advisor, Oracle

DRAWS = 100_000


def make(rate=0.3, error=0.0, delta=0.05, active_gain=0.0) -> Oracle:
    numbers = {"rate": rate, "error": error, "delta": delta, "active_gain": active_gain}
    return Oracle(
        **{name: jnp.asarray(value, float) for name, value in numbers.items()}, active=active_gain > 0
    )


@functools.cache
def coins() -> jax.Array:
    """[2, DRAWS]: the draws stand for lanes."""
    return jax.random.uniform(jax.random.key(0), (2, DRAWS))


def advise(oracle, coins, gap=1.0, sigma=0.0):
    """Advice of lanes whose target is `gap` above the action."""
    return np.asarray(_advise(oracle, coins, np.float64(gap), np.float64(sigma)))


@jax.jit
def _advise(oracle, coins, gap, sigma):
    shaped = lambda value: jnp.broadcast_to(value, coins.shape)  # noqa: E731
    return in_lanes(oracle).advise(coins, moment(shaped(jnp.zeros(())), shaped(gap), shaped(sigma)))


def in_lanes(oracle):
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (DRAWS,)), oracle)


@jax.jit
def may_advise(oracle, coins, bound):
    return in_lanes(oracle).may_advise(coins, jnp.full(DRAWS, bound), jnp.zeros(DRAWS, jnp.int32))


def moment(action, target, sigma) -> Moment:
    """A step at which all that matters is these; each (action_size, lanes)."""
    none = jnp.zeros(action.shape[1:], jnp.int32)
    return Moment(jnp.zeros((1, *none.shape)), action, none, none, target, sigma)


def near(count, probability, draws):
    """Within five standard deviations of a binomial."""
    assert abs(count - probability * draws) < 5 * np.sqrt(draws * probability * (1 - probability)) + 1e-9


FEW = (0.0, 0.1), (0.05, 0.0), (0.05, 0.1), (0.5, 0.5), (1.0, 1.0)
"""One of each kind: who is silent, right, as usual, no better than chance, and wrong."""


@pytest.mark.parametrize(
    ("rate", "error"),
    [
        pytest.param(*pair, marks=[] if pair in FEW else [pytest.mark.slow])
        for pair in itertools.product([0.0, 0.05, 0.5, 1.0], [0.0, 0.1, 0.5, 1.0])
    ],
)
def test_frequencies_of_algorithm_4(rate, error):
    """Advice with chance gamma, of which a share e is wrong: in each action dimension."""
    h = advise(make(rate=rate, error=error), coins())
    for row in h:
        near((row != 0).sum(), rate, DRAWS)
        near((row == -1).sum(), rate * error, DRAWS)
        near((row == 1).sum(), rate * (1 - error), DRAWS)


def test_the_sign_is_that_of_the_gap():
    oracle = make(rate=1.0)
    for gap in (0.06, 0.5, 1.9):
        assert (advise(oracle, coins(), gap) == 1).all() and (advise(oracle, coins(), -gap) == -1).all()
    wrong = make(rate=1.0, error=1.0)
    assert (advise(wrong, coins(), 0.5) == -1).all() and (advise(wrong, coins(), -0.5) == 1).all()


@pytest.mark.parametrize("delta", [0.0, 0.05, pytest.param(0.3, marks=pytest.mark.slow)])
def test_within_delta_it_is_silent(delta):
    """Also where an error would have been made."""
    oracle = make(rate=1.0, error=0.5, delta=delta)
    for gap in (0.0, delta, -delta, 0.99 * delta):
        assert not advise(oracle, coins(), gap).any()
    for gap in (delta + 1e-12, -delta - 1e-12):
        assert advise(oracle, coins(), gap).all()


def test_no_advice_on_what_is_not_a_number():
    assert not advise(make(rate=1.0), coins(), np.nan).any()


def test_dimensions_are_independent():
    """Each draws its own feedback, and its own error (section 5.1.3)."""
    h = advise(make(rate=0.4, error=0.3), coins())
    for first, second in itertools.product([-1, 0, 1], repeat=2):
        chance = {-1: 0.12, 0: 0.6, 1: 0.28}
        near(((h[0] == first) & (h[1] == second)).sum(), chance[first] * chance[second], DRAWS)


def test_lanes_may_have_their_own_numbers():
    """One lane that is never heard, one always right, one always wrong."""
    oracle = Oracle(
        rate=jnp.array([0.0, 1.0, 1.0]),
        error=jnp.array([0.0, 0.0, 1.0]),
        delta=jnp.array([0.0, 0.0, 0.0]),
        active_gain=jnp.zeros(3),
        active=False,
    )
    h = oracle.advise(jnp.full((2, 3), 0.5), moment(jnp.zeros((2, 3)), jnp.ones((2, 3)), jnp.zeros((2, 3))))
    np.testing.assert_array_equal(h, [[0, 1, -1]] * 2)


def test_a_schedule_gives_each_episode_its_own_chance():
    """The last one for all that follow; each lane is in an episode of its own, and may have its own schedule."""
    schedule = jnp.array([[0.1, 0.6], [0.2, 0.7], [0.3, 0.8]])
    numbers = {name: jnp.zeros(2) for name in ("rate", "error", "delta", "active_gain")}
    oracle = Oracle(**numbers, active=False, schedule=schedule)
    for episodes, chances in (((0, 0), (0.1, 0.6)), ((2, 1), (0.3, 0.7)), ((9, 3), (0.3, 0.8))):
        during = oracle.during(jnp.int32(episodes))
        np.testing.assert_array_equal(during.chance(jnp.zeros(2)), chances)
        for coin in (0.15, 0.25, 0.65, 0.75):
            may = during.may_advise(jnp.full((1, 2), coin), jnp.zeros(2), jnp.zeros(2, jnp.int32))
            np.testing.assert_array_equal(may, [[coin < chance for chance in chances]])
    assert jax.tree.map(lambda leaf: leaf[..., 1], oracle).during(jnp.int32(1)).rate == 0.7
    plain = make(rate=0.4)
    assert plain.during(jnp.int32(3)) is plain


class TestActive:
    oracle = make(rate=0.05, error=0.2, active_gain=2.0)

    def test_the_chance_grows_with_the_uncertainty(self):
        """gamma = c_a sigma_h + gamma_c, at most 1."""
        sigma = jnp.array([0.0, 0.1, 0.4, 3.0])
        np.testing.assert_allclose(self.oracle.chance(sigma), [0.05, 0.25, 0.85, 1.0], rtol=1e-15)
        for value, gamma in ((0.0, 0.05), (0.1, 0.25), (3.0, 1.0)):
            h = advise(self.oracle, coins(), sigma=value)
            near((h != 0).sum(), gamma, h.size)
            near((h == -1).sum(), 0.2 * gamma, h.size)

    def test_without_gain_uncertainty_is_not_looked_at(self):
        np.testing.assert_array_equal(make(rate=0.3).chance(jnp.array([0.0, 5.0, jnp.nan])), 0.3)

    def test_thinning_is_exact(self):
        """No coin that may_advise turns down could have brought advice, at any uncertainty up to the bound."""
        largest = 0.3
        for bound in (largest, 0.0):
            may = np.asarray(may_advise(self.oracle, coins(), np.float64(bound)))
            near(may.sum(), 0.05 + 2 * bound, may.size)
            for sigma in np.linspace(0.0, bound, 4):
                assert not advise(self.oracle, coins(), sigma=sigma)[~may].any()
            np.testing.assert_array_equal(advise(self.oracle, coins(), sigma=bound) != 0, may)


class TestAdvisor:
    """The oracle of a task, as a person uses it."""

    def test_it_works_out_the_target(self):
        advisor = make_oracle("cartpole", "lqr", rate=1.0)
        obs = [0.1, 0.0, 0.05, 0.0]
        target = make_expert("cartpole", "lqr")(jnp.asarray(obs))
        np.testing.assert_array_equal(advisor.target(obs), target)
        key = jax.random.key(0)
        for action, expected in ((-1.0, 1), (1.0, -1), (float(target[0]), 0)):
            assert advisor.advise(jax.random.clone(key), obs, [action]).tolist() == [expected]

    def test_it_is_its_coins(self):
        advisor = make_oracle("cartpole", "lqr", rate=0.5, error=0.5)
        heard = [int(advisor.advise(jax.random.key(seed), np.zeros(4), np.ones(1))[0]) for seed in range(12)]
        assert set(heard) == {-1, 0, 1}
        again = [int(advisor.advise(jax.random.key(seed), np.zeros(4), np.ones(1))[0]) for seed in range(12)]
        assert heard == again

    def test_an_active_one_needs_sigma(self):
        advisor = make_oracle("cartpole", "lqr", rate=0.0, active_gain=10.0)
        assert isinstance(advisor, Advisor)
        with pytest.raises(ValueError, match=r"give sigma_human, from learner.uncertainty"):
            advisor.advise(jax.random.key(0), np.zeros(4), np.ones(1))
        for sigma, told in ((np.nan, "each entry must be finite"), (-5.0, "give numbers of at least 0")):
            with pytest.raises(ValueError, match=rf"^sigma_human \[{sigma}\]: {told}"):
                advisor.advise(jax.random.key(0), np.zeros(4), np.ones(1), [sigma])
        assert advisor.advise(jax.random.key(0), np.zeros(4), np.ones(1), [1.0]).tolist() == [-1]
        assert advisor.advise(jax.random.key(1), np.zeros(4), np.ones(1), np.zeros(1)).tolist() == [0]
        with pytest.raises(
            ValueError, match=r"action \[1.5\]: each entry must be from -1 to 1, as it was executed"
        ):
            advisor.advise(jax.random.key(1), np.zeros(4), [1.5], np.zeros(1))

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"rate": 1.5}, "rate 1.5: give a number from 0 to 1"),
            ({"rate": float("nan")}, "rate nan: give a number from 0 to 1"),
            ({"error": -0.1}, "error -0.1: give a number from 0 to 1"),
            ({"delta": -1}, "delta -1: give a number of at least 0"),
            ({"delta": float("inf")}, "delta inf: give a number of at least 0"),
            ({"active_gain": -2.0}, "active_gain -2.0: give a number of at least 0"),
            ({"expert_name": "energy"}, "oracle 'energy': give gpc, .*lqr, .* for cartpole"),
            ({"env_name": "cartpol"}, "env 'cartpol': give cartpole, pendulum, .*.*"),
        ],
    )
    def test_refusals(self, options, message):
        with pytest.raises(ValueError, match=message):
            make_oracle(**{"env_name": "cartpole", "expert_name": "lqr", **options})
