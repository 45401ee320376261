"""Experts of tasks for one observation at a time, in plain numbers: what a scripted participant would do. Loads no jax.

The laws are those of `gpcjax.envs.experts`, which are compiled for many lanes; `tests/study/test_bots.py` compares
them. A task without one here has its own first expert, which may load jax.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gpcjax.errors import UserError
from gpcjax.policies.policy import Policy
from gpcjax.registry import find
from gpcjax.study.bots.behaviour import Expert

Obs = Sequence[float]


def expert_of(task: str) -> Expert:
    """The expert of a task.

    Raises:
        UserError: it has none, or is not known here.
    """
    if task in _PLAIN:
        return _PLAIN[task]
    experts = find("task", task).experts
    if not experts:
        raise UserError(f"{task}: no expert is known, so that nobody can be scripted who teaches it")
    from gpcjax.envs.registry import make_expert

    made: Any = make_expert(task, next(iter(experts)))
    if isinstance(made, Policy):
        return lambda obs: np.asarray(made(np.asarray(obs, np.float64))).tolist()
    import jax.numpy as jnp  # an expert of its own kind

    return lambda obs: np.asarray(made(jnp.asarray(obs, jnp.float64))).tolist()


def energy_swing_up(obs: Obs) -> list[float]:
    """`gpcjax.envs.experts.EnergySwingUp` with its defaults."""
    cos, sin, speed = obs
    energy = 0.5 * speed * speed + 15.0 * (cos - 1.0)
    stabilise = -(6.5 * sin + 1.6 * speed)
    pump = 0.2 * (1.2 - energy) * (speed + 1.7 * sin)
    weight = 1 / (1 + math.exp(-(cos - 0.7) / 0.1))
    return [_clipped(weight * stabilise + (1 - weight) * pump)]


def valley_pump(obs: Obs) -> list[float]:
    """`gpcjax.envs.experts.ValleyPump` with its defaults."""
    return [0.5 * math.tanh((obs[1] + 0.001) / 0.01)]


def lander_heuristic(obs: Obs) -> list[float]:
    """`gpcjax.envs.experts.LanderHeuristic` with its defaults."""
    x, y, x_speed, y_speed, angle, spin, left, right = obs
    turn = 0.5 * (min(max(0.5 * x + x_speed, -0.4), 0.4) - angle) - spin
    climb = 0.5 * (0.55 * abs(x) - y) - 0.5 * y_speed
    if left or right:
        turn, climb = 0.0, -0.5 * y_speed
    return [_clipped(20.0 * climb - 1.0), _clipped(-20.0 * turn)]


def _clipped(action: float) -> float:
    return min(max(action, -1.0), 1.0)


_PLAIN: dict[str, Callable[[Obs], list[float]]] = {
    "pendulum": energy_swing_up,
    "mountaincar": valley_pump,
    "lunarlander": lander_heuristic,
}
"""Of the others that are built in the first expert is a policy that is computed in numpy."""
