"""Tasks and experts from elsewhere: a person's own module, gymnasium by `gym:ID`, brax by `brax:NAME`."""

import functools
import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gpcjax import registry
from gpcjax.allowed import shown
from gpcjax.describe import TaskSpec
from gpcjax.elsewhere import path_here
from gpcjax.envs.base import Env, State, started, stepped
from gpcjax.envs.brax_adapter import brax_env
from gpcjax.envs.brax_tasks import KNOWN, Known
from gpcjax.envs.host import UNLIMITED, HostEnv, gym_env
from gpcjax.envs.registry import is_folder, make_env
from gpcjax.errors import ForeignError, UserError
from gpcjax.making import Maker

_EXPERT = "a function of an observation, or a class or function without arguments that makes one"


def described_elsewhere(prefix: str, name: str) -> TaskSpec:
    """The description of `gym:ID` or `brax:NAME`.

    Raises:
        UserError: there is no such task, or it is one that cannot be taught.
    """
    full = f"{prefix}:{name}"
    if prefix == "gym":
        make: Any = functools.partial(gym_env, name)
        made: Env | HostEnv = _refusing(full, make)
        return TaskSpec(full, make, on_host=True, sizes=_sizes_of(made), time_step=_time_step(made))
    known = KNOWN.get(name, Known("", ""))
    make = functools.partial(brax_env, name, name=full, max_steps=known.max_steps)
    made = _refusing(full, make)
    return TaskSpec(
        full,
        make,
        experts=known.experts,
        label=known.label,
        unit=known.unit,
        actions=known.actions,
        sizes=_sizes_of(made),
        time_step=_time_step(made),
    )


def _sizes_of(env: Env | HostEnv) -> tuple[int, int]:
    return env.obs_size, env.action_size


def _time_step(env: Env | HostEnv) -> float | None:
    """Seconds of a step, where a task says so: by a number `time_step`, as brax's `dt`, or as gymnasium's frames."""
    said = getattr(env, "time_step", None)
    return float(said) if isinstance(said, int | float) and math.isfinite(said) and said > 0 else None


def _refusing(name: str, make: Callable[[], Any]) -> Any:
    """What `make` makes; what refuses it speaks of the setting."""
    try:
        return make()
    except ImportError as error:
        raise UserError(f"env {name}: {error}; a part of it is not installed") from None
    except ValueError as error:
        raise UserError(f"env {error}") from None


def task_of(name: str, found: Callable[..., Any]) -> TaskSpec:
    """The description of a task of a person's own: a class, or a function, that makes it without arguments.

    It is made once, to see what it is. Its experts, its name in reports and its presets can be told by giving a
    `gpcjax.TaskSpec` instead.

    Raises:
        UserError: what it makes is no task that can be taught.
        ForeignError: it cannot be made, or its reset or its step fails.
    """
    make = Maker(f"env {name}", found, functools.partial(_accepted, name))
    env = make()
    return TaskSpec(
        name=name,
        make=make,
        on_host=isinstance(env, HostEnv),
        sizes=_sizes_of(env),
        time_step=_time_step(env),
    )


def _accepted(name: str, thing: Any) -> Env | HostEnv:
    """What was made, in our shape, if it is a task that can be taught."""
    env = _adapted(name, thing)
    if isinstance(env, Env):
        _check(f"env {name}", env)
    return env


def _adapted(name: str, thing: Any) -> Env | HostEnv:
    """What was made, in our shape."""
    if isinstance(thing, Env | HostEnv):
        return thing
    kinds = {base.__module__.partition(".")[0] for base in type(thing).__mro__}
    if "brax" in kinds:
        return _refusing(name, lambda: brax_env(thing, name=name))
    if "gymnasium" in kinds:
        return HostEnv(name, type(thing), None)
    if all(callable(getattr(thing, method, None)) for method in ("reset", "step")) and hasattr(
        thing, "obs_size"
    ):
        # Of a class of its own, which messages name.
        return type(type(thing).__name__, (Alike,), {})(thing)
    raise UserError(
        f"env {name}: {shown(thing)} is no task, give a class with reset and step (gpcjax.Env), a task of gymnasium "
        "or brax, or a function that makes one"
    )


class Alike(Env):
    """A task that is no `gpcjax.Env`, but has its methods: `reset(key)` and `step(state, action)` give a `State`.

    It has `obs_size` and `action_size`; without `max_steps` an episode has 1,000 at most.
    """

    task: Any = eqx.field(static=True)
    max_steps: int = eqx.field(static=True, init=False)

    def __post_init__(self) -> None:
        self.max_steps = getattr(self.task, "max_steps", UNLIMITED)

    @property
    def name(self) -> str:
        return type(self.task).__name__

    @property
    def obs_size(self) -> int:
        return self.task.obs_size

    @property
    def action_size(self) -> int:
        return self.task.action_size

    def reset(self, key: PRNGKeyArray) -> State:
        return self.task.reset(key)

    def step(self, state: State, action: Float[Array, " action"]) -> State:
        return self.task.step(state, action)


def _check(source: str, env: Env) -> None:
    """Traces a reset and a step, so that a mistake shows before anything is compiled."""
    try:
        sizes = env.obs_size, env.action_size, env.max_steps
        if not all(isinstance(size, int) and size >= 1 for size in sizes):
            raise UserError(
                f"obs_size, action_size and max_steps must be whole numbers above zero, got {sizes}"
            )
        action = jax.ShapeDtypeStruct((env.action_size,), float)
        jax.eval_shape(lambda action: stepped(env, started(env, jax.random.key(0)), action), action)
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    except Exception as error:
        raise ForeignError(f"{source}: its reset or its step fails", error) from None


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
    return registry.find("task", env_name).sizes or _sizes_of(make_env(env_name))
