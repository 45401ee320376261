"""Names of tasks and of their experts. Plain data that loads no jax: what a name stands for is imported on demand."""

import importlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, overload

from gpcjax.allowed import FINITE, STEPS, checked, holds_numbers, shown, suggestion
from gpcjax.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Array

    from gpcjax.envs.base import Env
    from gpcjax.envs.host import HostEnv


@dataclass(frozen=True)
class Entry:
    """One task.

    | Field      | Meaning                                                                              |
    |------------|--------------------------------------------------------------------------------------|
    | `target`   | "module:attribute" of what makes the environment                                     |
    | `experts`  | expert name -> ("module:attribute" of a factory, its arguments...); the default first |
    | `episodes` | default length of a sweep                                                            |
    | `max_capacity` | default bound of a dictionary's points                                           |
    | `on_host`  | simulated there: a step takes tens of microseconds, whatever is compiled             |
    """

    target: str
    experts: Mapping[str, tuple[str, ...]]
    episodes: int
    max_capacity: int = 1024
    on_host: bool = False


ENVS: Mapping[str, Entry] = MappingProxyType(
    {
        "cartpole": Entry(
            target="gpcjax.envs.cartpole:CartPole",
            experts=MappingProxyType(
                {
                    "gpc": ("gpcjax.policies.saved:load_shipped", "cartpole"),
                    "gpc-2": ("gpcjax.policies.saved:load_shipped", "cartpole-2"),
                    "gpc-3": ("gpcjax.policies.saved:load_shipped", "cartpole-3"),
                    "lqr": ("gpcjax.envs.experts:LQR",),
                    "network": ("gpcjax.policies.saved:load_shipped", "cartpole-network"),
                    "mpc": ("gpcjax.envs.predictive:CartPoleMPC",),
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
                    "network": ("gpcjax.policies.saved:load_shipped", "pendulum-network"),
                    "mpc": ("gpcjax.envs.predictive:PendulumMPC",),
                }
            ),
            episodes=40,
        ),
        "lunarlander": Entry(
            target="gpcjax.envs.host:lunar_lander",
            experts=MappingProxyType({"heuristic": ("gpcjax.envs.experts:LanderHeuristic",)}),
            episodes=200,
            max_capacity=4096,
            on_host=True,
        ),
    }
)


def env_names() -> tuple[str, ...]:
    """The names of the tasks that `make_env` knows."""
    return tuple(ENVS)


def expert_names(env_name: str) -> tuple[str, ...]:
    """The names of a task's experts, for `make_expert` and `make_oracle`; the default comes first.

    Raises:
        ValueError: an unknown task.
    """
    return tuple(_entry(env_name).experts)


def shipped(env_name: str) -> dict[str, str]:
    """The experts of a task that are shipped policies: name -> folder. Raises ValueError for an unknown task."""
    experts = _entry(env_name).experts.items()
    return {
        name: path for name, (target, *rest) in experts if target.endswith(":load_shipped") for path in rest
    }


def default_episodes(env_name: str) -> int:
    """How many episodes a sweep of this task runs. Raises ValueError for an unknown task."""
    return _entry(env_name).episodes


def default_max_capacity(env_name: str) -> int:
    """Points that a dictionary may hold in a sweep of this task. Raises ValueError for an unknown task."""
    return _entry(env_name).max_capacity


def on_host(env_name: str) -> bool:
    """Whether a task is simulated on the host. Raises ValueError for an unknown task."""
    return _entry(env_name).on_host


@overload
def make_env(  # pyright: ignore[reportOverlappingOverload]
    env_name: Literal["lunarlander"], /, **parameters: Any
) -> "HostEnv": ...
@overload
def make_env(env_name: str, /, **parameters: Any) -> "Env": ...
def make_env(env_name: str, /, **parameters: Any) -> "Env | HostEnv":
    """Build a task by name, with other physical parameters if given (`make_env("cartpole", pole_mass=0.2)`).

    "lunarlander" is simulated on the host: a `gpcjax.envs.host.HostEnv`.

    Parameters are numbers (numpy's too), or what jax traces; `max_steps` is a whole number.

    Raises:
        ValueError: an unknown task or parameter, or a value that the task refuses.
    """
    make: Any = _resolve(_entry(env_name).target)
    allowed = tuple(inspect.signature(make).parameters)
    for name in parameters:
        if name not in allowed:
            near = suggestion(name, allowed)
            raise UserError(f"unknown parameter {name!r} of {env_name}{near}; allowed: {', '.join(allowed)}")
    return make(**{name: _parameter(env_name, name, value) for name, value in parameters.items()})


def make_expert(env_name: str, expert_name: str) -> "Callable[[Array], Array]":
    """Build an expert by name, for the task with its default parameters: obs (obs_size,) -> action (action_size,).

    Raises:
        ValueError: an unknown task, or an expert that the task does not have.
    """
    experts = _entry(env_name).experts
    if not isinstance(expert_name, str) or expert_name not in experts:
        raise UserError(f"unknown oracle {shown(expert_name)} for {env_name}; allowed: {', '.join(experts)}")
    target, *arguments = experts[expert_name]
    return _resolve(target)(*arguments)


def _entry(env_name: str) -> Entry:
    if not isinstance(env_name, str) or env_name not in ENVS:
        raise UserError(f"unknown environment {shown(env_name)}; allowed: {', '.join(ENVS)}")
    return ENVS[env_name]


def _parameter(env_name: str, name: str, value: Any) -> Any:
    """A parameter of a task, if it is a number; what is beyond the task's own bounds it refuses itself."""
    where = f"{env_name}: {name}"
    if name == "max_steps":
        return checked(where, value, int, STEPS)
    return value if holds_numbers(value) else checked(where, value, float, FINITE)


def _resolve(target: str) -> Any:
    module, attribute = target.split(":")
    return getattr(importlib.import_module(module), attribute)
