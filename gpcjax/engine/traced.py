"""Whether jax can trace somebody's policy, and what it is then: traced more than once, and nothing left behind."""

import contextvars
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from gpcjax.engine.programs import lifted
from gpcjax.engine.remembered import Remembered
from gpcjax.envs.base import Env
from gpcjax.envs.host import HostEnv
from gpcjax.policies.base import Controller, Planner, Policy, vector

Function = Callable[[Any], Any]

_OURS = Policy | Controller | Planner
"""Policies that draw no numbers, and have no memory."""
_TIMES = 3
"""How often a person's function is traced."""


class _Lifted(NamedTuple):
    """A policy that jax has traced."""

    leaves: list[Any]
    """The arrays that it consists of, if it is a pytree."""
    values: list[Any]
    """Those that it closes over, and its numbers."""
    act: Callable[..., Any]
    text: str
    shape: jax.ShapeDtypeStruct
    """Of its action."""


def traced(env: Env | HostEnv, policy: Function) -> tuple[Any, Callable[..., Any]] | None:
    """The values in a policy, and the policy as a function of these values and an observation.

    None if jax cannot trace it, if its result is not jax's, which may be another one at each call, or if it is another
    function when it is traced again, or goes on changing what it refers to: then that is what it was before.

    Raises:
        UserError: its result is no action of this task.
    """
    found = _lifted(env, policy) if isinstance(policy, _OURS) else _steady(env, policy)
    if found is None:
        return None
    vector("the policy's action", np.zeros(found.shape.shape, found.shape.dtype), env.action_size, env.name)
    return [found.leaves, found.values], lambda given, obs: found.act(given[1], given[0], obs)


def _steady(env: Env | HostEnv, policy: Function) -> _Lifted | None:
    """A person's function, if it is the same one each time it is traced; what tracing changes is put back if not."""
    seen: list[Remembered] = []
    found: list[_Lifted | None] = []
    disturbed = False
    for _ in range(_TIMES):
        seen.append(Remembered(policy))
        if seen[-1].uses_up:  # each call takes something, also one that jax traces
            found.append(None)
        else:
            found.append(contextvars.copy_context().run(_lifted, env, policy, seen[-1].look_again))
        if found[-1] is None:
            break
        disturbed |= seen[-1].is_disturbed
    first, *again = found
    # Something may be made at the first call, and kept.
    kept = not any(each.is_changed or not each.tracers.keys() <= seen[0].tracers.keys() for each in seen[1:])
    if (
        kept
        and first is not None
        and all(each is not None and _alike(first, each, disturbed) for each in again)
    ):
        return first
    for each in reversed(seen):
        each.put_back()
    return None


def _lifted(
    env: Env | HostEnv, policy: Function, called: Callable[[], None] = lambda: None
) -> _Lifted | None:
    """None if jax cannot trace it, or its result is not jax's. `called` comes right after its call."""
    arrays, static = eqx.partition(policy, eqx.is_array)
    shape: jax.ShapeDtypeStruct | None = None

    def probe(arrays: Any, obs: Float[Array, " obs"]) -> Any:
        nonlocal shape
        try:
            action = eqx.combine(arrays, static)(obs)
        finally:
            called()
        shape = jax.ShapeDtypeStruct(action.shape, action.dtype) if isinstance(action, jax.Array) else None
        return action if shape else obs

    try:
        values, act, text = lifted(probe, arrays, jax.ShapeDtypeStruct((env.obs_size,), float))
        lanes = jax.ShapeDtypeStruct((env.obs_size, 2), float)
        leaves = jax.tree.leaves(arrays)
        jax.eval_shape(jax.vmap(lambda obs: act(values, *leaves, obs), in_axes=-1), lanes)
    except Exception:  # whatever a function of numpy meets: on the host it shows whether it is a mistake
        return None
    return None if shape is None else _Lifted(leaves, values, act, text, shape)


def _alike(one: _Lifted, other: _Lifted, disturbed: bool) -> bool:
    """Whether both compute the same, as far as that is known while jax traces what is around them.

    Where somebody else has changed something meanwhile, a state that is being taught, they may have other values.
    """
    return re.sub(_ADDRESS, "", one.text) == re.sub(_ADDRESS, "", other.text) and all(
        isinstance(now, Tracer) or (not isinstance(then, Tracer) and (disturbed or _bits(now) == _bits(then)))
        for now, then in zip(one.values, other.values, strict=True)
    )


_ADDRESS = "0x[0-9a-f]+"


def _bits(value: Any) -> bytes:
    is_key = isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(value) if is_key else value).tobytes()
