"""Tasks and their experts by name. Loads no jax: what a name stands for is imported when it is made."""

import inspect
import os
from typing import TYPE_CHECKING, Any, Literal, overload

from gpcjax import registry
from gpcjax.allowed import FINITE, STEPS, checked, holds_numbers, shown, suggestion
from gpcjax.describe import TaskSpec
from gpcjax.elsewhere import path_here
from gpcjax.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Array

    from gpcjax.envs.base import Env
    from gpcjax.envs.host import HostEnv


NOBODY = "none"
"""In the place of an expert's name, where a teacher advises without one on a task that has none."""


def task(env_name: Any) -> TaskSpec:
    """The description of a task. Raises UserError for an unknown one."""
    return registry.find("task", env_name)


def env_names() -> tuple[str, ...]:
    """The names of the tasks that `make_env` knows: built in, then those that installed packages register.

    Besides, a task may be given as `module:NAME`, `gym:ID` or `brax:NAME`.
    """
    return registry.names("task")


def expert_names(env_name: str) -> tuple[str, ...]:
    """The names of a task's experts, for `make_expert` and `make_oracle`; the default comes first.

    Args:
        env_name: as `make_env` takes it.

    Raises:
        ValueError: an unknown task.
    """
    return tuple(task(env_name).experts)


def shipped(env_name: str) -> dict[str, str]:
    """The experts of a task that are shipped policies: name -> folder. Raises ValueError for an unknown task."""
    made = {name: entry for name, entry in task(env_name).experts.items() if isinstance(entry, tuple)}
    return {
        name: path
        for name, (target, *rest) in made.items()
        if isinstance(target, str) and target.endswith(":load_shipped")
        for path in rest
    }


@overload
def make_env(  # pyright: ignore[reportOverlappingOverload]
    env_name: Literal["lunarlander"], /, **parameters: Any
) -> "HostEnv": ...
@overload
def make_env(env_name: str, /, **parameters: Any) -> "Env": ...
def make_env(env_name: str, /, **parameters: Any) -> "Env | HostEnv":
    """Build a task by name, with other physical parameters if given (`make_env("cartpole", pole_mass=0.2)`).

    Cart-pole, pendulum and mountain car have gymnasium's equations (the cart-pole with a continuous force, 4.2.2).

    Args:
        env_name: one of `env_names()`, `module:NAME` for a task of one's own, `gym:ID` (gymnasium), or `brax:NAME`.
        **parameters: numbers (numpy's too), or what jax traces, in SI units; `max_steps` is a whole number.

    Returns:
        A task with observations (obs_size,) and actions (action_size,) in [-1, 1]; a step takes `time_step` seconds,
        where it has a unit of time. "lunarlander" and the tasks of gymnasium are simulated on the host: a `HostEnv`.

    Raises:
        ValueError: an unknown task or parameter, or a value that the task refuses.
    """
    spec = task(env_name)
    make: Any = registry.resolve(spec.make)
    if parameters:
        allowed = tuple(inspect.signature(make).parameters)
        for name in parameters:
            if name not in allowed:
                near = suggestion(name, allowed)
                raise UserError(
                    f"unknown parameter {name!r} of {env_name}{near}; allowed: {', '.join(allowed)}"
                )
    return make(**{name: _parameter(env_name, name, value) for name, value in parameters.items()})


def check_expert(env_name: str, expert_name: Any, source: str) -> None:
    """Refuses what cannot be an expert of a task, as far as that is known before it is made.

    Raises:
        UserError: no name of an expert of the task, no folder, no `module:function`, or a function that does not fit.
            `source` begins the message.
        ForeignError: its module or the function itself fails.
    """
    experts = task(env_name).experts
    is_name = isinstance(expert_name, str)
    entry: Any = experts.get(expert_name, expert_name) if is_name else None
    if isinstance(entry, tuple):
        return
    if isinstance(entry, str) and is_folder(entry):
        if not os.path.exists(os.path.join(path_here(entry), "card.json")):
            raise UserError(f"{source} {shown(entry)}: no policy is in this folder (card.json is missing)")
        return
    if is_name and (expert_name in experts or ":" in expert_name):
        from gpcjax.envs import foreign_experts

        foreign_experts.check_expert(env_name, entry, f"{source} {expert_name}")
        return
    others = [*experts, "the folder of a saved policy", "module:function"]
    raise UserError(
        f"{source} {shown(expert_name)}: give {', '.join(others[:-1])} or {others[-1]} for {env_name}"
        f"{suggestion(expert_name, experts)}"
    )


def make_expert(env_name: str, expert_name: str) -> "Callable[[Array], Array]":
    """Build an expert by name, for the task with its default parameters: obs (obs_size,) -> action (action_size,).

    Args:
        env_name: of the task.
        expert_name: one of `expert_names(env_name)`, the folder of a saved policy, or `module:function` of one's own:
            a function of the observation, or a class or function without arguments that makes one.

    Raises:
        ValueError: an unknown task, or what is no expert of it.
    """
    check_expert(env_name, expert_name, "oracle")
    entry = task(env_name).experts.get(expert_name, expert_name)
    if not isinstance(entry, tuple):
        from gpcjax.envs import foreign_experts

        return foreign_experts.expert(env_name, entry)
    target, *arguments = entry
    made = registry.resolve(target)
    return made(*arguments)


def is_folder(name: str) -> bool:
    """Whether a name of an expert is that of a folder. A name that no file system takes is none."""
    return os.path.isdir(path_here(name))


def _parameter(env_name: str, name: str, value: Any) -> Any:
    """A parameter of a task, if it is a number; what is beyond the task's own bounds it refuses itself."""
    source = f"{env_name}: {name}"
    if name == "max_steps":
        return checked(source, value, int, STEPS)
    if holds_numbers(value) and getattr(value, "shape", None) == ():
        from gpcjax.policies.vectors import is_traced

        if is_traced(value):
            return value
    return checked(source, value, float, FINITE)
