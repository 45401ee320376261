"""The shape of an environment: brax's reset and step, with `terminated` and `truncated` kept apart."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int32, PRNGKeyArray, PyTree, Scalar

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import STEPS, checked, converted, is_no_data, shown
from gpcjax.errors import UserError
from gpcjax.policies.base import ByIdentity


class State(eqx.Module):
    """One lane of an environment, after a reset or a step.

    | Field        | Shape, type           | Meaning                                                      |
    |--------------|-----------------------|--------------------------------------------------------------|
    | `physics`    | pytree of arrays      | the full state; our own tasks keep one array of shape (n,)   |
    | `obs`        | (obs_size,) float     | what a policy sees                                           |
    | `reward`     | () float              | of the step that led here; 0 after a reset                   |
    | `terminated` | () bool               | the task itself ended: a limit was passed                    |
    | `truncated`  | () bool               | `max_steps` were taken; both flags may be raised at once     |
    | `time`       | () int32              | steps taken in this episode                                  |
    """

    physics: PyTree[Array]
    obs: Float[Array, " obs"]
    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]
    time: Int32[Array, ""]

    @property
    def done(self) -> Bool[Array, " *lanes"]:
        """The episode is over, for either reason."""
        return self.terminated | self.truncated


class Env(ByIdentity):
    """A task for one lane; `jax.vmap` makes the batch.

    Physical parameters are array leaves, so a study over them is a vmap too; names and sizes are static.
    Nothing resets by itself: a step beyond `done` goes on with the same physics and means nothing.
    """

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """The name under which results of this task are kept."""

    @property
    @abc.abstractmethod
    def obs_size(self) -> int:
        """Length of an observation."""

    @property
    @abc.abstractmethod
    def action_size(self) -> int:
        """Length of an action."""

    max_steps: eqx.AbstractVar[int]

    @abc.abstractmethod
    def reset(self, key: PRNGKeyArray) -> State:
        """Begin an episode at a random start. Consumes `key`; all the randomness of a task is here."""

    @abc.abstractmethod
    def step(self, state: State, action: Float[Array, " action"]) -> State:
        """Advance by one step with `action`, each component clipped to [-1, 1]."""


def begin(physics: PyTree[Array], obs: Float[Array, " obs"]) -> State:
    """The state of an episode that starts at `physics`."""
    return State(
        physics=physics,
        obs=obs,
        reward=jnp.zeros(()),
        terminated=jnp.zeros((), bool),
        truncated=jnp.zeros((), bool),
        time=jnp.zeros((), jnp.int32),
    )


@under_own_settings
def parameter(value: Any) -> Scalar:
    """Converter of a physical parameter: a float64 array leaf. Raises ValueError for what is no real number."""
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    if converted(float, value) is None and (kind not in tuple("fiu") or is_no_data(value)):
        raise UserError(f"a physical parameter is {shown(value)}: give a number")
    return jnp.asarray(value, jnp.float64)


def check_parameters(env: Env, *, may_be_zero: tuple[str, ...] = ()) -> None:
    """Refuse what no physics has. Traced values cannot be looked at and pass.

    Raises:
        ValueError: a parameter is not finite or not above zero (a few may be zero), or `max_steps` is no
            whole number of at least 1.
    """
    checked(f"{env.name}: max_steps", env.max_steps, int, STEPS)
    for name, value in vars(env).items():
        if name == "max_steps" or isinstance(value, Tracer):
            continue
        concrete, zero = np.asarray(value), name in may_be_zero
        if not (np.isfinite(concrete) & ((concrete >= 0) if zero else (concrete > 0))).all():
            raise UserError(
                f"{env.name}: {name} must be finite and {'>= 0' if zero else '> 0'}, got {concrete}"
            )
