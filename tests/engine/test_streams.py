"""Random streams are functions of (seed, stream, episode, step)."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.random import threefry_2x32

from gpcjax.engine import streams

start_key = jax.jit(streams.start_key)


def bits(key) -> tuple[int, ...]:
    return tuple(np.asarray(jax.random.key_data(key)).ravel().tolist())


def test_threefry_is_the_one_of_jax():
    words = np.random.default_rng(0).integers(0, 2**32, (4, 1000), dtype=np.uint32)
    ours = jax.jit(jax.vmap(lambda a, b, c, d: streams.threefry((a, b), (c, d))))(*words)
    theirs = jax.jit(jax.vmap(lambda a, b, c, d: threefry_2x32(jnp.stack([a, b]), jnp.stack([c, d]))))(*words)
    np.testing.assert_array_equal(np.stack(ours, 1), theirs)


def test_no_two_draws_are_the_same():
    """Seeds, episodes, steps and dimensions: small numbers, whose sums and products collide a lot."""
    small = range(6)
    starts = {bits(start_key(*place)) for place in itertools.product(small, small)}
    assert len(starts) == 6**2
    coins = jax.jit(jax.vmap(lambda *place: streams.coins(*place, 6)))
    drawn = coins(*jnp.array(list(itertools.product(small, small, small))).T)
    assert len(np.unique(drawn)) == 6**4


def test_the_same_place_means_the_same_draws():
    """As Python numbers, traced, or in a batch."""
    place = (7, 3, 1234)
    expected = streams.coins(*place, 1)
    traced = (jnp.asarray(7), jnp.asarray(3, jnp.int32), jnp.asarray(1234, jnp.int32))
    np.testing.assert_array_equal(jax.jit(streams.coins, static_argnums=3)(*traced, 1), expected)
    batch = jax.jit(jax.vmap(lambda *place: streams.coins(*place, 1)))(
        jnp.array([1, 7]), jnp.array([0, 3]), jnp.array([9, 1234])
    )
    np.testing.assert_array_equal(batch[1], expected)
    assert bits(jax.jit(streams.start_key)(*traced[:2])) == bits(streams.start_key(7, 3))


def test_seeds_up_to_the_largest_that_a_sweep_takes_differ():
    seeds = jnp.concatenate([jnp.arange(2000), jnp.array([999_999, 1_000_000])])
    keys = jax.jit(
        lambda seeds: jax.random.key_data(jax.vmap(lambda seed: streams.start_key(seed, 0))(seeds))
    )(seeds)
    assert len(np.unique(keys, axis=0)) == len(seeds)


def test_coins_are_uniform_and_independent():
    """Of their neighbours in every direction, and of the other action dimension."""
    seed, episode, step = jnp.meshgrid(jnp.arange(20), jnp.arange(10), jnp.arange(100), indexing="ij")
    draw = jax.jit(jax.vmap(lambda *place: streams.coins(*place, 2)))
    coins = np.asarray(draw(seed.ravel(), episode.ravel(), step.ravel())).reshape(20, 10, 100, 2)
    assert ((coins >= 0) & (coins < 1)).all()
    counts = np.histogram(coins, bins=20, range=(0, 1))[0] / coins.size
    np.testing.assert_allclose(counts, 0.05, atol=0.005)
    for axis in range(4):
        here, next_to_it = (
            np.take(coins, range(*part), axis)
            for part in ((0, coins.shape[axis] - 1), (1, coins.shape[axis]))
        )
        assert abs(np.corrcoef(here.ravel(), next_to_it.ravel())[0, 1]) < 0.03


def test_starts_and_coins_of_one_place_are_independent():
    place = (jnp.repeat(jnp.arange(100), 30), jnp.tile(jnp.arange(30), 100))
    start = jax.jit(jax.vmap(lambda *p: jax.random.uniform(streams.start_key(*p))))(*place)
    coin = jax.jit(jax.vmap(lambda *p: streams.coins(*p, 0, 1)[0]))(*place)
    assert abs(np.corrcoef(start, coin)[0, 1]) < 0.07


def test_seeds_of_resets_are_the_first_words_of_start_keys():
    for seed in (0, 1, 2, 999_999):
        keys = [bits(start_key(seed, episode)) for episode in range(5)]
        assert streams.reset_seeds(seed, 5) == [key[0] for key in keys]
        assert all(type(each) is int for each in streams.reset_seeds(seed, 5))
        assert streams.reset_seeds(seed, 3) == streams.reset_seeds(seed, 5)[:3]


def test_no_two_resets_have_the_same_seed():
    drawn = [each for seed in range(40) for each in streams.reset_seeds(seed, 25)]
    assert len(set(drawn)) == 40 * 25 and min(drawn) >= 0 and max(drawn) < 2**32
