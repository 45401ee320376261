"""Names of tasks and of their experts. Plain data that loads no jax: what a name stands for is imported on demand."""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Array

    from gpcjax.envs.base import Env


@dataclass(frozen=True)
class Entry:
    """One task.

    | Field      | Meaning                                                                              |
    |------------|--------------------------------------------------------------------------------------|
    | `target`   | "module:attribute" of the class of the environment                                   |
    | `experts`  | expert name -> ("module:attribute" of a factory, its arguments...); the default first |
    | `episodes` | default length of a sweep                                                            |
    """

    target: str
    experts: Mapping[str, tuple[str, ...]]
    episodes: int


ENVS: Mapping[str, Entry] = MappingProxyType(
    {
        "cartpole": Entry(
            target="gpcjax.envs.cartpole:CartPole",
            experts=MappingProxyType(
                {
                    "gpc": ("gpcjax.policies.saved:load_shipped", "cartpole"),
                    "lqr": ("gpcjax.envs.experts:LQR",),
                }
            ),
            episodes=30,
        ),
        "pendulum": Entry(
            target="gpcjax.envs.pendulum:Pendulum",
            experts=MappingProxyType(
                {
                    "gpc": ("gpcjax.policies.saved:load_shipped", "pendulum"),
                    "energy": ("gpcjax.envs.experts:EnergySwingUp",),
                }
            ),
            episodes=40,
        ),
    }
)


def env_names() -> tuple[str, ...]:
    """The tasks that `make_env` knows."""
    return tuple(ENVS)


def expert_names(env_name: str) -> tuple[str, ...]:
    """The experts of a task, the default first. Raises ValueError for an unknown task."""
    return tuple(_entry(env_name).experts)


def default_episodes(env_name: str) -> int:
    """How many episodes a sweep of this task runs. Raises ValueError for an unknown task."""
    return _entry(env_name).episodes


def make_env(env_name: str, /, **parameters: Any) -> "Env":
    """Build a task by name, with other physical parameters if given (`make_env("cartpole", pole_mass=0.2)`).

    Raises:
        ValueError: an unknown task or parameter, or a value that the task refuses.
    """
    cls: Any = _resolve(_entry(env_name).target)
    allowed = tuple(field.name for field in fields(cls))
    for name in parameters:
        if name not in allowed:
            raise ValueError(f"unknown parameter {name!r} of {env_name}; allowed: {', '.join(allowed)}")
    return cls(**parameters)


def make_expert(env_name: str, expert_name: str) -> "Callable[[Array], Array]":
    """Build an expert by name, for the task with its default parameters: obs (obs_size,) -> action (action_size,).

    Raises:
        ValueError: an unknown task, or an expert that the task does not have.
    """
    experts = _entry(env_name).experts
    if expert_name not in experts:
        raise ValueError(f"unknown oracle {expert_name!r} for {env_name}; allowed: {', '.join(experts)}")
    target, *arguments = experts[expert_name]
    return _resolve(target)(*arguments)


def _entry(env_name: str) -> Entry:
    if env_name not in ENVS:
        raise ValueError(f"unknown environment {env_name!r}; allowed: {', '.join(ENVS)}")
    return ENVS[env_name]


def _resolve(target: str) -> Any:
    module, attribute = target.split(":")
    return getattr(importlib.import_module(module), attribute)
