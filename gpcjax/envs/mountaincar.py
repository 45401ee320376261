"""The continuous mountain car: a valley, and a motor too weak to leave it in one go."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PRNGKeyArray

from gpcjax.elementary import sin_cos
from gpcjax.envs.base import Env, State, check_parameters, parameter
from gpcjax.errors import UserError

GOAL_REWARD = 100.0
"""For the step that reaches the goal."""

EFFORT = 0.1
"""What a step at an action of 1 or -1 costs."""

_ANY_SIGN = ("min_position", "max_position", "goal_position", "goal_velocity", "start_position")


class MountainCar(Env):
    """Swing a car out of a valley, with as little force as does it: gymnasium's MountainCarContinuous-v0.

    The floor of the valley is at -pi/6. Gymnasium calls positions metres; its task has no unit of time, so a velocity
    is a distance for each step.

    ### Action

    | Index | Meaning          | Range   | Unit                                                     |
    |-------|------------------|---------|----------------------------------------------------------|
    | 0     | force on the car | [-1, 1] | `power` (velocity gained in a step); positive to the right |

    ### Observation, which is the whole state

    | Index | Meaning       | Range                          | Unit       |
    |-------|---------------|--------------------------------|------------|
    | 0     | position x    | [`min_position`, `max_position`] | m        |
    | 1     | velocity      | [-`max_speed`, `max_speed`]    | m for each step |

    ### Parameters

    | Field            | Meaning                                                        | Default | Unit            |
    |------------------|----------------------------------------------------------------|---------|-----------------|
    | `gravity`        | velocity lost in a step at the steepest place of the right hill | 0.0025 | m for each step |
    | `power`          | velocity gained in a step at an action of 1                    | 0.0015  | m for each step |
    | `max_speed`      | the velocity is clipped to +- this                             | 0.07    | m for each step |
    | `min_position`   | wall on the left, where a car that comes to it stops           | -1.2    | m               |
    | `max_position`   | bound on the right                                             | 0.6     | m               |
    | `goal_position`  | the episode ends here or beyond,                               | 0.45    | m               |
    | `goal_velocity`  | at this velocity or above                                      | 0.0     | m for each step |
    | `start_position` | the car starts at rest, uniform around this                    | -0.5    | m               |
    | `start_range`    | by +- this                                                     | 0.1     | m               |
    | `max_steps`      | length of a full episode (static)                              | 999     |                 |

    The reward of a step is `GOAL_REWARD` where it reaches the goal, less `EFFORT` times the square of its action.

    Gymnasium keeps the state in single precision, here it is in double; and it charges an action beyond [-1, 1] in full
    while it clips the force: here, the clipped action is what was done.

    Raises:
        ValueError: a parameter is not finite or not positive (`gravity` and `start_range` may be 0, positions and the
            goal's velocity anything), or the bound on the right is not right of the wall.
    """

    gravity: Float[Array, ""] = eqx.field(default=0.0025, converter=parameter)
    power: Float[Array, ""] = eqx.field(default=0.0015, converter=parameter)
    max_speed: Float[Array, ""] = eqx.field(default=0.07, converter=parameter)
    min_position: Float[Array, ""] = eqx.field(default=-1.2, converter=parameter)
    max_position: Float[Array, ""] = eqx.field(default=0.6, converter=parameter)
    goal_position: Float[Array, ""] = eqx.field(default=0.45, converter=parameter)
    goal_velocity: Float[Array, ""] = eqx.field(default=0.0, converter=parameter)
    start_position: Float[Array, ""] = eqx.field(default=-0.5, converter=parameter)
    start_range: Float[Array, ""] = eqx.field(default=0.1, converter=parameter)
    max_steps: int = eqx.field(default=999, static=True)

    def __check_init__(self) -> None:
        check_parameters(self, may_be_zero=("gravity", "start_range"), may_be_negative=_ANY_SIGN)
        walls = self.min_position, self.max_position
        if not any(isinstance(each, Tracer) for each in walls) and not np.less(*walls).all():
            raise UserError(
                "{}: max_position must be right of min_position, got {} and {}".format(
                    self.name, *map(np.asarray, walls[::-1])
                )
            )

    @property
    def name(self) -> str:
        return "mountaincar"

    @property
    def obs_size(self) -> int:
        return 2

    @property
    def action_size(self) -> int:
        return 1

    def reset(self, key: PRNGKeyArray) -> State:
        x = self.start_position + self.start_range * jax.random.uniform(key, minval=-1.0, maxval=1.0)
        return self.begin(jnp.stack([x, jnp.zeros(())]))

    def step(self, state: State, action: Float[Array, "1"]) -> State:
        x, velocity = state.physics[0], state.physics[1]
        force = jnp.clip(action[0], -1.0, 1.0)

        velocity = velocity + force * self.power - self.gravity * sin_cos(3.0 * x)[1]
        velocity = jnp.clip(velocity, -self.max_speed, self.max_speed)
        x = jnp.clip(x + velocity, self.min_position, self.max_position)
        velocity = jnp.where((x == self.min_position) & (velocity < 0), 0.0, velocity)

        arrived = (x >= self.goal_position) & (velocity >= self.goal_velocity)
        reward = jnp.where(arrived, GOAL_REWARD, 0.0) - EFFORT * force * force
        return self.advance(state, jnp.stack([x, velocity]), reward=reward, terminated=arrived)
