"""What acts: a controller, and the policy that clips it."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from gpcjax._x64 import set_public_methods_under_own_settings
from gpcjax.allowed import is_no_data, shown
from gpcjax.errors import UserError

Vector = Any
"""Real numbers as a person gives them: a list, a numpy or a jax array of one axis, traced or not. See `vector`."""


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
    """A policy with all that does not change between corrections computed beforehand. Its leaves are arrays.

    Leaves and observations may carry further axes at the END (lanes): the engine keeps lanes last, where the
    arithmetic vectorises best.
    """

    @property
    @abc.abstractmethod
    def obs_size(self) -> int:
        """Length of an observation."""

    @property
    @abc.abstractmethod
    def action_size(self) -> int:
        """Length of an action."""

    @abc.abstractmethod
    def __call__(self, obs: Float[Array, "obs *lanes"]) -> Float[Array, "action *lanes"]:
        """The action before it is clipped to [-1, 1]."""


class Planner(ByIdentity):
    """A policy whose action takes as long as thousands of steps: (obs_size,) -> (action_size,) in [-1, 1].

    The batched loops ask any other expert for all lanes at once; a planner they ask for those alone that need it.
    """

    def __call__(self, obs: Vector) -> Float[Array, " action"]:
        """What to do at `obs`: a list, a numpy or a jax array, (obs_size,)."""
        return self.plan(jnp.asarray(obs, float))

    @abc.abstractmethod
    def plan(self, obs: Float[Array, " obs"]) -> Float[Array, " action"]:
        """The same for a jax array."""


class Policy(ByIdentity):
    """A controller as a function of the observation, (obs_size,) -> (action_size,) in [-1, 1].

    It compiles itself when it is called directly, and may be used inside jit, vmap and scan. The observation may be a
    list, a numpy or a jax array.

    Raises:
        ValueError: an observation of another shape, or one that holds no real numbers.
    """

    controller: Controller

    def __call__(self, obs: Vector) -> Float[Array, " action"]:
        return _act(self.controller, vector("obs", obs, self.controller.obs_size, "this policy"))


# Inline: where a policy is part of a larger program, that program is the same as without this function.
@jax.jit(inline=True)
def _act(controller: Controller, obs: Any) -> Float[Array, " action"]:
    return jnp.clip(controller(obs), -1.0, 1.0)


def vector(name: str, value: Vector, size: int, taker: str) -> Any:
    """`value` as float64 of shape (size,), on the host unless it is jax's already: what is compiled takes either.

    Args:
        name, taker: of the message: what it is, and who takes it.
        value: a list, a numpy or a jax array of real numbers, also one that jax traces, or a list of those.
        size: how long it must be.

    Raises:
        ValueError: another shape, or anything but real numbers (no truth values, no complex numbers, no text, no spans
            of time, no masked entries).
    """
    array = value if isinstance(value, jax.Array) else _host(value)
    if array is None or not _real(array.dtype):
        raise UserError(f"{name} {shown(value)}: {taker} takes {size} real numbers")
    if array.shape != (size,):
        raise UserError(f"{name} has shape {array.shape}, {taker} takes ({size},)")
    return array if array.dtype == np.float64 else array.astype(np.float64)


def beyond(action: Any) -> Any:
    """Whether each entry of an action, traced or not, is a number beyond [-1, 1]: no such action is ever executed.

    What is no number is another matter, and of what follows from it.
    """
    size = abs(action)
    return (size > 1.0) & (size < np.inf)


def check_executed(action: Any) -> None:
    """Refuse an executed action, a checked vector, that is beyond [-1, 1]. One that jax traces passes.

    Raises:
        UserError: it is.
    """
    if not isinstance(action, Tracer) and beyond(np.asarray(action)).any():
        raise UserError(
            f"action {shown(np.asarray(action).tolist())}: each entry must be from -1 to 1, "
            "as it was executed: clip it"
        )


def _real(dtype: Any) -> bool:
    # numpy counts spans of time among the integers.
    return jnp.issubdtype(dtype, np.floating) or (jnp.issubdtype(dtype, np.integer) and dtype.kind != "m")


def _host(value: Vector) -> Array | np.ndarray | None:
    """An array of what is none yet, or None where there is no such array of data."""
    if any(map(is_no_data, value if isinstance(value, list | tuple) else (value,))):
        return None
    if isinstance(value, list | tuple) and any(isinstance(each, Tracer) for each in value):
        try:
            return jnp.stack(value)
        except (TypeError, ValueError):
            return None
    try:
        return np.asarray(value)
    except (TypeError, ValueError):  # of several lengths, or an object that refuses
        return None
