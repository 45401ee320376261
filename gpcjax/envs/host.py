"""Tasks that gymnasium simulates on the host, one object an episode, beside those that are compiled."""

import inspect
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from gpcjax.allowed import STEPS, checked, converted, holds_numbers, is_no_data, shown
from gpcjax.errors import ForeignError, UserError

UNLIMITED = 1000
"""Steps of an episode that nothing else ends."""


class Outcome(NamedTuple):
    """What one step of a simulation brought, as gymnasium gives it: every step pays for a conversion."""

    obs: Float[np.ndarray, " obs"]
    reward: float
    terminated: bool
    """The task itself ended."""
    truncated: bool
    """A limit of time was reached: `max_steps`, or the simulation's own."""


@dataclass(frozen=True)
class HostEnv:
    """A task of gymnasium with continuous actions; `simulate` gives as many independent simulations as are wanted.

    With `max_steps` gymnasium's wrappers are left out: the time limit is ours, and their checks cost as much as the
    physics do. Without, the task is as gymnasium makes it, with its own time limit, truncation and wrappers.

    | Field       | Meaning                                                                              |
    |-------------|--------------------------------------------------------------------------------------|
    | `name`      | under which results of this task are kept                                            |
    | `gym_id`    | of gymnasium, or what makes an environment that is not registered there: its class, or a function |
    | `max_steps` | of an episode; None leaves its end to the task, or is 1,000 where gymnasium knows none |
    | `options`   | keyword arguments of `gymnasium.make`, or of what makes it                           |

    Raises:
        ValueError: gymnasium does not know the task, a part of it is not installed, its observations are no vector, or
            its actions are not bounded numbers; a function gives the same environment twice.
        ForeignError: the environment cannot be made.
    """

    name: str
    gym_id: str | Callable[..., Any]
    max_steps: int | None
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    obs_size: int = field(init=False)
    """Numbers of an observation."""
    action_size: int = field(init=False)
    """Dimensions of an action, each in [-1, 1]."""
    time_step: float | None = field(init=False, compare=False, repr=False)
    """Seconds of a step: `dt` of the environment, or what its frames a second say; None if it says neither."""
    _centre: Float[np.ndarray, " action"] = field(init=False, compare=False, repr=False)
    _reach: Float[np.ndarray, " action"] = field(init=False, compare=False, repr=False)
    _limit: int | None = field(init=False, compare=False, repr=False)
    """Of steps, where the simulation itself has none."""

    def __post_init__(self) -> None:
        if self.max_steps is not None:
            max_steps = checked(f"{self.name}: max_steps", self.max_steps, int, STEPS)
            object.__setattr__(self, "max_steps", max_steps)
        object.__setattr__(self, "options", MappingProxyType(dict(self.options)))
        env = self._make()
        if not isinstance(self.gym_id, str | type) and self._make() is env:
            raise ValueError(
                f"{self.name}: it gives the same object twice, each simulation needs one of its own"
            )
        observed: Any = getattr(env, "observation_space", None)
        actions: Any = getattr(env, "action_space", None)
        if not _is_box(observed) or len(observed.shape) != 1:
            raise ValueError(f"{self.name}: its observations are {_space(observed)}, a flat Box is supported")
        if not _is_box(actions) or len(actions.shape) != 1 or not actions.is_bounded():
            raise ValueError(
                f"{self.name}: its actions are {_space(actions)}, a bounded flat Box is supported"
            )
        object.__setattr__(self, "obs_size", int(observed.shape[0]))
        object.__setattr__(self, "action_size", int(actions.shape[0]))
        low, high = (np.asarray(bound, np.float64) for bound in (actions.low, actions.high))
        object.__setattr__(self, "_centre", (low + high) / 2)
        object.__setattr__(self, "_reach", (high - low) / 2)
        object.__setattr__(self, "time_step", _time_step(env))
        limit = self.max_steps or (None if _has_limit(env) else UNLIMITED)
        object.__setattr__(self, "_limit", limit)

    def __hash__(self) -> int:
        return hash((self.name, self.gym_id, self.max_steps, tuple(sorted(self.options))))

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and copy, which know no read-only mapping."""
        return {**vars(self), "options": dict(self.options)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, options=MappingProxyType(state["options"]))

    def scaled(self, actions: Float[np.ndarray, "action *lanes"]) -> Float[np.ndarray, "action *lanes"]:
        """Actions in [-1, 1] between the bounds of the task; what is beyond is clipped."""
        shape = (-1,) + (1,) * (actions.ndim - 1)
        return self._centre.reshape(shape) + self._reach.reshape(shape) * actions.clip(-1.0, 1.0)

    def simulate(self, pictures: bool = False) -> "Simulation":
        """A simulation of its own; `reset` comes first. With `pictures` it makes them, where the task can."""
        more = {"render_mode": "rgb_array"} if pictures and self.makes_pictures else {}
        return Simulation(
            self._make(**more), self._limit, self.obs_size, whole=self.max_steps is None, name=self.name
        )

    @property
    def makes_pictures(self) -> bool:
        """Whether the task says that it can show itself, and takes that it is to."""
        if not isinstance(self.gym_id, str) and not _takes(self.gym_id, "render_mode"):
            return False
        modes = (getattr(self._make(), "metadata", None) or {}).get("render_modes") or ()
        return "rgb_array" in modes

    def _make(self, **more: Any) -> Any:
        import gymnasium

        with warnings.catch_warnings():
            # Of Box2D's own wrappers: where warnings are errors, its import would end the process.
            warnings.simplefilter("ignore", DeprecationWarning)
            try:
                if not isinstance(self.gym_id, str):
                    return self._own(self.gym_id, **more)
                made = gymnasium.make(self.gym_id, disable_env_checker=True, **self.options, **more)
                return made if self.max_steps is None else made.unwrapped
            except (gymnasium.error.Error, ImportError, TypeError, AssertionError) as error:
                missing = isinstance(error, gymnasium.error.DependencyNotInstalled | ImportError)
                # MuJoCo's tasks import what draws them, whether they are drawn or not.
                if missing and any(name in str(error) for name in ("MuJoCo", "mujoco", "imageio", "glfw")):
                    error = f"it needs the extra, pip install 'gpcjax[mujoco]' ({error})"
                raise ValueError(f"{self.name}: gymnasium cannot make {self.gym_id!r}: {error}") from None
            except UserError:
                raise
            except Exception as error:  # of the task's own constructor
                raise ForeignError(f"{self.name}: it cannot be made", error) from None

    def _own(self, make: Callable[..., Any], **more: Any) -> Any:
        try:
            return make(**self.options, **more)
        except UserError:
            raise
        except Exception as error:
            raise ForeignError(f"{self.name}: it cannot be made", error) from None


_TRUTH = (bool, np.bool_)
"""Types of a truth value."""


class Simulation:
    """One environment of gymnasium: `reset` begins an episode, `step` advances it.

    What happens follows from the seed and the actions alone, whatever was simulated before. Both raise UserError where
    the environment gives something else than it declares; the message names its class. Both raise ForeignError where it
    fails, with the `name` of the task.
    """

    def __init__(self, env: Any, limit: int | None, obs_size: int, whole: bool, name: str):
        self._name = name
        self._env, self._limit, self._time, self._shape = env, limit, 0, (obs_size,)
        self._whole = whole
        """Whether its own truncation counts, and its actions are of its own type."""

    def reset(self, seed: int) -> Float[np.ndarray, " obs"]:
        """Begins the episode of this seed (a whole number of at least 0); gives the first observation."""
        self._time = 0
        try:
            given = self._env.reset(seed=seed)
        except Exception as error:
            raise ForeignError(f"env {self._name}: its reset fails", error) from None
        match given:
            case (obs, _):
                return self._observed("reset", obs)
            case other:
                raise self._odd("reset", "result", other, "(obs, info)")

    def step(self, action: Float[np.ndarray, " action"]) -> Outcome:
        """One step with an action between the bounds of the task (`HostEnv.scaled`)."""
        if self._whole:
            action = action.astype(self._env.action_space.dtype)
        try:
            given = self._env.step(action)
        except Exception as error:
            raise ForeignError(f"env {self._name}: its step fails", error) from None
        if not isinstance(given, tuple | list) or len(given) != 5:
            raise self._odd("step", "result", given, "(obs, reward, terminated, truncated, info)")
        obs, reward, terminated, truncated, _ = given
        self._time += 1
        # What an environment should give costs a glance, and a conversion where it is of another form.
        if type(obs) is not np.ndarray or obs.shape != self._shape or obs.dtype.kind != "f":
            obs = self._observed("step", obs)
        if not isinstance(reward, float):
            number = converted(float, reward)
            if number is None:
                raise self._odd("step", "reward", reward, "a real number")
            reward = number
        for name, flag in (("terminated", terminated), ("truncated", truncated)):
            if not isinstance(flag, _TRUTH):
                raise self._odd("step", name, flag, "a truth value")
        late = self._limit is not None and self._time >= self._limit
        return Outcome(obs, reward, bool(terminated), late or (self._whole and bool(truncated)))

    def picture(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """What it looks like now, of a simulation with pictures; None of another."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of gymnasium, about calls without a mode
            given = self._env.render()
        array = np.asarray(given) if given is not None else None
        return array if array is not None and array.ndim == 3 and array.dtype == np.uint8 else None

    def _observed(self, method: str, obs: Any) -> Float[np.ndarray, " obs"]:
        array = np.asarray(obs)
        if array.shape != self._shape or not holds_numbers(array) or is_no_data(obs):
            raise self._odd(method, "obs", obs, f"real numbers of shape {self._shape}")
        return array.astype(np.float64, copy=False)

    def _odd(self, method: str, what: str, given: Any, declared: str) -> UserError:
        dtype = getattr(given, "dtype", None)
        form = shown(given) if dtype is None else f"{dtype} of shape {np.shape(given)}"
        return UserError(f"{type(self._env).__name__}.{method}: {what} is {form}, declared is {declared}")


def _time_step(env: Any) -> float | None:
    step = getattr(getattr(env, "unwrapped", env), "dt", None)
    frames = (getattr(env, "metadata", None) or {}).get("render_fps")
    said = [converted(float, step), *(1.0 / rate for rate in (converted(float, frames),) if rate)]
    return next((value for value in said if value is not None and 0 < value < math.inf), None)


def _has_limit(env: Any) -> bool:
    """Whether one of gymnasium's wrappers ends its episodes, however long."""
    import gymnasium

    while env is not None and not isinstance(env, gymnasium.wrappers.TimeLimit):
        env = getattr(env, "env", None)
    return env is not None


def _takes(make: Callable[..., Any], name: str) -> bool:
    parameters = inspect.signature(make).parameters
    return name in parameters or any(each.kind is each.VAR_KEYWORD for each in parameters.values())


def _is_box(space: Any) -> bool:
    import gymnasium

    return isinstance(space, gymnasium.spaces.Box)


def _space(space: Any) -> str:
    """A space as messages name it, in a line."""
    text = " ".join(str(space).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def lunar_lander(max_steps: int = 1000) -> HostEnv:
    """Gymnasium's LunarLander-v3 with continuous actions (the thesis' domain 3, section 4.2.3).

    | Observation | Meaning                                           | Unit                     |
    |-------------|---------------------------------------------------|--------------------------|
    | 0, 1        | position from the pad                             | half a viewport's width, height |
    | 2, 3        | velocity                                          | scaled likewise          |
    | 4, 5        | angle, angular velocity                           | rad, rad/s (scaled)      |
    | 6, 7        | contact of the left and of the right leg          | 0 or 1                   |

    Action 0 is the main engine (off below 0, then from half to full power), action 1 the side engines (off within
    0.5 of 0).
    """
    return HostEnv("lunarlander", "LunarLander-v3", max_steps, MappingProxyType({"continuous": True}))


def gym_env(env: Any, *, max_steps: Any = None, name: Any = None, **arguments: Any) -> HostEnv:
    """Any task of gymnasium with a bounded flat Box of actions and a flat Box of observations, simulated on the host.

    Args:
        env: the id that gymnasium knows it by, or what makes an environment: its class, or a function.
        max_steps: after which an episode is truncated; without it the task keeps its own time limit and truncation.
        name: under which results are kept; by default `gym:ID`, or the name of the class.
        **arguments: of `gymnasium.make`, or of what makes it.

    Raises:
        ValueError: gymnasium does not know it, a part of it is not installed, or its spaces are others.
    """
    if not (callable(env) or isinstance(env, str)) or not env:
        raise UserError(f"env {shown(env)}: give the id of a task of gymnasium, or the class of one")
    if name is not None and (not isinstance(name, str) or not name):
        raise UserError(f"name {shown(name)}: give a word")
    label = name or (f"gym:{env}" if isinstance(env, str) else getattr(env, "__name__", "gym"))
    return HostEnv(label, env, max_steps, MappingProxyType(arguments))
