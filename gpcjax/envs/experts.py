"""Experts: controllers that master a task, as functions from an observation to an action in [-1, 1].

They are written for one lane with scalar arithmetic only, since they run with the lanes on the last axis.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gpcjax.elementary import tanh
from gpcjax.envs.base import parameter
from gpcjax.envs.cartpole import CartPole
from gpcjax.policies.base import ByIdentity


class LQR(ByIdentity):
    """The linear-quadratic regulator of a cart-pole: a = -(gain . obs), clipped.

    The gain solves the discrete algebraic Riccati equation of the task linearised upright, with the explicit
    Euler step that it simulates; so construction needs concrete parameters, while the gain itself is traced.

    Arguments: `env`, by default `CartPole()`; `state_cost`, the diagonal of Q for (x, x_dot, theta, theta_dot) in
    SI units; `action_cost`, R for an action in units of the largest force.
    """

    gain: Float[Array, "4"]

    def __init__(
        self,
        env: CartPole | None = None,
        state_cost: Sequence[float] = (1.0, 1.0, 10.0, 1.0),
        action_cost: float = 1.0,
    ) -> None:
        from scipy.linalg import solve_discrete_are

        a, b = linearise(CartPole() if env is None else env)
        r = np.array([[action_cost]])
        p = solve_discrete_are(a, b, np.diag(state_cost), r)
        self.gain = jnp.asarray(np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)[0])

    def __call__(self, obs: Float[Array, "4"]) -> Float[Array, "1"]:
        k = self.gain
        action = -(k[0] * obs[0] + k[1] * obs[1] + k[2] * obs[2] + k[3] * obs[3])
        return jnp.clip(action, -1.0, 1.0)[None]


def linearise(env: CartPole) -> tuple[np.ndarray, np.ndarray]:
    """The matrices A (4, 4) and B (4, 1) of one step of `env` near its upright rest: s' = A s + B a."""
    half_length, pole_mass, tau = float(env.half_length), float(env.pole_mass), float(env.tau)
    mass = float(env.cart_mass) + pole_mass
    leverage = half_length * (4.0 / 3.0 - pole_mass / mass)
    coupling = pole_mass * half_length / mass
    theta_per_theta, theta_per_force = float(env.gravity) / leverage, -1.0 / (mass * leverage)
    drift = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, -coupling * theta_per_theta, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, theta_per_theta, 0.0],
        ]
    )
    push = np.array([[0.0], [1.0 / mass - coupling * theta_per_force], [0.0], [theta_per_force]])
    return np.eye(4) + tau * drift, tau * float(env.max_force) * push


class EnergySwingUp(ByIdentity):
    """Pumps a pendulum to its upright energy and fades into a stabiliser near the top.

    With the energy E = theta_dot^2 / 2 + lift * (cos(theta) - 1), zero at upright rest, and the weight
    w = sigmoid((cos(theta) - fade_at) / fade_width), the action is the clip of

        w * -(angle_gain * sin(theta) + speed_gain * theta_dot)
        + (1 - w) * pump_gain * (surplus - E) * (theta_dot + lead * sin(theta))

    Without the lead, a torque always follows the motion; with it, the torque turns a little before the swing does.

    | Field        | Meaning                                                    | Default | Unit        |
    |--------------|------------------------------------------------------------|---------|-------------|
    | `lift`       | 3 g / (2 l) of the pendulum                                | 15.0    | 1/s^2       |
    | `pump_gain`  | action for each unit of missing energy times speed         | 0.2     | s^3         |
    | `surplus`    | energy aimed at above that of upright rest, to arrive soon | 1.2     | 1/s^2       |
    | `lead`       | how early the pumping torque turns                         | 1.7     | 1/s         |
    | `angle_gain` | stabiliser, action for the sine of the angle               | 6.5     |             |
    | `speed_gain` | stabiliser, action for the angular velocity                | 1.6     | s           |
    | `fade_at`    | cosine at which both laws weigh the same (0.7 is 46 deg)   | 0.7     |             |
    | `fade_width` | of the sigmoid, in the cosine                              | 0.1     |             |

    The defaults were tuned on the default `Pendulum` (the mean return is flat around them). The law is smooth up to the
    clip, so nearby states get nearby advice.
    """

    lift: Float[Array, ""] = eqx.field(default=15.0, converter=parameter)
    pump_gain: Float[Array, ""] = eqx.field(default=0.2, converter=parameter)
    surplus: Float[Array, ""] = eqx.field(default=1.2, converter=parameter)
    lead: Float[Array, ""] = eqx.field(default=1.7, converter=parameter)
    angle_gain: Float[Array, ""] = eqx.field(default=6.5, converter=parameter)
    speed_gain: Float[Array, ""] = eqx.field(default=1.6, converter=parameter)
    fade_at: Float[Array, ""] = eqx.field(default=0.7, converter=parameter)
    fade_width: Float[Array, ""] = eqx.field(default=0.1, converter=parameter)

    def __call__(self, obs: Float[Array, "3"]) -> Float[Array, "1"]:
        cos, sin, theta_dot = obs[0], obs[1], obs[2]
        energy = 0.5 * theta_dot * theta_dot + self.lift * (cos - 1.0)
        stabilise = -(self.angle_gain * sin + self.speed_gain * theta_dot)
        pump = self.pump_gain * (self.surplus - energy) * (theta_dot + self.lead * sin)
        weight = jax.nn.sigmoid((cos - self.fade_at) / self.fade_width)
        return jnp.clip(weight * stabilise + (1.0 - weight) * pump, -1.0, 1.0)[None]


class ValleyPump(ByIdentity):
    """Pumps a mountain car out of its valley: it pushes the way the car moves.

    The action is strength * tanh((velocity + nudge) / width).

    | Field      | Meaning                                                            | Default | Unit            |
    |------------|--------------------------------------------------------------------|---------|-----------------|
    | `strength` | the largest action                                                 | 0.5     |                 |
    | `width`    | velocity from which on the push is about the largest               | 0.01    | m for each step |
    | `nudge`    | added to the velocity: a car at rest on the valley's floor is pushed | 0.001 | m for each step |

    A push costs its square and adds energy in proportion to itself, so that a weak and long one is the cheapest: at a
    strength of 0.25 the mean return of the default `MountainCar` is 98.7, here it is 97.0, at full strength 93.0. But
    below 0.19 a swing from the wall on the left does not reach the goal, and a learner that comes only near to its
    expert needs some distance from there.
    """

    strength: Float[Array, ""] = eqx.field(default=0.5, converter=parameter)
    width: Float[Array, ""] = eqx.field(default=0.01, converter=parameter)
    nudge: Float[Array, ""] = eqx.field(default=0.001, converter=parameter)

    def __call__(self, obs: Float[Array, "2"]) -> Float[Array, "1"]:
        action = self.strength * tanh((obs[1] + self.nudge) / self.width)
        return jnp.clip(action, -1.0, 1.0)[None]


class LanderHeuristic(ByIdentity):
    """Gymnasium's demonstration controller of the continuous lunar lander: the same law, for one lane.

    The lander leans towards the pad, by at most `lean`, and keeps a height in proportion to its distance from it; both
    with a proportional and a derivative term. With a leg on the ground it only brakes.

    | Field         | Meaning                                                  | Default |
    |---------------|----------------------------------------------------------|---------|
    | `lean`        | largest angle aimed at (rad)                             | 0.4     |
    | `glide`       | height aimed at for each unit of horizontal distance     | 0.55    |
    | `sensitivity` | action for a unit of what is to be done                  | 20.0    |

    Source of the law and its numbers: `gymnasium.envs.box2d.lunar_lander.heuristic`.
    """

    lean: Float[Array, ""] = eqx.field(default=0.4, converter=parameter)
    glide: Float[Array, ""] = eqx.field(default=0.55, converter=parameter)
    sensitivity: Float[Array, ""] = eqx.field(default=20.0, converter=parameter)

    def __call__(self, obs: Float[Array, "8"]) -> Float[Array, "2"]:
        x, y, x_dot, y_dot, angle, spin, left, right = (obs[i] for i in range(8))
        angle_target = jnp.clip(0.5 * x + x_dot, -self.lean, self.lean)
        turn = 0.5 * (angle_target - angle) - spin
        climb = 0.5 * (self.glide * jnp.abs(x) - y) - 0.5 * y_dot
        landed = (left != 0) | (right != 0)
        turn, climb = jnp.where(landed, 0.0, turn), jnp.where(landed, -0.5 * y_dot, climb)
        return jnp.clip(jnp.stack([self.sensitivity * climb - 1.0, -self.sensitivity * turn]), -1.0, 1.0)
