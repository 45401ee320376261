"""Named random streams: a seed means the same starts and the same coins for every learner.

Every draw is a function of (seed, stream, episode, step), never of what was drawn before, so that it does not matter
which lane, block or process asks for it. Threefry is a counter-based generator: one call makes the key of a draw,
with (seed, stream) as its key and (episode, step) as its counter.
"""

import jax
import jax.numpy as jnp
from jax.extend.random import threefry_2x32
from jaxtyping import Array, Int, PRNGKeyArray

import gpcjax._x64  # noqa: F401

START = 0
COIN = 1

Scalar = Int[Array, ""] | int


def start_key(seed: Scalar, episode: Scalar) -> PRNGKeyArray:
    """For `Env.reset` at the start of an episode (from 0)."""
    return _key(seed, START, episode, 0)


def coin_key(seed: Scalar, episode: Scalar, step: Scalar) -> PRNGKeyArray:
    """For `Teacher.coins` at one step (from 0) of an episode."""
    return _key(seed, COIN, episode, step)


def _key(seed: Scalar, stream: int, episode: Scalar, step: Scalar) -> PRNGKeyArray:
    key = jnp.stack([jnp.asarray(seed).astype(jnp.uint32), jnp.uint32(stream)])
    counter = jnp.stack([jnp.asarray(episode).astype(jnp.uint32), jnp.asarray(step).astype(jnp.uint32)])
    return jax.random.wrap_key_data(threefry_2x32(key, counter), impl="threefry2x32")
