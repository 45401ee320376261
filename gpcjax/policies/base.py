"""What acts in jax: a controller, whose actions a policy (`gpcjax.policies.policy`) clips."""

import abc
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

import gpcjax.policies.pytree  # noqa: F401  (policies are part of jax wherever it is used)
from gpcjax._x64 import set_public_methods_under_own_settings, under_own_settings
from gpcjax.errors import ForeignError
from gpcjax.policies.policy import Policy as Policy
from gpcjax.policies.vectors import Vector as Vector
from gpcjax.policies.vectors import beyond as beyond
from gpcjax.policies.vectors import check_executed as check_executed
from gpcjax.policies.vectors import is_traced
from gpcjax.policies.vectors import near as near
from gpcjax.policies.vectors import vector as vector
from gpcjax.recent import recent


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

    def in_use(self, lanes: Bool[Array, " lanes"]) -> Callable[[Array], Array]:
        """What acts in the same way for a block, and need not look at what none of these lanes has learned.

        The actions of a lane do not depend on the others, to the bit. For leaves with one axis of lanes at the end.
        """
        return self


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


@under_own_settings
def acted(controller: Controller, obs: Vector) -> Float[Array, " action"]:
    """The action of a controller at one observation, clipped to [-1, 1]: compiled, or part of what jax traces.

    Raises:
        ValueError: an observation of another shape, or one that holds no real numbers.
    """
    obs = vector("obs", obs, controller.obs_size, "this policy")
    leaves, form = jax.tree.flatten(controller)
    if type(controller).__module__.startswith("gpcjax.policies.") or any(map(is_traced, (obs, *leaves))):
        return _act(controller, obs)
    # A function of its own: jax keeps what it compiled for as long as the function is there.
    return recent(_programs, form, lambda: jax.jit(lambda *given: _acting(*given)), KEPT)(controller, obs)


KEPT = 64
"""Programs of policies of somebody's own that are kept: one with a function in a field is of another kind with each."""
_programs: OrderedDict[Any, Callable[..., Any]] = OrderedDict()


def _acting(controller: Controller, obs: Any) -> Float[Array, " action"]:
    action = controller(near(obs))
    if getattr(action, "shape", None) != (controller.action_size,):
        raise ForeignError(
            f"the policy of {type(getattr(controller, 'learner', controller)).__name__} does not fit",
            f"an action is {_worded(action)}, it should be of shape ({controller.action_size},)",
        )
    return jnp.clip(action, -1.0, 1.0)


# Inline: where a policy is part of a larger program, that program is the same as without this function.
_act = jax.jit(_acting, inline=True)


def _worded(action: Any) -> str:
    shape = getattr(action, "shape", None)
    return f"a {type(action).__name__}" if shape is None else f"of shape {shape}"
