"""Named random streams: a seed means the same starts and the same coins for every learner.

Every draw is a function of (seed, stream, episode, step), never of what was drawn before, so that it does not matter
which lane, block or process asks for it. Threefry is a counter-based generator, made for this: (seed, stream) is its
key, and what it makes of the counter (episode, 0) is in turn the key of the episode.

Coins are drawn for every step of every lane. jax's own Threefry runs as a loop over its rounds on a CPU, which takes
ten times as long as the same rounds written out.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt32

import gpcjax._x64  # noqa: F401

START = 0
COIN = 1
LEARNER = 2
TEACHER = 3

Scalar = Int[Array, ""] | int
Word = UInt32[Array, ""]

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = 0x1BD11BDA


def start_key(seed: Scalar, episode: Scalar) -> PRNGKeyArray:
    """For `Env.reset` at the start of an episode (from 0)."""
    return _typed(*_episode_key(seed, START, episode))


def reset_seeds(seed: int, episodes: int) -> list[int]:
    """For `Simulation.reset` at the start of each episode: the first words of their start keys."""
    more = 1 << (episodes - 1).bit_length()  # few programs for all numbers of episodes
    return np.asarray(_first_words(seed, more))[:episodes].tolist()


def coins(seed: Scalar, episode: Scalar, step: Scalar, action_size: int) -> Float[Array, " action"]:
    """The teacher's coins at one step (from 0) of an episode, one for each action dimension: uniform in [0, 1)."""
    key = _episode_key(seed, COIN, episode)
    draws = [_uniform(*threefry(key, (_word(step), _word(dimension)))) for dimension in range(action_size)]
    return jnp.stack(draws)


def first_key(seed: Scalar) -> PRNGKeyArray:
    """For `Learner.init`."""
    return _typed(*threefry((_word(seed), jnp.uint32(LEARNER)), (jnp.uint32(0), jnp.uint32(1))))


def learner_key(seed: Scalar, episode: Scalar, step: Scalar, use: Scalar = 0) -> PRNGKeyArray:
    """For what a learner draws at one step (from 0) of an episode, another one for each use of it there."""
    return _typed(*threefry(_episode_key(seed, LEARNER, episode), (_word(step), _word(use))))


def draws(seed: Scalar, episode: Scalar, step: Scalar) -> Float[Array, " 3"]:
    """What a teacher draws beside its coins at one step: uniform in [0, 1)."""
    key = _episode_key(seed, TEACHER, episode)
    return jnp.stack([_uniform(*threefry(key, (_word(step), _word(which)))) for which in range(3)])


def threefry(key: tuple[Word, Word], counter: tuple[Word, Word]) -> tuple[Word, Word]:
    """Threefry-2x32 with 20 rounds (Salmon et al., Parallel Random Numbers: As Easy as 1, 2, 3; 2011)."""
    keys = (*key, key[0] ^ key[1] ^ jnp.uint32(_PARITY))
    x, y = counter[0] + keys[0], counter[1] + keys[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x = x + y
            y = ((y << rotation) | (y >> (32 - rotation))) ^ x
        x, y = x + keys[(group + 1) % 3], y + keys[(group + 2) % 3] + jnp.uint32(group + 1)
    return x, y


@functools.partial(jax.jit, static_argnums=1)
def _first_words(seed: Scalar, episodes: int) -> UInt32[Array, " episodes"]:
    return jax.vmap(lambda episode: _episode_key(seed, START, episode)[0])(jnp.arange(episodes))


def _episode_key(seed: Scalar, stream: int, episode: Scalar) -> tuple[Word, Word]:
    return threefry((_word(seed), jnp.uint32(stream)), (_word(episode), jnp.uint32(0)))


def _typed(high: Word, low: Word) -> PRNGKeyArray:
    return jax.random.wrap_key_data(jnp.stack([high, low]), impl="threefry2x32")


def _word(value: Scalar) -> Word:
    return jnp.asarray(value).astype(jnp.uint32)


def _uniform(high: Word, low: Word) -> Float[Array, ""]:
    """52 random bits as the fraction of a number in [1, 2), less 1."""
    bits = (high.astype(jnp.uint64) << 32) | low.astype(jnp.uint64)
    one = jnp.uint64(0x3FF0000000000000)
    return lax.bitcast_convert_type((bits >> 12) | one, jnp.float64) - 1.0
