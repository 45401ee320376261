"""The shape of an environment: brax's reset and step, with `terminated` and `truncated` kept apart."""

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int32, PRNGKeyArray, PyTree

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import STEPS, checked, converted, holds_numbers, shown
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
    def name(self) -> str:
        """The name that messages have for this task."""
        return type(self).__name__

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

    def begin(self, physics: PyTree[Array], obs: Float[Array, " obs"] | None = None) -> State:
        """What `reset` gives: an episode that starts at `physics`, which is seen as it is unless `obs` is given."""
        return begin(physics, physics if obs is None else obs)

    def advance(
        self,
        state: State,
        physics: PyTree[Array],
        obs: Float[Array, " obs"] | None = None,
        *,
        reward: Any,
        terminated: Any = False,
    ) -> State:
        """What `step` gives: a step from `state` to `physics`, truncated after `max_steps`."""
        time = state.time + 1
        return State(
            physics=physics,
            obs=physics if obs is None else obs,
            reward=jnp.asarray(reward, float),
            terminated=jnp.asarray(terminated, bool),
            truncated=time >= self.max_steps,
            time=time,
        )


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


def started(env: Env, key: PRNGKeyArray) -> State:
    """`env.reset(key)`, as far as shapes and types go what `State` says. Consumes `key`; costs nothing once compiled.

    Raises:
        UserError: it is something else; the message names the class of the task and the field.
    """
    return fitted(env, "reset", env.reset(key))


def stepped(env: Env, state: State, action: Float[Array, " action"]) -> State:
    """`env.step(state, action)`, checked likewise: physics have the form that they had, and `max_steps` end it.

    Raises:
        UserError: as `started`, or the state has other parts than before.
    """
    after = fitted(env, "step", env.step(state, action))
    if not _counts(env):
        after = limited(env, state, after)
    if type(after) is not type(state):
        kinds = type(after).__name__, type(state).__name__
        raise UserError("{}: step gives a {}, reset a {}".format(type(env).__name__, *kinds))
    for name in (each.name for each in dataclasses.fields(state) if each.name not in _CAST):
        _check_form(f"{type(env).__name__}.step: {name}", getattr(after, name), getattr(state, name))
    return after


def limited(env: Env, before: State, after: State) -> State:
    """A state whose time is one step further, and which is truncated after `max_steps`, whatever its task says."""
    time = before.time + 1
    return _replaced(after, {"time": time, "truncated": after.truncated | (time >= env.max_steps)})


def _counts(env: Env) -> bool:
    """Whether the step is one of ours, which counts and truncates: their programs stay as they are, to the bit."""
    return type(env).step.__module__.startswith("gpcjax.")


def _check_form(source: str, new: Any, old: Any) -> None:
    (leaves, structure), (others, before) = map(jax.tree.flatten, (new, old))
    fits = structure == before and all(
        jnp.shape(a) == jnp.shape(b) and (_dtype(a) == _dtype(b) or jnp.result_type(a, b) == _dtype(b))
        for a, b in zip(leaves, others, strict=True)
    )
    if not fits:
        forms = (jax.tree.map(_form, each) for each in (new, old))
        raise UserError("{} becomes {}, it was {}".format(source, *map(shown, forms)))


_CAST = ("obs", "reward", "terminated", "truncated", "time")
"""Fields of a state that have a type and a shape of their own; all else is the task's."""


def fitted(env: Env, method: str, state: Any) -> State:
    """A state as the loops carry it: real numbers as float64, counts as int32, flags as they are.

    Raises:
        UserError: it is no state, or has fields of another form; `method` is what gave it.
    """
    who = f"{type(env).__name__}.{method}"
    if not isinstance(state, State):
        raise UserError(f"{who} gives a {type(state).__name__}, declared is a State (gpcjax.envs.base)")
    real = (np.floating, np.integer), np.float64
    declared = {
        "obs": ((env.obs_size,), "real numbers", *real),
        "reward": ((), "a real number", *real),
        "terminated": ((), "a truth value", (np.bool_,), np.bool_),
        "truncated": ((), "a truth value", (np.bool_,), np.bool_),
        "time": ((), "a whole number", (np.integer,), np.int32),
    }
    changed: dict[str, Any] = {}
    for name, (shape, words, kinds, dtype) in declared.items():
        value = getattr(state, name)
        found = _dtype(value)
        kinds_fit = found is not None and any(jnp.issubdtype(found, kind) for kind in kinds)
        if not kinds_fit or jnp.shape(value) != shape:
            raise UserError(f"{who}: {name} is {_form(value)}, declared is {words} of shape {shape}")
        if not (isinstance(value, jax.Array) and found == dtype):
            changed[name] = jnp.asarray(value, dtype)
    return _replaced(state, changed) if changed else state


def _replaced(state: State, fields: Mapping[str, Any]) -> State:
    """The state with other values of these fields; of a subclass that has more fields, with those too."""
    return eqx.tree_at(lambda state: [getattr(state, name) for name in fields], state, [*fields.values()])


def _dtype(value: Any) -> Any:
    """That of an array or a number; None for anything else."""
    if isinstance(value, bool | int | float):
        return jnp.result_type(value)
    return getattr(value, "dtype", None)


def _form(value: Any) -> str:
    """Type and shape of an array, or what else it is."""
    dtype = getattr(value, "dtype", None)
    return shown(value) if dtype is None else f"{dtype} of shape {jnp.shape(value)}"


@under_own_settings
def parameter(value: Any) -> Float[Array, "*lanes"]:
    """Converter of a field that is a number (`eqx.field(converter=gpcjax.parameter)`): a float64 array leaf, ().

    It has lanes where a module of several, whose fields are converted once more, is replaced.

    Args:
        value: a number, or an array of them; in whatever unit the field has.

    Raises:
        ValueError: it is no real number.
    """
    if converted(float, value) is None and not holds_numbers(value):
        raise UserError(f"a physical parameter is {shown(value)}: give a number")
    return jnp.asarray(value, jnp.float64)


def check_parameters(
    env: Env, *, may_be_zero: tuple[str, ...] = (), may_be_negative: tuple[str, ...] = ()
) -> None:
    """Refuse what no physics has. Traced values cannot be looked at and pass.

    Raises:
        ValueError: a parameter is not finite or not above zero (a few may be zero, or of any sign), or `max_steps` is
            no whole number of at least 1.
    """
    checked(f"{env.name}: max_steps", env.max_steps, int, STEPS)
    for name, value in vars(env).items():
        if name == "max_steps" or isinstance(value, Tracer):
            continue
        concrete, least = np.asarray(value), ""
        possible = np.isfinite(concrete)
        if name in may_be_zero:
            possible, least = possible & (concrete >= 0), " and >= 0"
        elif name not in may_be_negative:
            possible, least = possible & (concrete > 0), " and > 0"
        if not possible.all():
            raise UserError(f"{env.name}: {name} must be finite{least}, got {concrete}")
