"""Experts from elsewhere: a function of a person's own module, or the folder of a saved policy."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from gpcjax import registry
from gpcjax.allowed import shown
from gpcjax.elsewhere import path_here
from gpcjax.envs.foreign import sizes_of
from gpcjax.envs.registry import is_folder, make_env
from gpcjax.errors import ForeignError, UserError

_EXPERT = "a function of an observation, or a class or function without arguments that makes one"


def expert(env_name: str, name: str | Callable[..., Any]) -> Callable[[Any], Any]:
    """The expert of a task that is no built-in one: a folder of a saved policy, `module:function`, or the function.

    Raises:
        UserError: it is none, or one for observations or actions of another size.
        ForeignError: its module or the function itself fails.
    """
    source = f"oracle {name if isinstance(name, str) else shown(name)}"
    if not isinstance(name, str):
        return _function(source, env_name, name)
    if is_folder(name):
        load = registry.resolve("gpcjax.policies.saved:load_policy")
        found = load(Path(path_here(name)))
        made = _sizes(env_name)
        has = found.controller.obs_size, found.controller.action_size
        if has != tuple(made):
            raise UserError(
                f"{source}: this policy takes {has[0]} observations and gives {has[1]} actions, {env_name} has "
                f"{made[0]} and {made[1]}"
            )
        return found
    return _function(source, env_name, _imported(source, name))


def check_expert(env_name: str, entry: str | Callable[..., Any], source: str) -> None:
    """Looks at a function, or at the one that `module:function` names, as `expert` does; what makes one is not called.

    Raises:
        UserError, ForeignError: as `expert` does. `source` begins the message.
    """
    found = entry if callable(entry) else _imported(source, entry)
    if _takes_observation(source, found):
        _function(source, env_name, found)


def _imported(source: str, name: str) -> Callable[..., Any]:
    found = registry.imported(name, source)
    if not callable(found):
        raise UserError(f"{source}: {shown(found)} is none, give {_EXPERT}")
    return found


def _takes_observation(source: str, found: Callable[..., Any]) -> bool:
    """Whether this is the expert itself, and not a class or a function that makes one.

    Raises:
        UserError: Python cannot tell which arguments it takes.
    """
    try:
        parameters = inspect.signature(found).parameters.values()
    except ValueError:
        raise UserError(
            f"{source}: Python cannot tell the arguments of {shown(found)}, give {_EXPERT}"
        ) from None
    at_places = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    takes = any(each.default is each.empty and each.kind in at_places for each in parameters)
    return takes and not inspect.isclass(found)


def _function(source: str, env_name: str, found: Any) -> Callable[[Any], Any]:
    """A function of an observation, made first where it is a class or a function without arguments."""
    obs_size, action_size = _sizes(env_name)
    is_expert = _takes_observation(source, found)
    try:
        function = found if is_expert else found()
        if not callable(function):
            raise UserError(f"{source}: {shown(function)} is none, give {_EXPERT}")
        shape = jax.eval_shape(function, jax.ShapeDtypeStruct((obs_size,), float))
    except UserError:
        raise
    except Exception as error:
        raise ForeignError(f"{source}: it fails at an observation of {obs_size} numbers", error) from None
    size = getattr(shape, "shape", None)
    if size != (action_size,):
        raise UserError(f"{source}: its action has shape {size}, {env_name} takes ({action_size},)")
    return lambda obs: jnp.clip(jnp.asarray(function(obs), float), -1.0, 1.0)


def _sizes(env_name: str) -> tuple[int, int]:
    return registry.find("task", env_name).sizes or sizes_of(make_env(env_name))
