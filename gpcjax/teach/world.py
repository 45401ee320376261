"""One simulation that a person watches: of a compiled task, or of one that gymnasium simulates, step by step."""

import contextlib
import functools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import shown
from gpcjax.engine import streams
from gpcjax.envs.base import Env, State, started, stepped
from gpcjax.envs.host import HostEnv, Simulation
from gpcjax.errors import ForeignError, UserError

Picture = UInt8[np.ndarray, "height width 3"]


class Moved(NamedTuple):
    """What a step brought."""

    obs: Float[np.ndarray, " obs"]
    reward: float
    over: bool
    """The episode has ended, for either reason."""


class World:
    """A task with the starts that a sweep gives to a seed.

    Args:
        env: from `make_env`.
        seed: of its starts.
        pictures: make them as well, where the task can.
    """

    @under_own_settings
    def __init__(self, env: Env | HostEnv, seed: int, pictures: bool = False):
        self._env, self._seed = env, seed
        self._simulation: Simulation | None = (
            env.simulate(pictures=pictures) if isinstance(env, HostEnv) else None
        )
        self._state: State | None = None

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of an observation, and of an action."""
        return self._env.obs_size, self._env.action_size

    @property
    def max_steps(self) -> float:
        """Of an episode; infinite where only the task knows."""
        return getattr(self._env, "max_steps", None) or math.inf

    def begin(self, episode: int) -> Float[np.ndarray, " obs"]:
        """The first observation of this episode, from 0.

        Raises:
            UserError: the task gives something else than it declares, or what is no number.
            ForeignError: it fails.
        """
        state = None
        with _theirs(self._env, "reset"):
            if self._simulation is not None:
                obs = self._simulation.reset(_reset_seed(self._seed, episode))
            else:
                assert isinstance(self._env, Env)
                state = _started(self._env, jnp.asarray(self._seed), jnp.asarray(episode))
                obs = np.array(state.obs)
        if not np.isfinite(obs).all():
            raise _no_numbers("the reset", obs)
        self._state = state
        return obs

    def step(self, action: Float[np.ndarray, " action"]) -> Moved:
        """What comes of an action in [-1, 1].

        What raises leaves a compiled task at the step before; one of gymnasium is somewhere else then, and only `begin`
        leads back to a known step.

        Raises: as `begin`, also for a reward that is no number.
        """
        with _theirs(self._env, "step"):
            state, moved = self._stepped(action)
        if (wrong := wrong_move(moved)) is not None:
            raise wrong
        self._state = state
        return moved

    def _stepped(self, action: Float[np.ndarray, " action"]) -> tuple[State | None, Moved]:
        if self._simulation is not None:
            assert isinstance(self._env, HostEnv)
            outcome = self._simulation.step(self._env.scaled(action))
            obs = np.asarray(outcome.obs, np.float64)
            return None, Moved(obs, outcome.reward, outcome.terminated or outcome.truncated)
        assert isinstance(self._env, Env) and self._state is not None
        state = _stepped(self._env, self._state, action)
        over = bool(state.terminated) or bool(state.truncated)
        return state, Moved(np.array(state.obs), float(state.reward), over)

    def picture(self) -> Picture | None:
        """What it looks like now; None of a task that makes no pictures. Raises ForeignError: it fails."""
        with _theirs(self._env, "render"):
            if self._simulation is not None:
                return self._simulation.picture()
            render = getattr(getattr(self._env, "task", self._env), "render", None)
            return _as_picture(render(self._state)) if callable(render) else None


def wrong_move(moved: Moved) -> UserError | None:
    """What to say of a step that cannot be taught at or counted with; None of any other."""
    if not math.isfinite(moved.reward):
        return UserError(
            f"a step of the task gave the reward {moved.reward}, its reward must be a finite number"
        )
    if not np.isfinite(moved.obs).all():
        return _no_numbers("a step", moved.obs)
    return None


def _no_numbers(what: str, obs: Float[np.ndarray, " obs"]) -> UserError:
    return UserError(
        f"{what} of the task gave the observation {shown(obs.tolist())}, each entry must be finite"
    )


@contextlib.contextmanager
def _theirs(env: Env | HostEnv, method: str) -> Iterator[None]:
    """What a task raises is told as its own."""
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        raise ForeignError(f"env {env.name}: its {method} fails", error) from None


def makes_pictures(env: Env | HostEnv) -> bool:
    """Whether a task can show itself: of gymnasium "rgb_array", of one's own a method `render(state)`."""
    if isinstance(env, HostEnv):
        return env.makes_pictures
    return callable(getattr(getattr(env, "task", env), "render", None))


@functools.lru_cache(maxsize=4)
def _seeds(seed: int, episodes: int) -> list[int]:
    return streams.reset_seeds(seed, episodes)


def _reset_seed(seed: int, episode: int) -> int:
    # By powers of two: each length is a program of its own.
    return _seeds(seed, 1 << max(6, episode.bit_length()))[episode]


@eqx.filter_jit
def _started(env: Env, seed: streams.Scalar, episode: streams.Scalar) -> State:
    return started(env, streams.start_key(seed, episode))


@eqx.filter_jit
def _stepped(env: Env, state: State, action: Any) -> State:
    return stepped(env, state, action)


def _as_picture(given: Any) -> Picture | None:
    array = np.asarray(jax.device_get(given))
    if array.ndim != 3 or array.shape[2] != 3:
        return None
    if array.dtype != np.uint8:
        array = (np.clip(array.astype(float), 0.0, 1.0) * 255).astype(np.uint8)
    return array
