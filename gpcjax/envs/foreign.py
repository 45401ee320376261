"""Tasks from elsewhere: a person's own module, gymnasium by `gym:ID`, brax by `brax:NAME`."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from gpcjax import registry
from gpcjax._x64 import seeded_key
from gpcjax.allowed import POSITIVE, checked, checked_series, converted, shown
from gpcjax.describe import TaskSpec
from gpcjax.envs.base import Env, State, fitted, limited, started, stepped
from gpcjax.envs.brax_adapter import brax_env
from gpcjax.envs.brax_tasks import KNOWN, Known
from gpcjax.envs.host import UNLIMITED, HostEnv, gym_env
from gpcjax.envs.views import check_view
from gpcjax.errors import ForeignError, UserError
from gpcjax.making import Maker

_TASK = "a class with reset and step (gpcjax.Env), a task of gymnasium or brax, or a function that makes one"


def described_elsewhere(prefix: str, name: str) -> TaskSpec:
    """The description of `gym:ID` or `brax:NAME`.

    Raises:
        UserError: there is no such task, or it is one that cannot be taught.
    """
    full = f"{prefix}:{name}"
    if prefix == "gym":
        make: Any = functools.partial(gym_env, name)
        made: Env | HostEnv = _refusing(full, make)
        return TaskSpec(
            full, make, on_host=True, sizes=sizes_of(made), time_step=_time_step(f"env {full}", made)
        )
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
        sizes=sizes_of(made),
        time_step=_time_step(f"env {full}", made),
    )


def sizes_of(env: Env | HostEnv) -> tuple[int, int]:
    """Those of its observations and of its actions."""
    return int(env.obs_size), int(env.action_size)


def _refusing(name: str, make: Callable[[], Any]) -> Any:
    """What `make` makes; what refuses it speaks of the setting."""
    try:
        return make()
    except ForeignError as error:
        raise ForeignError(f"env {error.arguments[0]}", *error.arguments[1:]) from None
    except ImportError as error:
        raise UserError(f"env {name}: {error}; a part of it is not installed") from None
    except ValueError as error:
        raise UserError(f"env {str(error).removeprefix('env ')}") from None
    except Exception as error:
        raise ForeignError(f"env {name}: it cannot be made", error) from None


def task_of(name: str, found: Callable[..., Any] | TaskSpec) -> TaskSpec:
    """The description of a task of a person's own: one of theirs, or of a class or a function that makes the task.

    It is made once without arguments, to see what it is; what a description of theirs leaves open, it says itself.

    Raises:
        UserError: what it makes is no task that can be taught, or another one than its description, or its view, says.
        ForeignError: it cannot be made, or its reset or its step fails.
    """
    source, told = f"env {name}", found if isinstance(found, TaskSpec) else None
    maker = found if told is None else told.make
    make = _Making(name, registry.imported(maker, source) if isinstance(maker, str) else maker)
    env = make()
    sizes, spec = sizes_of(env), told or TaskSpec(name=name, make=make)
    if not all(isinstance(table, Mapping) for table in (spec.experts, spec.presets, *spec.presets.values())):
        raise UserError(f"{source}: experts, presets and each of these are tables by name: give a dict")
    if spec.sizes is not None and tuple(spec.sizes) != sizes:
        raise UserError(f"{source}: its description has sizes {shown(spec.sizes)}, its task has {sizes}")
    check_view(source, spec.view, sizes)
    return dataclasses.replace(
        spec,
        name=name,
        make=make,
        on_host=isinstance(env, HostEnv),
        sizes=sizes,
        time_step=_time_step(source, env) if spec.time_step is None else spec.time_step,
        obs_scale=_obs_scale(source, sizes[0], spec.obs_scale or _said(source, env, "obs_scale")),
    )


class _Making:
    """Makes a task in our shape, by what a person's own module has. Its signature is that of what it calls."""

    def __init__(self, name: str, found: Any):
        """Raises UserError: this makes nothing, or Python cannot tell which arguments it takes."""
        source = f"env {name}"
        if not callable(found):
            raise UserError(f"{source}: {shown(found)} is no task, give {_TASK}")
        self._name, self._found = name, found
        self._maker = Maker(source, found, lambda made: made)
        self.__signature__ = self._maker.__signature__

    @property
    def module(self) -> str:
        """Where what it calls comes from; "" where Python does not say."""
        return self._maker.module

    def __call__(self, **values: Any) -> Env | HostEnv:
        """One more, with these parameters.

        Raises:
            UserError: it is no task that can be taught.
            ForeignError: it cannot be made, or its reset or its step fails.
        """
        env = self._adapted(self._maker(**values), values)
        if isinstance(env, Env):
            _check(f"env {self._name}", env)
        return env

    def _adapted(self, thing: Any, values: dict[str, Any]) -> Env | HostEnv:
        """What was made, in our shape."""
        name = self._name
        if isinstance(thing, Env | HostEnv):
            return thing
        kinds = {base.__module__.partition(".")[0] for base in type(thing).__mro__}
        if "brax" in kinds:
            return _refusing(name, lambda: brax_env(thing, name=name))
        if "gymnasium" in kinds:  # each simulation is made by what made this one, with the same arguments
            return _refusing(name, lambda: HostEnv(name, self._found, None, values))
        if all(callable(getattr(thing, method, None)) for method in ("reset", "step")) and hasattr(
            thing, "obs_size"
        ):
            # Of a class of its own, which messages name.
            return type(type(thing).__name__, (Alike,), {})(thing)
        raise UserError(f"env {name}: {shown(thing)} is no task, give {_TASK}")


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

    @property
    def time_step(self) -> Any:
        """Seconds of a step, if the task says so."""
        return getattr(self.task, "time_step", None)

    @property
    def obs_scale(self) -> Any:
        """How large each number of an observation usually is, if the task says so."""
        return getattr(self.task, "obs_scale", None)

    def reset(self, key: PRNGKeyArray) -> State:
        return self.task.reset(key)

    def step(self, state: State, action: Float[Array, " action"]) -> State:
        return limited(self, state, fitted(self, "step", self.task.step(state, action)))


def _check(source: str, env: Env) -> None:
    """Traces a reset and a step, so that a mistake shows before anything is compiled."""
    try:
        sizes = env.obs_size, env.action_size, env.max_steps
        if not all((converted(int, size) or 0) >= 1 for size in sizes):
            raise UserError(
                f"obs_size, action_size and max_steps must be whole numbers above zero, got {sizes}"
            )
        action = jax.ShapeDtypeStruct((env.action_size,), float)
        jax.eval_shape(lambda action: stepped(env, started(env, seeded_key()), action), action)
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    except Exception as error:
        raise ForeignError(f"{source}: its reset or its step fails", error) from None


def _said(source: str, env: Env | HostEnv, name: str) -> Any:
    """What a task says of itself under a name; None if nothing."""
    try:
        return getattr(env, name, None)
    except Exception as error:
        raise ForeignError(f"{source}: its {name} fails", error) from None


def _time_step(source: str, env: Env | HostEnv) -> float | None:
    """Seconds of a step, where a task says so: by a number `time_step`, as brax's `dt`, or as gymnasium's frames."""
    said = _said(source, env, "time_step")
    return None if said is None else checked(f"{source}: time_step", said, float, POSITIVE)


def _obs_scale(source: str, size: int, said: Any) -> tuple[float, ...] | None:
    return None if said is None else checked_series(f"{source}: obs_scale", said, size, POSITIVE)
