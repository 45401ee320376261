"""What acts: a controller, and the policy that clips it."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gpcjax._x64 import set_public_methods_under_own_settings


class Computing(eqx.Module):
    """A module whose public methods compute in float64, and otherwise too under our own settings of jax."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        set_public_methods_under_own_settings(cls)


class ByIdentity(Computing):
    """A module hashed and compared as an object, so that `jax.jit(env.step)` works though arrays have no hash."""

    def __hash__(self) -> int:
        return id(self)

    def __eq__(self, other: object) -> bool:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self is other


class Controller(Computing):
    """A policy with all that does not change between corrections computed beforehand.

    Leaves and observations may carry further axes at the END (lanes): the engine keeps lanes last, where the
    arithmetic vectorises best.
    """

    @abc.abstractmethod
    def __call__(self, obs: Float[Array, "obs *lanes"]) -> Float[Array, "action *lanes"]:
        """The action before it is clipped to [-1, 1]."""


class Planner(ByIdentity):
    """A policy whose action takes as long as thousands of steps: (obs_size,) -> (action_size,) in [-1, 1].

    The batched loops ask any other expert for all lanes at once; a planner they ask for those alone that need it.
    """

    @abc.abstractmethod
    def __call__(self, obs: Float[Array, " obs"]) -> Float[Array, " action"]:
        """What to do at `obs`."""


class Policy(ByIdentity):
    """A controller as a function of the observation, (obs_size,) -> (action_size,) in [-1, 1]."""

    controller: Controller

    def __call__(self, obs: Float[Array, " obs"]) -> Float[Array, " action"]:
        return jnp.clip(self.controller(obs), -1.0, 1.0)
