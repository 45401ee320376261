"""Episodes of a policy, moment by moment: nothing is learned from them."""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gpcjax._x64 import under_own_settings
from gpcjax.errors import UserError
from gpcjax.play.chosen import Player
from gpcjax.teach.world import World


class Moment(NamedTuple):
    """What is to be seen: the task before a step, or at the end of an episode."""

    episode: int
    """From 1."""
    step: int
    """From 0; at the end, how many there were."""
    obs: Float[np.ndarray, " obs"]
    action: Float[np.ndarray, " action"]
    """Chosen here, in [-1, 1]; at the end, the last one."""
    total: float
    """Rewards so far."""
    over: bool


def moments(world: World, player: Player, episode: int) -> Iterator[Moment]:
    """One episode (from 1), which begins as that of a sweep does; `world.picture()` is of the latest moment.

    Raises:
        UserError: an action is no number.
    """
    obs, total = world.begin(episode - 1), 0.0
    for step in itertools.count():
        action = _action(player, obs, f"episode {episode}, step {step}")
        yield Moment(episode, step, obs, action, total, over=False)
        obs, reward, over = world.step(action)
        total += reward
        if over:
            yield Moment(episode, step + 1, obs, action, total, over=True)
            return


@under_own_settings
def _action(player: Player, obs: Float[np.ndarray, " obs"], moment: str) -> Float[np.ndarray, " action"]:
    action = np.asarray(player.act(obs), np.float64)
    if not np.isfinite(action).all():
        raise UserError(f"{player.who}: {moment}: its action is no number")
    return action.clip(-1.0, 1.0)
