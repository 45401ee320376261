"""How well a fixed policy does: its return from many starts."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from gpcjax._x64 import under_own_settings
from gpcjax.engine import streams
from gpcjax.envs.base import Env, State
from gpcjax.envs.host import HostEnv

Function = Callable[[Float[Array, " obs"]], Float[Array, " action"]]


class Returns(eqx.Module):
    """One episode from each start."""

    returns: Float[Array, " starts"]
    length: Int[Array, " starts"]


@under_own_settings
def evaluate(env: Env | HostEnv, policy: Function, starts: int = 100) -> Returns:
    """One episode of `policy` (obs -> action) from each of `starts` starts, none of it learned from.

    The starts are those of the first episode of seeds 0 to starts - 1.
    """
    if isinstance(env, HostEnv):
        return _evaluate_on_host(env, policy, starts)
    return _evaluate(env, policy, jnp.arange(starts))


def idle(env: Env | HostEnv) -> Function:
    """The policy that does nothing: a = 0, what every learner starts with."""
    return lambda obs: jnp.zeros(env.action_size)


@eqx.filter_jit
def _evaluate(env: Env, policy: Function, seeds: Int[Array, " starts"]) -> Returns:
    def more(carry: tuple[State, Float[Array, " starts"]]) -> Array:
        return ~carry[0].done.all()

    def body(carry: tuple[State, Float[Array, " starts"]]) -> tuple[State, Float[Array, " starts"]]:
        state, returns = carry
        action = jax.vmap(policy, in_axes=-1, out_axes=-1)(state.obs)
        after = jax.vmap(env.step, in_axes=-1, out_axes=-1)(state, action)
        done = state.done
        state = jax.tree.map(lambda new, old: jnp.where(done, old, new), after, state)
        return state, returns + jnp.where(done, 0.0, after.reward)

    state = jax.vmap(lambda seed: env.reset(streams.start_key(seed, 0)), out_axes=-1)(seeds)
    state, returns = lax.while_loop(more, body, (state, jnp.zeros(seeds.shape)))
    return Returns(returns=returns, length=state.time)


def _evaluate_on_host(env: HostEnv, policy: Function, starts: int) -> Returns:
    act = jax.jit(jax.vmap(policy, in_axes=-1, out_axes=-1))
    simulations = [env.simulate() for _ in range(starts)]
    obs = np.stack(
        [run.reset(streams.reset_seeds(seed, 1)[0]) for seed, run in enumerate(simulations)], axis=-1
    )
    returns, length, going = np.zeros(starts), np.zeros(starts, int), list(range(starts))
    while going:
        action = env.scaled(np.asarray(act(obs)))
        for place in tuple(going):
            outcome = simulations[place].step(action[:, place])
            obs[:, place] = outcome.obs
            returns[place] += outcome.reward
            length[place] += 1
            if outcome.terminated or outcome.truncated:
                going.remove(place)
    return Returns(returns=jnp.asarray(returns), length=jnp.asarray(length))
