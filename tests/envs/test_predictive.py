"""The model-predictive experts: they plan with the task's own equations, and master it."""

import pickle
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.experts import EnergySwingUp
from gpcjax.envs.pendulum import Pendulum
from gpcjax.envs.predictive import CartPoleMPC, PendulumMPC, solve

Returns = Callable[..., np.ndarray]
Starts = Callable[[int], jax.Array]


def test_it_balances_from_every_start(expert_returns: Returns, starts: Starts) -> None:
    env = CartPole(start_range=0.15, max_steps=300)
    np.testing.assert_array_equal(expert_returns(env, CartPoleMPC(), starts(4)), 300)


@pytest.mark.slow
def test_it_plans_for_its_own_cart_pole(expert_returns: Returns, starts: Starts) -> None:
    env = CartPole(pole_mass=0.5, half_length=0.3, max_force=20.0, max_steps=800)
    np.testing.assert_array_equal(expert_returns(env, CartPoleMPC(env), starts(8)), 800)
    obs = jnp.array([0.1, 0.2, 0.03, -0.1])
    act = jax.jit(lambda planner: planner(obs)[0])
    assert abs(act(CartPoleMPC(env)) - act(CartPoleMPC())) > 0.01


def test_the_residuals_are_those_of_the_simulated_plan() -> None:
    env, plan = CartPole(), jnp.array([0.3, -0.2])
    planner = CartPoleMPC(env, end_weight=7.0, holds=(2, 3))
    state = env.reset(jax.random.key(1))
    q, cost = np.array([1.0, 1.0, 10.0, 1.0]), 0.0
    obs, move = state.obs, jax.jit(env.step)
    for action in (0.3, 0.3, -0.2, -0.2, -0.2):
        cost += q @ np.square(state.obs) + 0.1 * action * action
        state = move(state, jnp.array([action]))
    cost += 7.0 * q @ np.square(state.obs)
    residuals = jax.jit(planner.residuals)(plan, obs)
    np.testing.assert_allclose(np.square(residuals).sum(), cost, rtol=1e-12)


def test_the_plan_is_a_minimum() -> None:
    """After enough steps no slope is left; after one, most of the gain is made."""
    obs, planner = jnp.array([0.3, -0.2, 0.05, 0.1]), CartPoleMPC(holds=(4,), iterations=8)

    def cost(action: jax.Array) -> jax.Array:
        return jnp.square(planner.residuals(action, obs)).sum()

    best, first = jax.jit(planner)(obs), jax.jit(CartPoleMPC(holds=(4,)))(obs)
    costs, slopes = jax.jit(jax.vmap(jax.value_and_grad(cost)))(jnp.stack([jnp.zeros(1), first, best]))
    assert 0.05 < abs(best[0]) < 1 and abs(slopes[2, 0]) < 1e-4 * abs(slopes[0, 0])
    assert costs[1] - costs[2] < 0.01 * (costs[0] - costs[2])


def test_solve() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 6):
        root = rng.normal(size=(n, n))
        matrix, right = root @ root.T + 0.1 * np.eye(n), rng.normal(size=n)
        got = jax.jit(solve)(jnp.asarray(matrix), jnp.asarray(right))
        np.testing.assert_allclose(got, np.linalg.solve(matrix, right), rtol=1e-9)


@pytest.mark.slow
def test_it_swings_up_as_well_as_the_energy_controller(expert_returns: Returns, starts: Starts) -> None:
    """Over 100 starts -148.9 and -148.7."""
    mine = expert_returns(Pendulum(), PendulumMPC(), starts(32))
    other = expert_returns(Pendulum(), EnergySwingUp(), starts(32))
    assert (mine - other).mean() > -6
    assert mine.min() > -450, "a start that is never swung up costs more than this"


def test_a_plan_costs_what_its_simulation_does() -> None:
    """And one step of rest, and what is missing of the energy upright."""
    env, plans = Pendulum(), jnp.array([[1.0, -0.5], [-1.0, 0.2]])
    planner, start, move = PendulumMPC(knots=2, hold=3), jnp.array([2.0, -1.0]), jax.jit(env.step)
    for column, cost in zip(plans.T, jax.jit(planner.costs)(start, plans), strict=True):
        state, total = env.reset(jax.random.key(0)), 0.0
        state = type(state)(start, state.obs, state.reward, state.terminated, state.truncated, state.time)
        for action in [*[column[0]] * 3, *[column[1]] * 3, 0.0]:
            if action == 0.0:
                theta, speed = state.physics
                total += 9.0 * abs(0.5 * speed**2 + 15.0 * (np.cos(theta) - 1.0))
            state = move(state, jnp.array([action]))
            total -= state.reward
        np.testing.assert_allclose(cost, total, rtol=1e-10)


@pytest.mark.parametrize(
    "kind",
    [pytest.param(CartPoleMPC, marks=pytest.mark.slow), PendulumMPC],
    ids=["cartpole", "pendulum"],
)
def test_a_function_that_can_be_followed(kind: type[CartPoleMPC | PendulumMPC]) -> None:
    """Of the observation alone: bounded, odd, mostly smooth, the same alone and among lanes and after a pickle."""
    rng, planner = np.random.default_rng(0), kind()
    if isinstance(planner, CartPoleMPC):
        obs, mirror = rng.uniform(-1, 1, (64, 4)) * [0.5, 1, 0.2, 1], -np.ones(4)
    else:
        angle = rng.uniform(-np.pi, np.pi, 64)
        obs = np.stack([np.cos(angle), np.sin(angle), rng.uniform(-6, 6, 64)], axis=-1)
        mirror = np.array([1, -1, -1])
    act = jax.jit(jax.vmap(planner, in_axes=-1, out_axes=-1))
    action = np.asarray(act(obs.T))[0]
    assert np.abs(action).max() <= 1 and np.abs(action).min() < 0.2
    np.testing.assert_allclose(act((obs * mirror).T)[0], -action, atol=1e-6)
    assert np.median(np.abs(act((obs + 1e-6).T)[0] - action)) < 1e-4
    again = pickle.loads(pickle.dumps(planner))
    for place in (0, 63):
        np.testing.assert_allclose(jax.jit(again)(jnp.asarray(obs[place])), action[place], atol=1e-9)
