"""The underactuated inverted pendulum (thesis 4.2.1)."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, Scalar

from gpcjax.elementary import sin_cos
from gpcjax.envs.base import Env, State, begin, check_parameters, parameter


class Pendulum(Env):
    """Swing a rod up and hold it there with a motor too weak to lift it: gymnasium's Pendulum-v1.

    ### Action

    | Index | Meaning             | Range   | Unit                                        |
    |-------|---------------------|---------|---------------------------------------------|
    | 0     | torque at the pivot | [-1, 1] | `max_torque` (N m); positive turns theta up |

    ### Observation

    | Index | Meaning          | Range                    | Unit  |
    |-------|------------------|--------------------------|-------|
    | 0     | cos(theta)       | [-1, 1]; 1 is upright    |       |
    | 1     | sin(theta)       | [-1, 1]                  |       |
    | 2     | angular velocity | [-`max_speed`, `max_speed`] | rad/s |

    `physics` is (theta, angular velocity), theta unwrapped.

    ### Parameters

    | Field         | Meaning                                    | Default | Unit  |
    |---------------|--------------------------------------------|---------|-------|
    | `gravity`     | g                                          | 10.0    | m/s^2 |
    | `mass`        | m, of a uniform rod                        | 1.0     | kg    |
    | `length`      | l                                          | 1.0     | m     |
    | `max_torque`  | torque at an action of 1                   | 2.0     | N m   |
    | `max_speed`   | the angular velocity is clipped to +- this | 8.0     | rad/s |
    | `tau`         | time of a step, semi-implicit Euler        | 0.05    | s     |
    | `start_angle` | theta starts uniform in +- this            | pi      | rad   |
    | `start_speed` | angular velocity starts uniform in +- this | 1.0     | rad/s |
    | `max_steps`   | length of an episode (static)              | 200     |       |

    The reward is minus the cost of the state the step began in and of its torque u,
    theta^2 + 0.1 theta_dot^2 + 0.001 u^2 with theta in [-pi, pi). An episode never terminates.

    Raises:
        ValueError: a parameter is not finite or not positive (`gravity`, `start_angle`, `start_speed` may be 0).
    """

    gravity: Float[Array, ""] = eqx.field(default=10.0, converter=parameter)
    mass: Float[Array, ""] = eqx.field(default=1.0, converter=parameter)
    length: Float[Array, ""] = eqx.field(default=1.0, converter=parameter)
    max_torque: Float[Array, ""] = eqx.field(default=2.0, converter=parameter)
    max_speed: Float[Array, ""] = eqx.field(default=8.0, converter=parameter)
    tau: Float[Array, ""] = eqx.field(default=0.05, converter=parameter)
    start_angle: Float[Array, ""] = eqx.field(default=math.pi, converter=parameter)
    start_speed: Float[Array, ""] = eqx.field(default=1.0, converter=parameter)
    max_steps: int = eqx.field(default=200, static=True)

    def __check_init__(self) -> None:
        check_parameters(self, may_be_zero=("gravity", "start_angle", "start_speed"))

    @property
    def name(self) -> str:
        return "pendulum"

    @property
    def obs_size(self) -> int:
        return 3

    @property
    def action_size(self) -> int:
        return 1

    def reset(self, key: PRNGKeyArray) -> State:
        unit = jax.random.uniform(key, (2,), minval=-1.0, maxval=1.0)
        theta, theta_dot = self.start_angle * unit[0], self.start_speed * unit[1]
        return begin(jnp.stack([theta, theta_dot]), _observe(theta, theta_dot))

    def step(self, state: State, action: Float[Array, "1"]) -> State:
        theta, theta_dot = state.physics[0], state.physics[1]
        torque = self.max_torque * jnp.clip(action[0], -1.0, 1.0)
        angle = _normalise(theta)
        cost = angle * angle + 0.1 * theta_dot * theta_dot + 0.001 * torque * torque

        falling = 3.0 * self.gravity / (2.0 * self.length) * sin_cos(theta)[0]
        turning = 3.0 / (self.mass * self.length * self.length) * torque
        theta_dot = jnp.clip(theta_dot + (falling + turning) * self.tau, -self.max_speed, self.max_speed)
        theta = theta + theta_dot * self.tau

        time = state.time + 1
        return State(
            physics=jnp.stack([theta, theta_dot]),
            obs=_observe(theta, theta_dot),
            reward=-cost,
            terminated=jnp.zeros((), bool),
            truncated=time >= self.max_steps,
            time=time,
        )


def _observe(theta: Scalar, theta_dot: Scalar) -> Float[Array, "3"]:
    sin, cos = sin_cos(theta)
    return jnp.stack([cos, sin, theta_dot])


def _normalise(theta: Scalar) -> Scalar:
    """The angle in [-pi, pi), by a floor: a remainder would be a call of fmod for every lane."""
    turn = 2.0 * math.pi
    return theta - turn * jnp.floor((theta + math.pi) / turn)
