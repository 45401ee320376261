"""Model-predictive experts: they learned from nobody, and plan anew at every step with the task's own equations.

A plan is a sequence of actions, each held for some steps, whose first one is carried out; what it costs is simulated.
Both planners are functions of the observation alone: they keep no plan from one step to the next.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, Int

from gpcjax._x64 import under_own_settings
from gpcjax.elementary import decay, sin_cos
from gpcjax.envs.base import Env, State, begin, parameter
from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.pendulum import Pendulum
from gpcjax.policies.base import Planner


@under_own_settings
def _numbers(values: ArrayLike | Sequence[float]) -> Float[Array, " n"]:
    return jnp.asarray(values, float)


class CartPoleMPC(Planner):
    """Balances a cart-pole by a Gauss-Newton step on a plan, from the plan that does nothing.

    The cost of a plan is the sum over its steps of weights . s^2 + action_weight a^2, with s = (x, x_dot, theta,
    theta_dot) in SI units, and `end_weight` times weights . s^2 of its last state: a nonlinear least-squares problem.

    | Field           | Meaning                                                             | Default             |
    |-----------------|---------------------------------------------------------------------|---------------------|
    | `env`           | the task                                                            | `CartPole()`        |
    | `weights`       | of the squared state                                                | 1, 1, 10, 1         |
    | `action_weight` | of the squared action                                               | 0.1                 |
    | `end_weight`    | of the last state                                                   | 10                  |
    | `holds`         | steps of each action of a plan (static)                             | 3, 5, 8, 14         |
    | `iterations`    | Gauss-Newton steps, each clipped to actions in [-1, 1] (static)     | 1                   |
    """

    env: CartPole = eqx.field(default_factory=CartPole)
    weights: Float[Array, "4"] = eqx.field(default=(1.0, 1.0, 10.0, 1.0), converter=_numbers)
    action_weight: Float[Array, ""] = eqx.field(default=0.1, converter=parameter)
    end_weight: Float[Array, ""] = eqx.field(default=10.0, converter=parameter)
    holds: tuple[int, ...] = eqx.field(default=(3, 5, 8, 14), static=True)
    iterations: int = eqx.field(default=1, static=True)

    def plan(self, obs: Float[Array, "4"]) -> Float[Array, "1"]:
        def twice(plan: Float[Array, " knots"]) -> tuple[Array, Array]:
            residuals = self.residuals(plan, obs)
            return residuals, residuals

        def improve(_: Int[Array, ""], plan: Float[Array, " knots"]) -> Float[Array, " knots"]:
            slope, residuals = jax.jacfwd(twice, has_aux=True)(plan)
            curvature = (slope[:, :, None] * slope[:, None]).sum(0)
            change = solve(curvature, (slope * residuals[:, None]).sum(0))
            return jnp.clip(plan - change, -1.0, 1.0)

        return lax.fori_loop(0, self.iterations, improve, jnp.zeros(len(self.holds)))[:1]

    def residuals(self, plan: Float[Array, " knots"], obs: Float[Array, "4"]) -> Float[Array, " residuals"]:
        """What the cost of `plan` from `obs` is the sum of squares of."""
        root = jnp.sqrt(self.weights)

        def step(physics: Float[Array, "4"], knot: Int[Array, ""]) -> tuple[Array, Array]:
            action = plan[knot]
            told = jnp.concatenate([root * physics, (jnp.sqrt(self.action_weight) * action)[None]])
            return _step(self.env, physics, action).physics, told

        knots = np.repeat(np.arange(len(self.holds)), self.holds)
        last, told = lax.scan(step, obs, jnp.asarray(knots))
        return jnp.concatenate([told.reshape(-1), jnp.sqrt(self.end_weight) * root * last])


def solve(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """The x of matrix x = right, for a small positive definite matrix.

    By elimination without pivots: a few vector operations, where a call of LAPACK for each lane would take longer.
    """

    def eliminate(k: Int[Array, ""], rows: Float[Array, "n n+1"]) -> Float[Array, "n n+1"]:
        row = rows[k] / rows[k, k]
        return (rows - rows[:, k][:, None] * row[None]).at[k].set(row)

    rows = jnp.concatenate([matrix, right[:, None]], axis=1)
    return lax.fori_loop(0, matrix.shape[0], eliminate, rows)[:, -1]


class PendulumMPC(Planner):
    """Swings a pendulum up and holds it: path integral control (MPPI) with samples that never change.

    The plan of a round is the mean of all sampled plans, each weighted by exp(-cost / temperature). The first round
    tries every sequence of full torques to the left and to the right, the others what is near the plan of the round
    before, ever nearer. The cost of a plan is minus its rewards, with one more step to rest in, and at the end
    `energy_weight` times the distance from the energy of upright rest (1/s^2): the swing is not over within a plan.

    | Field           | Meaning                                                             | Default            |
    |-----------------|---------------------------------------------------------------------|--------------------|
    | `env`           | the task                                                            | `Pendulum()`       |
    | `energy_weight` | cost of a unit of energy at the end                                 | 9.0                |
    | `spread`        | standard deviation of the samples of each round behind the first    | 0.5, 0.3, 0.2      |
    | `temperature`   | of each round                                                       | 1.0, 0.5, 0.2, 0.2 |
    | `knots`         | actions of a plan; there are 2^knots samples (static)               | 6                  |
    | `hold`          | steps of each action (static)                                       | 4                  |
    """

    env: Pendulum
    energy_weight: Float[Array, ""]
    temperature: Float[Array, " rounds"]
    samples: Float[Array, "rounds samples knots"]
    hold: int = eqx.field(static=True)

    def __init__(
        self,
        env: Pendulum | None = None,
        energy_weight: float = 9.0,
        spread: Sequence[float] = (0.5, 0.3, 0.2),
        temperature: Sequence[float] = (1.0, 0.5, 0.2, 0.2),
        knots: int = 6,
        hold: int = 4,
    ) -> None:
        self.env = Pendulum() if env is None else env
        self.energy_weight, self.temperature = parameter(energy_weight), _numbers(temperature)
        corners = jnp.asarray(list(itertools.product([-1.0, 1.0], repeat=knots)))
        # With each sample its mirror image: a mirrored observation has the mirrored action.
        half = jax.random.normal(
            jax.random.key(0, impl="threefry2x32"), (len(spread), len(corners) // 2, knots)
        )
        near = _numbers(spread)[:, None, None] * jnp.concatenate([half, -half], axis=1)
        self.samples = jnp.concatenate([corners[None], near])
        self.hold = hold

    def plan(self, obs: Float[Array, "3"]) -> Float[Array, "1"]:
        start = jnp.stack([jnp.arctan2(obs[1], obs[0]), obs[2]])

        def improve(plan: Float[Array, " knots"], given: tuple[Array, Array]) -> tuple[Array, None]:
            samples, temperature = given
            plans = jnp.clip(plan[:, None] + samples.T, -1.0, 1.0)
            costs = self.costs(start, plans)
            weights = decay((costs - costs.min()) / temperature)
            return (plans * weights[None]).sum(1) / weights.sum(), None

        plan = jnp.zeros(self.samples.shape[-1])
        return lax.scan(improve, plan, (self.samples, self.temperature))[0][:1]

    def costs(self, start: Float[Array, "2"], plans: Float[Array, "knots plans"]) -> Float[Array, " plans"]:
        """The cost of each plan from `start`, (angle, angular velocity)."""

        def step(carry: tuple[Array, Array], actions: Float[Array, " plans"]) -> tuple[Array, Array]:
            physics, cost = carry
            after = jax.vmap(lambda p, a: _step(self.env, p, a), in_axes=-1, out_axes=-1)(physics, actions)
            return after.physics, cost - after.reward

        def knot(carry: tuple[Array, Array], actions: Float[Array, " plans"]) -> tuple[Any, None]:
            return lax.fori_loop(0, self.hold, lambda _, carry: step(carry, actions), carry), None

        nothing = jnp.zeros_like(plans[0])
        physics = jnp.stack([jnp.broadcast_to(value, nothing.shape) for value in start])
        (physics, cost), _ = lax.scan(knot, (physics, nothing), plans)
        lift = 1.5 * self.env.gravity / self.env.length
        energy = 0.5 * physics[1] * physics[1] + lift * (sin_cos(physics[0])[1] - 1.0)
        return step((physics, cost), nothing)[1] + self.energy_weight * jnp.abs(energy)


def _step(env: Env, physics: Float[Array, " physics"], action: Float[Array, ""]) -> State:
    """One step of `env` from `physics`, with its one action. What is observed before is of no interest."""
    return env.step(begin(physics, jnp.zeros(env.obs_size)), action[None])
