"""Hyperparameters of the three domains, from Tables 5.1 (pendulum), 5.2 (cart-pole), 5.3 (lander) and A.1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tests.reference.dense import DenseCOACH, DenseGPC


@dataclass(frozen=True)
class Domain:
    """One domain: its sizes, the typical size of each state, and the arguments of the three learners."""

    obs_size: int
    action_size: int
    spread: tuple[float, ...]  # how far each state strays; only for drawing test inputs
    gpc: dict[str, Any]
    gpc_ns: dict[str, Any]
    coach: dict[str, Any]


def _gp(
    c_h: float, l_h: float, c_p: float, l_p: float, nu_p: float, c_r: float, **more: Any
) -> dict[str, Any]:
    """Arguments of DenseGPC, in the order of the tables' rows."""
    human = {"human_variance": c_h, "human_length_scale": l_h}
    policy = {"policy_variance": c_p, "policy_length_scale": l_p, "policy_nu": nu_p}
    return {**human, **policy, "constant_rate": c_r, **more}


DOMAINS = {
    "pendulum": Domain(
        obs_size=3,
        action_size=1,
        spread=(1.0, 1.0, 6.0),
        gpc=_gp(0.7, 0.1, 0.01, 0.7, 0.5, 0.01, weights=(1.0, 1.0, 1 / 6)),
        gpc_ns=_gp(0.45, 0.1, 0.03, 0.5, 1.5, 0.02),
        coach={
            "beta": (30.0,),
            "magnitude": (5.0,),
            "coach_constant": (1.8,),
            "grid": ((-1, 6, 1), (-1, 6, 1), (-6, 7, 6)),
        },
    ),
    "cartpole": Domain(
        obs_size=4,
        action_size=1,
        spread=(1.0, 1.0, 0.13, 0.4),
        gpc=_gp(0.01, 0.2, 0.01, 0.2, 1.5, 0.02, weights=(1.0, 1.0, 1 / 0.13, 1 / 0.4)),
        gpc_ns=_gp(0.08, 0.5, 1e-3, 0.7, 1.5, 0.05),
        coach={
            "beta": (30.0,),
            "magnitude": (5.0,),
            "coach_constant": (1.8,),
            "grid": ((-1.44, 4, 1.44), (-0.12, 4, 0.12), (-0.126, 4, 0.126), (-0.4, 4, 0.4)),
        },
    ),
    "lunarlander": Domain(
        obs_size=8,
        action_size=2,
        spread=(0.5, 1.0, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0),
        gpc=_gp(0.01, 0.2, 0.01, 0.4, 1.5, 0.02, weights=(1.0,) * 8),
        gpc_ns=_gp(0.08, 0.2, 1e-3, 0.6, 1.5, 0.05),
        coach={  # per action dimension
            "beta": (1.0, 1.0),
            "magnitude": (5.0, 1.0),
            "coach_constant": (1.0, 20.0),
            "grid": ((-1, 2, 1), (-1, 3, 1), *((-1, 2, 1),) * 6),
        },
    ),
}


def make_reference(algo: str, name: str, **changes: Any) -> DenseGPC | DenseCOACH:
    """The dense learner `algo` ("gpc", "gpc-ns", "coach") with domain `name`'s values, save for `changes`."""
    domain = DOMAINS[name]
    if algo == "coach":
        return DenseCOACH(**{**domain.coach, **changes})
    values = domain.gpc if algo == "gpc" else domain.gpc_ns
    values = {"normalise": algo == "gpc-ns", **values, **changes}
    return DenseGPC(domain.obs_size, domain.action_size, **values)
