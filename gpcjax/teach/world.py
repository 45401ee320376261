"""One simulation that a person watches: of a compiled task, or of one that gymnasium simulates, step by step."""

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from gpcjax._x64 import under_own_settings
from gpcjax.engine import streams
from gpcjax.envs.base import Env, State, started, stepped
from gpcjax.envs.host import HostEnv, Simulation
from gpcjax.errors import UserError

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

    def begin(self, episode: int) -> Float[np.ndarray, " obs"]:
        """The first observation of this episode, from 0."""
        if self._simulation is not None:
            return self._simulation.reset(_reset_seed(self._seed, episode))
        assert isinstance(self._env, Env)
        self._state = _started(self._env, jnp.asarray(self._seed), jnp.asarray(episode))
        return np.array(self._state.obs)

    def step(self, action: Float[np.ndarray, " action"]) -> Moved:
        """What comes of an action in [-1, 1].

        Raises:
            UserError: the task gives something else than it declares, or a reward that is no number.
        """
        moved = self._step(action)
        if (wrong := wrong_reward(moved)) is not None:
            raise wrong
        return moved

    def _step(self, action: Float[np.ndarray, " action"]) -> Moved:
        if self._simulation is not None:
            assert isinstance(self._env, HostEnv)
            outcome = self._simulation.step(self._env.scaled(action))
            obs = np.asarray(outcome.obs, np.float64)
            return Moved(obs, outcome.reward, outcome.terminated or outcome.truncated)
        assert isinstance(self._env, Env) and self._state is not None
        state = _stepped(self._env, self._state, action)
        self._state = state
        over = bool(state.terminated) or bool(state.truncated)
        return Moved(np.array(state.obs), float(state.reward), over)

    def picture(self) -> Picture | None:
        """What it looks like now; None of a task that makes no pictures."""
        if self._simulation is not None:
            return self._simulation.picture()
        render = getattr(getattr(self._env, "task", self._env), "render", None)
        return _as_picture(render(self._state)) if callable(render) else None


def wrong_reward(moved: Moved) -> UserError | None:
    """What to say of a reward that no return can be counted with; None of any other."""
    if math.isfinite(moved.reward):
        return None
    return UserError(f"a step of the task gave the reward {moved.reward}, its reward must be a finite number")


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
