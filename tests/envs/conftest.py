"""What the environments' tests share."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.envs.base import Env, State

begin = eqx.filter_jit(lambda env, key: env.reset(key))


@pytest.fixture
def plant() -> Callable[..., State]:
    """A state of `env` at chosen physics, as if `time` steps had been taken."""

    def at(env: Env, physics: np.ndarray, time: int = 0) -> State:
        state = begin(env, jax.random.key(0))
        return eqx.tree_at(
            lambda s: (s.physics, s.time), state, (jnp.asarray(physics), jnp.asarray(time, jnp.int32))
        )

    return at


@pytest.fixture
def starts() -> Callable[[int], jax.Array]:
    """Keys of n starts."""
    return lambda n: jax.random.split(jax.random.key(2024), n)


@eqx.filter_jit
def returns(env: Env, expert: Callable[[jax.Array], jax.Array], keys: jax.Array) -> jax.Array:
    """Of one episode from each of `keys`; steps after the end of an episode do not count."""

    def advance(carry: tuple[State, jax.Array], _: None) -> tuple[tuple[State, jax.Array], jax.Array]:
        state, over = carry
        action = jax.vmap(expert, in_axes=-1, out_axes=-1)(state.obs)
        after = jax.vmap(env.step, in_axes=-1, out_axes=-1)(state, action)
        return (after, over | after.done), jnp.where(over, 0.0, after.reward)

    begun = jax.vmap(env.reset, out_axes=-1)(keys)
    over = jnp.zeros(keys.shape, bool)
    return jax.lax.scan(advance, (begun, over), None, env.max_steps)[1].sum(0)


@pytest.fixture
def expert_returns() -> Callable[..., np.ndarray]:
    """The return of one episode from each of some keys."""
    return lambda env, expert, keys: np.asarray(returns(env, expert, keys))
