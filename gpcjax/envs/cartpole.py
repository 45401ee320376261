"""Cart-pole with a continuous force (thesis 4.2.2)."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gpcjax.elementary import sin_cos
from gpcjax.envs.base import Env, State, begin, check_parameters, parameter


class CartPole(Env):
    """Keep a pole upright by pushing the cart under it: gymnasium's CartPole-v1 with a continuous force.

    ### Action

    | Index | Meaning           | Range   | Unit                                |
    |-------|-------------------|---------|-------------------------------------|
    | 0     | force on the cart | [-1, 1] | `max_force` (N); positive to the right |

    ### Observation, which is the whole state

    | Index | Meaning                                        | Episode ends beyond | Unit  |
    |-------|------------------------------------------------|---------------------|-------|
    | 0     | cart position x                                | `max_position`      | m     |
    | 1     | cart velocity                                  |                     | m/s   |
    | 2     | pole angle theta, 0 upright, positive to the right | `max_angle`     | rad   |
    | 3     | pole angular velocity                          |                     | rad/s |

    ### Parameters

    | Field          | Meaning                              | Default          | Unit  |
    |----------------|--------------------------------------|------------------|-------|
    | `gravity`      | g                                    | 9.8              | m/s^2 |
    | `cart_mass`    | M                                    | 1.0              | kg    |
    | `pole_mass`    | m                                    | 0.1              | kg    |
    | `half_length`  | L, from the pivot to the pole's centre | 0.5            | m     |
    | `max_force`    | force at an action of 1              | 10.0             | N     |
    | `tau`          | time of a step, explicit Euler       | 0.02             | s     |
    | `max_position` | bound on the absolute position       | 2.4              | m     |
    | `max_angle`    | bound on the absolute angle          | 0.2094 (12 deg)  | rad   |
    | `start_range`  | every state starts uniform in +- this | 0.05            | m, m/s, rad, rad/s |
    | `max_steps`    | length of a full episode (static)    | 2500             |       |

    The reward is 1 for every step, the one that leaves the bounds included. The pole is gymnasium's uniform rod (hence
    the factor 4/3 below), where the equations printed in the thesis have a point mass.

    Raises:
        ValueError: a parameter is not finite or not positive (`gravity`, `pole_mass` and `start_range` may be 0).
    """

    gravity: Float[Array, ""] = eqx.field(default=9.8, converter=parameter)
    cart_mass: Float[Array, ""] = eqx.field(default=1.0, converter=parameter)
    pole_mass: Float[Array, ""] = eqx.field(default=0.1, converter=parameter)
    half_length: Float[Array, ""] = eqx.field(default=0.5, converter=parameter)
    max_force: Float[Array, ""] = eqx.field(default=10.0, converter=parameter)
    tau: Float[Array, ""] = eqx.field(default=0.02, converter=parameter)
    max_position: Float[Array, ""] = eqx.field(default=2.4, converter=parameter)
    max_angle: Float[Array, ""] = eqx.field(default=math.radians(12), converter=parameter)
    start_range: Float[Array, ""] = eqx.field(default=0.05, converter=parameter)
    max_steps: int = eqx.field(default=2500, static=True)

    def __check_init__(self) -> None:
        check_parameters(self, may_be_zero=("gravity", "pole_mass", "start_range"))

    @property
    def name(self) -> str:
        return "cartpole"

    @property
    def obs_size(self) -> int:
        return 4

    @property
    def action_size(self) -> int:
        return 1

    def reset(self, key: PRNGKeyArray) -> State:
        physics = self.start_range * jax.random.uniform(key, (4,), minval=-1.0, maxval=1.0)
        return begin(physics, physics)

    def step(self, state: State, action: Float[Array, "1"]) -> State:
        x, x_dot, theta, theta_dot = (state.physics[i] for i in range(4))
        force = self.max_force * jnp.clip(action[0], -1.0, 1.0)
        sin, cos = sin_cos(theta)

        mass = self.cart_mass + self.pole_mass
        moment = self.pole_mass * self.half_length
        push = (force + moment * theta_dot * theta_dot * sin) / mass
        leverage = self.half_length * (4.0 / 3.0 - self.pole_mass * cos * cos / mass)
        theta_acc = (self.gravity * sin - cos * push) / leverage
        x_acc = push - moment * theta_acc * cos / mass

        x, x_dot = x + self.tau * x_dot, x_dot + self.tau * x_acc
        theta, theta_dot = theta + self.tau * theta_dot, theta_dot + self.tau * theta_acc

        physics = jnp.stack([x, x_dot, theta, theta_dot])
        time = state.time + 1
        return State(
            physics=physics,
            obs=physics,
            reward=jnp.ones(()),
            terminated=(jnp.abs(x) > self.max_position) | (jnp.abs(theta) > self.max_angle),
            truncated=time >= self.max_steps,
            time=time,
        )
