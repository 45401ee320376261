"""How well a fixed policy does: its return from many starts."""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import COUNT, Numbers, checked, shown
from gpcjax.engine import streams
from gpcjax.engine.programs import program
from gpcjax.engine.traced import Function, traced
from gpcjax.envs.base import Env, State, started, stepped
from gpcjax.envs.host import HostEnv
from gpcjax.errors import UserError
from gpcjax.learners.calls import unless_given_away
from gpcjax.policies.base import vector
from gpcjax.policies.vectors import is_traced

FIRST_SEED = Numbers(0, 1_000_000_000, whole=True)
"""Of the starts: with as many as there may be, seeds still fit into an int32."""


class Returns(eqx.Module):
    """One episode from each start."""

    returns: Float[Array, " starts"]
    """Sum of the rewards; NaN where an action, an observation or a reward was not finite."""
    length: Int[Array, " starts"]
    """Steps taken, until that happened where it did."""


@under_own_settings
def evaluate(env: Any, policy: Any, starts: Any = 100, seed: Any = 0) -> Returns:
    """One episode of `policy` from each of `starts` starts, none of it learned from.

    The starts are those of the first episode of seeds `seed` to `seed + starts - 1`.

    An action that is not finite ends its episode and is not simulated; a step that leads to an observation or a reward
    that is not finite counts and is the last one. The return of such an episode is NaN.

    Args:
        env: from `make_env`, or a task of one's own.
        policy: obs (obs_size,) -> action (action_size,), real numbers, clipped to [-1, 1]. If jax can trace it, all
            starts are simulated together in one compiled program; each call sees what the function refers to now, and
            compiles nothing if only the values of arrays have changed since an earlier one. A function that jax cannot
            trace (it converts its observation to numpy, or looks at its value), whose result does not come from jax,
            that is another one when it is traced again, or that changes what it refers to (it draws numbers, counts,
            or remembers), is called on the host with a numpy array, at each step once for each start, in their order.
            So is one that refers to an iterator or to a file that it can read. What changes where Python cannot look,
            such as a clock, and chooses between results of jax's may pass unseen, and what is remembered there is left
            with what jax traces: `obs = np.asarray(obs)` as its first line says that it is to be called on the host.
            One that remembers an episode is asked for one start at a time. What other threads change meanwhile stays as
            they leave it.
        starts: a whole number from 1 to 1,000,000.
        seed: of the first start, a whole number from 0 to 1,000,000,000.

    Returns:
        `returns` (starts,), the sum of each episode's rewards in the task's unit, and `length` (starts,), its steps.

    Raises:
        ValueError: no task, no function, another number of starts, another seed, actions of another shape or type, or
            a task whose states have other shapes or types than it declares, or a policy that remembers what jax traces.
    """
    if not isinstance(env, Env | HostEnv):
        raise UserError(f'env {shown(env)}: give a task, such as make_env("cartpole")')
    if not callable(policy):
        raise UserError(
            f"policy {shown(policy)}: give a function of the observation, such as learner.policy_of(state)"
        )
    starts = checked("starts", starts, int, COUNT)
    first = checked("seed", seed, int, FIRST_SEED)
    try:
        return _evaluated(env, policy, starts, first)
    except jax.errors.UnexpectedTracerError as error:
        raise _left_behind() from error


def _evaluated(env: Env | HostEnv, policy: Function, starts: int, first: int) -> Returns:
    found = traced(env, policy)
    if isinstance(env, HostEnv):
        actions = _one_by_one(env, policy) if found is None else _together(env, *found, starts)
        return _on_host(env, actions, starts, first)
    if found is None:
        return _stepwise(env, _one_by_one(env, policy), starts, first)
    values, act = found
    arrays, static = eqx.partition(env, eqx.is_array)
    run = lambda arrays, values, seeds: _compiled(  # noqa: E731
        eqx.combine(arrays, static), lambda obs: act(values, obs), seeds
    )
    seeds = first + jnp.arange(starts)
    with unless_given_away(values):
        return program(run, arrays, values, seeds)(arrays, values, seeds)


def idle(env: Env | HostEnv) -> Function:
    """The policy that does nothing: a = 0, what every learner starts with."""
    return lambda obs: jnp.zeros(env.action_size)


class _Episodes(eqx.Module):
    """One episode in each lane, under way or over."""

    state: State
    returns: Float[Array, " lanes"]
    broken: Bool[Array, " lanes"]
    """Something was not finite."""

    @property
    def over(self) -> Bool[Array, " lanes"]:
        return self.state.done | self.broken

    def result(self) -> Returns:
        return Returns(returns=jnp.where(self.broken, jnp.nan, self.returns), length=self.state.time)


def _begin(env: Env, seeds: Int[Array, " lanes"]) -> _Episodes:
    state = jax.vmap(lambda seed: started(env, streams.start_key(seed, 0)), out_axes=-1)(seeds)
    return _Episodes(state, jnp.zeros(seeds.shape), ~jnp.isfinite(state.obs).all(0))


def _advance(env: Env, now: _Episodes, action: Float[Array, "action lanes"]) -> _Episodes:
    """A step of the lanes whose episode is not over and whose action is finite."""
    going, acts = ~now.over, jnp.isfinite(action).all(0)
    action = jnp.clip(action, -1.0, 1.0)  # as a policy's is in a sweep: a task need not do it
    after = jax.vmap(partial(stepped, env), in_axes=-1, out_axes=-1)(now.state, action)
    steps = going & acts
    finite = jnp.isfinite(after.obs).all(0) & jnp.isfinite(after.reward)
    return _Episodes(
        state=jax.tree.map(lambda new, old: jnp.where(steps, new, old), after, now.state),
        returns=now.returns + jnp.where(steps, after.reward, 0.0),
        broken=now.broken | (going & ~acts) | (steps & ~finite),
    )


def _compiled(env: Env, policy: Function, seeds: Int[Array, " lanes"]) -> Returns:
    """All steps of all episodes, with a policy that jax can trace."""

    def body(now: _Episodes) -> _Episodes:
        action = jax.vmap(policy, in_axes=-1, out_axes=-1)(now.state.obs)
        return _advance(env, now, action.astype(float))

    return lax.while_loop(lambda now: ~now.over.all(), body, _begin(env, seeds)).result()


Actions = Callable[[Float[np.ndarray, "obs lanes"], list[int]], Float[np.ndarray, "action lanes"]]
"""The actions at these observations; they count in the lanes that are listed."""


def _stepwise(env: Env, actions: Actions, starts: int, first: int) -> Returns:
    """The same with a policy on the host: step after step, the task alone compiled."""
    arrays, static = eqx.partition(env, eqx.is_array)
    seeds = first + jnp.arange(starts)
    begin = lambda arrays, seeds: _begin(eqx.combine(arrays, static), seeds)  # noqa: E731
    now = program(begin, arrays, seeds)(arrays, seeds)
    step = lambda arrays, now, action: _advance(eqx.combine(arrays, static), now, action)  # noqa: E731
    step = program(step, arrays, now, jnp.zeros((env.action_size, starts)))
    while going := np.flatnonzero(~np.asarray(now.over)).tolist():
        now = step(arrays, now, jnp.asarray(actions(np.asarray(now.state.obs), going)))
    return now.result()


def _on_host(env: HostEnv, actions: Actions, starts: int, first: int) -> Returns:
    simulations = [env.simulate() for _ in range(starts)]
    obs = np.stack(
        [run.reset(streams.reset_seeds(seed, 1)[0]) for seed, run in enumerate(simulations, first)], axis=-1
    )
    returns, length = np.zeros(starts), np.zeros(starts, int)
    returns[~np.isfinite(obs).all(0)] = np.nan
    going = np.flatnonzero(~np.isnan(returns)).tolist()
    while going:
        chosen = actions(obs, going)
        scaled = env.scaled(chosen)
        for place in tuple(going):
            if not np.isfinite(chosen[:, place]).all():
                returns[place] = np.nan
                going.remove(place)
                continue
            outcome = simulations[place].step(scaled[:, place])
            obs[:, place] = outcome.obs
            length[place] += 1
            returns[place] += outcome.reward
            if not (np.isfinite(outcome.reward) and np.isfinite(obs[:, place]).all()):
                returns[place] = np.nan
            if outcome.terminated or outcome.truncated or np.isnan(returns[place]):
                going.remove(place)
    return Returns(returns=jnp.asarray(returns), length=jnp.asarray(length))


def _together(env: HostEnv, values: Any, act: Callable[..., Any], starts: int) -> Actions:
    """A policy that jax can trace, for all lanes at once."""
    batch = jax.vmap(act, in_axes=(None, -1), out_axes=-1)
    batch = program(batch, values, jnp.zeros((env.obs_size, starts)))

    def actions(obs: Float[np.ndarray, "obs lanes"], going: list[int]) -> Float[np.ndarray, "action lanes"]:
        with unless_given_away(values):
            return np.asarray(batch(values, jnp.asarray(obs)), np.float64)

    return actions


def _one_by_one(env: Env | HostEnv, policy: Function) -> Actions:
    """A policy on the host, asked in the lanes that are listed."""

    def actions(obs: Float[np.ndarray, "obs lanes"], going: list[int]) -> Float[np.ndarray, "action lanes"]:
        result = np.zeros((env.action_size, obs.shape[1]))
        for lane in going:
            given = policy(obs[:, lane].copy())  # a copy: what it does to its observation is its own affair
            if is_traced(given):
                raise _left_behind()
            result[:, lane] = vector("the policy's action", given, env.action_size, env.name)
        return result

    return actions


def _left_behind() -> UserError:
    """What is said where a policy remembers what it was traced with, and Python could not look there."""
    return UserError(
        "the policy remembers something out of sight, which jax traced: make it anew, and begin it with "
        "obs = np.asarray(obs), so that it is called at each step"
    )
