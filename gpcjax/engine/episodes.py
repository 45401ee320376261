"""The end of episodes: their rows are written, the next ones begin, and lanes that cannot go on stop.

A lane whose observation, action or return is no number goes no further: comparisons with NaN are false, so that its
episode might never end, and what it returned would look like any other.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from gpcjax.engine.keeping import Keep
from gpcjax.engine.lanes import WINDOW, Lane, Phase
from gpcjax.engine.stepping import all_finite
from gpcjax.envs.base import State as EnvState
from gpcjax.learners.base import Status


def end_episodes(
    block: Lane,
    start: Callable[[Lane, Int[Array, " lanes"]], EnvState],
    keep: Keep | None = None,
) -> Lane:
    """Writes the rows of the episodes that ended, and starts the next ones; a lane with a status ends its run.

    `start` gives the states in which lanes begin the episodes of these indices. A lane whose episode is one to `keep`
    waits at the start of the next one (`Phase.PAUSED`).
    """
    running = block.phase == Phase.RUNNING
    over, stopped = block.env.done & running, (block.status != Status.OK) & running
    # The condition guards small arrays only: a matrix that passes through it might be copied.
    names = ("env", "tally", "rows", "episode", "phase", "status", "window_start")
    values = lax.cond(
        (over | stopped).any(),
        lambda: _end(block, over, stopped, start, keep),
        lambda: tuple(getattr(block, name) for name in names),
    )
    return dataclasses.replace(block, **dict(zip(names, values, strict=True)))


def _end(
    block: Lane,
    over: Bool[Array, " lanes"],
    stopped: Bool[Array, " lanes"],
    start: Callable[[Lane, Int[Array, " lanes"]], EnvState],
    keep: Keep | None,
) -> tuple:
    ended = over | stopped
    finite = all_finite(block.env.obs, block.tally.returns[None])
    broken = over & ~stopped & ~finite
    status = jnp.where(broken, jnp.int32(Status.NON_FINITE), block.status)
    points = jax.vmap(lambda learner, state: learner.points(state))(block.learner, block.state)
    own = jax.vmap(lambda learner, state: learner.measure(state))(block.learner, block.state)
    values = {
        **vars(block.tally),
        # What an episode returned until then is no return of an episode.
        "returns": jnp.where(status == Status.NON_FINITE, jnp.nan, block.tally.returns),
        "length": block.env.time,
        "policy_points": points[0],
        "human_points": points[1],
    }
    room = block.rows.returns.shape[0]
    here = (jnp.arange(room)[:, None] == block.episode[None]) & ended[None]
    written = {
        name: jnp.where(here, value[None].astype(getattr(block.rows, name).dtype), getattr(block.rows, name))
        for name, value in values.items()
    }
    measured = {
        name: jnp.where(here, jnp.asarray(value, float)[None], block.rows.own[name])
        for name, value in own.items()
    }
    tally = jax.tree.map(lambda value: jnp.where(ended, jnp.zeros_like(value), value), block.tally)

    episode = jnp.where(stopped | broken, block.episodes, block.episode + over)
    finished = ended & (episode >= block.episodes)
    begins = over & ~finished
    env = jax.tree.map(lambda new, old: jnp.where(begins, new, old), start(block, episode), block.env)
    phase = jnp.where(finished, jnp.int32(Phase.FINISHED), block.phase)
    if keep is not None:
        due = keep.due(block.tally.returns, block.rows.returns, block.episode)
        phase = jnp.where(begins & due, jnp.int32(Phase.PAUSED), phase)
    # A window of the last episode is void: the next round draws another.
    window_start = jnp.where(begins, -WINDOW, block.window_start)
    return (
        env,
        tally,
        dataclasses.replace(block.rows, **written, own=measured),
        episode,
        phase,
        status,
        window_start,
    )
