"""Many simulations of one compiled task, each a lane of a block: all that are due take their step in one call.

Blocks have the widths of a classroom's (`gpcjax.engine.classroom`), so that the bits of a simulation do not depend on
how many there are. A task that gymnasium simulates has nothing to share: there each is a `World` of its own.
"""

import threading
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gpcjax.engine import streams
from gpcjax.engine.ahead import Ahead
from gpcjax.engine.classroom import lanes_for
from gpcjax.envs.base import Env, started, stepped
from gpcjax.envs.host import HostEnv
from gpcjax.errors import UserError
from gpcjax.teach.world import Moved, World, wrong_move


class Worlds:
    """A block of simulations of a task; `enter` gives one of them.

    Args:
        env: from `make_env`.
        places: how many at most.
    """

    def __init__(self, env: Env | HostEnv, places: int):
        self.env = env
        self._places = places
        self._lock = threading.Lock()
        self._free: set[int] = set()
        if isinstance(env, Env):
            lanes = lanes_for(places)
            self._free = set(range(lanes))
            one = jax.eval_shape(lambda: started(env, streams.start_key(0, 0)))
            self._form = jax.tree.structure(one)
            self._state = [
                jax.device_put(np.zeros((*leaf.shape, lanes), leaf.dtype)) for leaf in jax.tree.leaves(one)
            ]
            self._width = lanes
            self._begin, self._step = Ahead(self._begun), Ahead(self._stepped)

    def compile(self) -> None:
        """All that a simulation needs."""
        if isinstance(self.env, Env):
            numbers = np.zeros(self._width, np.int64)
            self._begin.compile(self._state, numbers, numbers, np.zeros(self._width, bool))
            self._step.compile(self._state, *self._actions([], []))

    def enter(self, seed: int) -> "World | Place":
        """A simulation with the starts of this seed; `begin` comes first."""
        if isinstance(self.env, HostEnv):
            return World(self.env, seed)
        with self._lock:
            return Place(self, self._free.pop(), seed)

    def leave(self, place: "World | Place") -> None:
        """It is not needed any more."""
        if isinstance(place, Place):
            with self._lock:
                self._free.add(place.lane)

    def begin(
        self, lanes: Sequence[int], seeds: Sequence[int], episodes: Sequence[int]
    ) -> list[Float[np.ndarray, " obs"]]:
        """As `World.begin` of those at these lanes."""
        given = np.zeros((2, self._width), np.int64)
        mask = np.zeros(self._width, bool)
        given[:, list(lanes)], mask[list(lanes)] = [seeds, episodes], True
        with self._lock:
            self._state, obs = self._begin(self._state, *given, mask)
        return list(np.asarray(obs).T[list(lanes)])

    def step(self, lanes: Sequence[int], actions: Sequence[Any]) -> list[Moved]:
        """As `World.step` of those at these lanes."""
        given = self._actions(lanes, actions)
        with self._lock:
            self._state, seen = self._step(self._state, *given)
        *obs, reward, over = np.asarray(seen)
        each = np.array(obs).T[list(lanes)]
        return [
            Moved(obs, reward, over > 0)
            for obs, reward, over in zip(
                each, reward[list(lanes)].tolist(), over[list(lanes)].tolist(), strict=True
            )
        ]

    def _actions(self, lanes: Sequence[int], actions: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
        given, mask = np.zeros((self.env.action_size, self._width)), np.zeros(self._width, bool)
        if lanes:
            given[:, list(lanes)], mask[list(lanes)] = np.array(actions, float).T, True
        return given, mask

    # --- traced

    def _begun(self, leaves: list, seeds: Any, episodes: Any, mask: Any) -> tuple[list, Any]:
        env, before = self.env, self._form.unflatten(leaves)
        start = lambda seed, episode: started(env, streams.start_key(seed, episode))  # noqa: E731  # pyright: ignore
        after = jax.vmap(start, out_axes=-1)(seeds, episodes)
        kept = jax.tree.map(lambda new, old: jnp.where(mask, new, old), after, before)
        return jax.tree.leaves(kept), after.obs

    def _stepped(self, leaves: list, actions: Any, mask: Any) -> tuple[Any, ...]:
        env, before = self.env, self._form.unflatten(leaves)
        step = lambda state, action: stepped(env, state, action)  # noqa: E731  # pyright: ignore
        after = jax.vmap(step, in_axes=-1, out_axes=-1)(before, actions)
        kept = jax.tree.map(lambda new, old: jnp.where(mask, new, old), after, before)
        seen = jnp.concatenate([after.obs, after.reward[None], after.done[None].astype(after.obs.dtype)])
        return jax.tree.leaves(kept), seen


class Place:
    """One simulation among others, with what a `World` has."""

    def __init__(self, worlds: Worlds, lane: int, seed: int):
        self.worlds, self.lane, self.seed = worlds, lane, seed

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of an observation, and of an action."""
        return self.worlds.env.obs_size, self.worlds.env.action_size

    def begin(self, episode: int) -> Float[np.ndarray, " obs"]:
        """The first observation of this episode, from 0."""
        (obs,) = self.worlds.begin([self.lane], [self.seed], [episode])
        return obs

    def step(self, action: Float[np.ndarray, " action"]) -> Moved:
        """What comes of an action in [-1, 1]."""
        (moved,) = self.worlds.step([self.lane], [action])
        return moved

    def picture(self) -> None:
        """None: among others nobody makes pictures."""


def step_together(
    worlds: Worlds, places: Sequence[World | Place], actions: Sequence[Sequence[float]]
) -> list[Moved | UserError]:
    """The step of each of these simulations of one block; what one of them raised in its place."""
    if isinstance(worlds.env, Env):
        lanes = [place.lane for place in places if isinstance(place, Place)]
        return [wrong_move(moved) or moved for moved in worlds.step(lanes, actions)]
    found: list[Moved | UserError] = []
    for place, action in zip(places, actions, strict=True):
        try:
            found.append(place.step(np.array(action)))
        except UserError as error:
            found.append(error)
    return found


def begin_together(
    worlds: Worlds, places: Sequence[World | Place], episodes: Sequence[int]
) -> list[Float[np.ndarray, " obs"] | UserError]:
    """The first observations of these episodes; what one of them raised in its place."""
    if isinstance(worlds.env, Env):
        here = [place for place in places if isinstance(place, Place)]
        return [*worlds.begin([place.lane for place in here], [place.seed for place in here], episodes)]
    found: list[Float[np.ndarray, " obs"] | UserError] = []
    for place, episode in zip(places, episodes, strict=True):
        try:
            found.append(place.begin(episode))
        except UserError as error:
            found.append(error)
    return found
