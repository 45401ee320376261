"""The thesis' hyperparameters: Tables 5.1 to 5.3 for GPC and GPC-NS, Table A.1 for COACH. Data only, no jax.

Each entry holds the keyword arguments of `gpcjax.learners.factory.make_learner`.
"""

from collections.abc import Mapping
from typing import Any

SIZES: dict[str, dict[str, int]] = {
    "pendulum": {"obs_size": 3, "action_size": 1},
    "cartpole": {"obs_size": 4, "action_size": 1},
    "lunarlander": {"obs_size": 8, "action_size": 2},
}


def _gp(
    c_h: float, l_h: float, c_p: float, l_p: float, nu_p: float, c_r: float, **more: Any
) -> dict[str, Any]:
    """One column of Tables 5.1 to 5.3, in their order of rows."""
    return {
        "human_variance": c_h,
        "human_length_scale": l_h,
        "policy_variance": c_p,
        "policy_length_scale": l_p,
        "policy_nu": nu_p,
        "constant_rate": c_r,
        **more,
    }


PRESETS: dict[str, dict[str, Mapping[str, Any]]] = {
    "gpc": {
        "pendulum": _gp(0.7, 0.1, 0.01, 0.7, 0.5, 0.01, scaling=(1.0, 1.0, 1 / 6)),
        "cartpole": _gp(0.01, 0.2, 0.01, 0.2, 1.5, 0.02, scaling=(1.0, 1.0, 1 / 0.13, 1 / 0.4)),
        "lunarlander": _gp(0.01, 0.2, 0.01, 0.4, 1.5, 0.02, scaling=(1.0,) * 8),
    },
    "gpc-ns": {
        "pendulum": _gp(0.45, 0.1, 0.03, 0.5, 1.5, 0.02),
        "cartpole": _gp(0.08, 0.5, 1e-3, 0.7, 1.5, 0.05),
        "lunarlander": _gp(0.08, 0.2, 1e-3, 0.6, 1.5, 0.05),
    },
    "coach": {
        "pendulum": {
            "lower": (-1.0, -1.0, -6.0),
            "counts": (6, 6, 7),
            "upper": (1.0, 1.0, 6.0),
            "beta": 30.0,
            "magnitude": 5.0,
            "coach_constant": 1.8,
        },
        "cartpole": {
            "lower": (-1.44, -0.12, -0.126, -0.4),
            "counts": (4, 4, 4, 4),
            "upper": (1.44, 0.12, 0.126, 0.4),
            "beta": 30.0,
            "magnitude": 5.0,
            "coach_constant": 1.8,
        },
        "lunarlander": {
            "lower": (-1.0,) * 8,
            "counts": (2, 3, 2, 2, 2, 2, 2, 2),
            "upper": (1.0,) * 8,
            "beta": (1.0, 1.0),
            "magnitude": (5.0, 1.0),
            "coach_constant": (1.0, 20.0),
        },
    },
}
