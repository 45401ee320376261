"""Lets any environment of brax in."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gpcjax._x64 import seeded_key, under_own_settings
from gpcjax.allowed import STEPS, checked, shown
from gpcjax.envs.base import Env, State, begin
from gpcjax.envs.brax_training import quiet
from gpcjax.errors import UserError


class BraxEnv(Env):
    """A brax environment in our shape; `physics` carries brax's own State.

    brax's `done` becomes `terminated`, except where its info names the end a "truncation" (brax's EpisodeWrapper
    does); `truncated` also follows from our `max_steps`. Actions go through clipped to [-1, 1] and otherwise as they
    are: a brax task scales them to its actuators in its own step. Observations and rewards are cast to float64.

    The brax environment is static: two instances are two compilations. Build it with `brax_env`.
    """

    env: Any = eqx.field(static=True)
    label: str = eqx.field(static=True)
    sizes: tuple[int, int] = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    @property
    def name(self) -> str:
        return self.label

    @property
    def obs_size(self) -> int:
        return self.sizes[0]

    @property
    def action_size(self) -> int:
        return self.sizes[1]

    @property
    def time_step(self) -> float:
        """Seconds of a step."""
        return float(self.env.dt)

    def reset(self, key: PRNGKeyArray) -> State:
        inner = jax.tree.map(_strong, self.env.reset(key))
        return begin(inner, inner.obs.astype(jnp.float64))

    def step(self, state: State, action: Float[Array, " action"]) -> State:
        inner = self.env.step(state.physics, jnp.clip(action, -1.0, 1.0))
        inner = jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), inner, state.physics)
        done = inner.done.astype(bool)
        truncation = jnp.asarray(inner.info.get("truncation", False)).astype(bool)
        time = state.time + 1
        return State(
            physics=inner,
            obs=inner.obs.astype(jnp.float64),
            reward=inner.reward.astype(jnp.float64),
            terminated=done & ~truncation,
            truncated=(done & truncation) | (time >= self.max_steps),
            time=time,
        )


def _strong(leaf: Any) -> Array:
    """An array whose type does not depend on what it meets: a Python number or a weak type would retrace `step`."""
    return jnp.asarray(leaf, jnp.asarray(leaf).dtype)


@under_own_settings
def brax_env(env: Any, *, max_steps: Any = 1000, name: Any = None, **arguments: Any) -> BraxEnv:
    """Adapt a brax environment, given as an instance or as the name that brax knows it by.

    Args:
        env: the environment, or its name.
        max_steps: after which an episode is truncated.
        name: under which results are kept; by default brax's name or the name of the class.
        **arguments: of the brax constructor (`backend="spring"`); `env` is then a name.

    Returns:
        A task with observations (obs_size,), actions (action_size,) in [-1, 1] and `time_step` in seconds.

    Raises:
        ValueError: an unknown name, arguments beside an instance, an instance wrapped for brax's own training (those
            reset by themselves or batch), observations that are not one flat array, or `max_steps` that is
            no whole number of at least 1.
    """
    with quiet():
        import brax.envs
        from brax.envs.wrappers.training import AutoResetWrapper, EvalWrapper, VmapWrapper

    max_steps = checked("max_steps", max_steps, int, STEPS)
    if name is not None and (not isinstance(name, str) or not name):
        raise UserError(f"name {shown(name)}: give a word")
    if isinstance(env, str):
        label = env
        try:
            with quiet():
                env = brax.envs.get_environment(env, **arguments)
        except KeyError:
            raise ValueError(f"unknown brax environment {label!r}; allowed: {_brax_names()}") from None
    elif not isinstance(env, brax.envs.Env):
        raise UserError(f"env {shown(env)}: give a brax environment, or the name of one")
    else:
        label = type(env.unwrapped).__name__
        if arguments:
            raise ValueError(
                f"{', '.join(arguments)}: only a brax environment given by its name takes arguments"
            )

    layer = env
    while isinstance(layer, brax.envs.Wrapper):
        if isinstance(layer, AutoResetWrapper | EvalWrapper | VmapWrapper):
            raise ValueError(f"{label} is wrapped in {type(layer).__name__}; give the environment without it")
        layer = layer.env

    obs = jax.eval_shape(env.reset, seeded_key()).obs
    if not (isinstance(obs, jax.ShapeDtypeStruct) and len(obs.shape) == 1):
        raise ValueError(f"{label}: observations must be one flat array, got {obs}")
    return BraxEnv(env=env, label=name or label, sizes=(obs.shape[0], env.action_size), max_steps=max_steps)


def _brax_names() -> str:
    import brax.envs

    return ", ".join(sorted(brax.envs._envs))  # pyright: ignore[reportPrivateUsage]
