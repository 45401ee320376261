"""The first thing that one writes in jax: `vmap` over a step that corrects inside a `lax.cond`.

Under `vmap` the `cond` becomes a select: every lane pays for a correction, O(capacity^2), at every step.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from gpcjax.envs.base import State
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.learners.factory import make_learner
from gpcjax.moment import Moment
from gpcjax.sweep.build import make_oracle

CAPACITY = 256


@dataclass(frozen=True)
class Result:
    """What a batch of lanes did."""

    env_steps: int
    lanes: int
    corrections: int
    policy_points: list[int]
    human_points: list[int]


def make(
    algo: str,
    env: str,
    errors: tuple[float, ...],
    steps: int,
    *,
    rate: float,
    delta: float,
    expert: str,
    seeds: int = 4,
) -> Callable[[int], Result]:
    """A function of the repetition that runs `seeds` lanes for each error, `steps` each; compiled at its first call."""
    task, learner = make_env(env), make_learner(algo, env, capacity=CAPACITY)
    teacher, target = make_oracle(env, expert, rate=rate, delta=delta).oracle, make_expert(env, expert)

    def lane(key, error):
        def step(carry, key):
            state, situation, corrections = carry
            coin, restart = jax.random.split(key)
            action = learner.act(state, situation.obs)
            advice = teacher.__class__(
                rate=teacher.rate,
                error=error,
                delta=teacher.delta,
                active_gain=teacher.active_gain,
                active=False,
            ).advise(jax.random.uniform(coin, (1,)), _moment(situation, action, target))
            state = lax.cond(
                (advice != 0).any(),
                lambda state: learner.correct(state, situation.obs, action, advice)[0],
                lambda state: state,
                state,
            )
            after = task.step(situation, action)
            fresh = task.reset(restart)
            after = jax.tree.map(lambda new, old: jnp.where(after.done, new, old), fresh, after)
            return (state, after, corrections + (advice != 0).sum()), None

        first, rest = jax.random.split(key)
        carry = (learner.init(), task.reset(first), jnp.zeros((), int))
        (state, _, corrections), _ = lax.scan(step, carry, jax.random.split(rest, steps))
        return corrections, *learner.points(state)

    batch = jax.jit(jax.vmap(lane))
    chances = jnp.repeat(jnp.asarray(errors), seeds)

    def run(repetition: int) -> Result:
        keys = jax.random.split(jax.random.key(repetition), len(chances))
        corrections, policy, human = (np.asarray(value) for value in batch(keys, chances))
        assert (policy > 0).all()
        return Result(
            len(chances) * steps, len(chances), int(corrections.sum()), policy.tolist(), human.tolist()
        )

    return run


def _moment(situation: State, action: Array, target: Callable[[Array], Array]) -> Moment:
    """What the teacher is asked about."""
    return Moment(
        obs=situation.obs,
        action=action,
        episode=jnp.int32(0),
        step=situation.time,
        target=target(situation.obs),
        sigma_human=jnp.zeros(1),
    )
