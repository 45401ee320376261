"""Named random streams: a seed means the same starts and the same coins for every learner.

Every draw is a function of (seed, stream, episode, step), never of what was drawn before, so that it does not matter
which lane, block or process asks for it.
"""

import jax
from jaxtyping import Array, Int, PRNGKeyArray

import gpcjax._x64  # noqa: F401

START = 0
COIN = 1

Scalar = Int[Array, ""] | int


def start_key(seed: Scalar, episode: Scalar) -> PRNGKeyArray:
    """For `Env.reset` at the start of an episode (from 0)."""
    return _stream(seed, START, episode)


def coin_key(seed: Scalar, episode: Scalar, step: Scalar) -> PRNGKeyArray:
    """For `Teacher.coins` at one step (from 0) of an episode."""
    return jax.random.fold_in(_stream(seed, COIN, episode), step)


def _stream(seed: Scalar, stream: int, episode: Scalar) -> PRNGKeyArray:
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), stream), episode)
