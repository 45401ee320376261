"""The experts master their tasks and are functions that a learner could follow."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.experts import LQR, EnergySwingUp, linearise
from gpcjax.envs.pendulum import Pendulum

Returns = Callable[..., np.ndarray]
Starts = Callable[[int], jax.Array]


def test_lqr_balances_from_every_start(expert_returns: Returns, starts: Starts) -> None:
    np.testing.assert_array_equal(expert_returns(CartPole(), LQR(), starts(50)), 2500)
    np.testing.assert_array_equal(expert_returns(CartPole(start_range=0.15), LQR(), starts(50)), 2500)


def test_lqr_belongs_to_its_cart_pole(expert_returns: Returns, starts: Starts) -> None:
    env = CartPole(pole_mass=0.5, half_length=0.3, max_force=20.0)
    own, other = LQR(env), LQR()
    assert not np.allclose(own.gain, other.gain)
    np.testing.assert_array_equal(expert_returns(env, own, starts(50)), 2500)


def test_linearisation_is_the_derivative_of_a_step() -> None:
    env = CartPole(pole_mass=0.3, max_force=7.0)
    a, b = linearise(env)
    rest = env.reset(jax.random.key(0))

    def step(physics: jax.Array, action: jax.Array) -> jax.Array:
        state = type(rest)(physics, physics, rest.reward, rest.terminated, rest.truncated, rest.time)
        return env.step(state, action).physics

    by_state, by_action = jax.jit(jax.jacfwd(step, (0, 1)))(np.zeros(4), np.zeros(1))
    np.testing.assert_allclose(a, by_state, atol=1e-12)
    np.testing.assert_allclose(b, by_action, atol=1e-12)


def test_lqr_gain_minimises_its_cost() -> None:
    a, b = linearise(CartPole())
    gain = np.asarray(LQR().gain)[None]
    closed = a - b @ gain
    assert np.abs(np.linalg.eigvals(closed)).max() < 1
    q, cost = np.diag([1.0, 1.0, 10.0, 1.0]), np.zeros((4, 4))
    for _ in range(4000):
        cost = q + gain.T @ gain + closed.T @ cost @ closed
    np.testing.assert_allclose(np.linalg.solve(1.0 + b.T @ cost @ b, b.T @ cost @ a), gain, rtol=1e-8)


def test_energy_swings_up_from_every_start(expert_returns: Returns, starts: Starts) -> None:
    """A grid value iteration puts the best mean over all starts near -140; the law reaches -144.6 there."""
    returns = expert_returns(Pendulum(), EnergySwingUp(), starts(2000))
    assert -148 < returns.mean() < -141
    assert returns.std() < 90
    assert returns.min() > -450, "a start that is never swung up costs more than this"


def test_energy_holds_the_rod_upright(starts: Starts) -> None:
    env, expert = Pendulum(), EnergySwingUp()

    def last(key: jax.Array) -> jax.Array:
        state = env.reset(key)
        return jax.lax.scan(lambda s, _: (env.step(s, expert(s.obs)), None), state, None, 200)[0].obs

    np.testing.assert_allclose(
        jax.jit(jax.vmap(last))(starts(500)), np.tile([1.0, 0.0, 0.0], (500, 1)), atol=0.02
    )


@pytest.mark.parametrize(("expert", "scale"), [(LQR(), [0.5, 1, 0.2, 1]), (EnergySwingUp(), [1, 1, 8])])
def test_actions_are_bounded_odd_and_continuous(expert: LQR | EnergySwingUp, scale: list[float]) -> None:
    obs = np.random.default_rng(0).uniform(-1, 1, (2000, len(scale))) * scale
    mirror = -np.ones(len(scale))
    if isinstance(expert, EnergySwingUp):
        mirror[0] = 1.0
        obs[:, 1] = np.sign(obs[:, 1]) * np.sqrt(1 - obs[:, 0] ** 2)
    act = jax.jit(jax.vmap(expert))
    action = np.asarray(act(obs))
    assert np.abs(action).max() <= 1 and np.abs(action).min() < 0.1
    np.testing.assert_allclose(act(obs * mirror), -action, atol=1e-14)
    assert np.abs(act(obs + 1e-6) - action).max() < 1e-4


def test_experts_are_traced_leaves() -> None:
    gains = jnp.stack([LQR().gain, 2 * LQR().gain])
    obs = jnp.array([0.0, 0.0, 0.02, 0.0])
    actions = jax.vmap(lambda gain: jnp.sum(gain * obs))(gains)
    stacked = jax.tree.map(lambda *x: jnp.stack(x), LQR(), LQR(action_cost=0.1))
    np.testing.assert_allclose(jax.jit(jax.vmap(lambda e: e(obs)))(stacked)[0, 0], -actions[0])
    pump = lambda gain: EnergySwingUp(pump_gain=gain)(jnp.array([-1.0, 0.0, 0.1]))  # noqa: E731
    pumps = jax.jit(jax.vmap(pump))(jnp.array([0.1, 0.2]))
    np.testing.assert_allclose(pumps[1], 2 * pumps[0])
