"""Learners by name: the thesis' tables, or the sizes and hyperparameters of a task of one's own."""

import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from gpcjax._x64 import under_own_settings
from gpcjax.gp.kernels import SQUARED_EXPONENTIAL, Kernel
from gpcjax.gp.regression import GaussianProcess
from gpcjax.learners.base import Learner
from gpcjax.learners.coach import COACH
from gpcjax.learners.gpc import GPC
from gpcjax.learners.hyperparameters import ON_FULL
from gpcjax.learners.presets import PRESETS, SIZES
from gpcjax.policies.grid import Grid

DEFAULT_CAPACITY = 512
DEFAULT_NOISE = 1e-7


@under_own_settings
def make_learner(
    algo: str,
    env: str | None = None,
    *,
    policy: Mapping[str, Any] | None = None,
    human: Mapping[str, Any] | None = None,
    **options: Any,
) -> Learner:
    """A learner with the hyperparameters of the thesis for `env`, or for a task of one's own.

    Args:
        algo: "gpc", "gpc-ns" or "coach".
        env: "cartpole", "pendulum" or "lunarlander": sizes and values of Tables 5.1 to 5.3 and A.1. Without it,
            `obs_size` and `action_size` are needed, and the other values default to the lander's (Table 5.3), unscaled.
        policy, human: for GPC and GPC-NS, kernel values by name: `{"variance": c, "length_scale": l, "nu": nu}`
            (`nu` for the policy only).
        **options: `obs_size`, `action_size`, and
            for GPC and GPC-NS `capacity` (points in each dictionary, 512), `policy_capacity`, `human_capacity`,
            `scaling` (w, one factor for each observation dimension), `constant_rate`, `static_rate`, `noise`,
            `sparsify`, `on_full`;
            for COACH `lower`, `upper` and `counts` (the grid), `beta`, `magnitude`, `coach_constant`.

    Raises:
        ValueError: an unknown name, a missing size, or a value out of its range; the message names it.
    """
    if algo not in PRESETS:
        raise ValueError(f"algo {algo!r} is not known: choose one of {', '.join(PRESETS)}")
    if env is not None and env not in SIZES:
        raise ValueError(
            f"env {env!r} has no table: choose {', '.join(SIZES)}, or give obs_size and action_size"
        )
    values: dict[str, Any] = {}
    if env is not None:
        values |= {**SIZES[env], **PRESETS[algo][env]}
    elif algo != "coach":
        values |= {name: value for name, value in PRESETS[algo]["lunarlander"].items() if name != "scaling"}
    for prefix, kernel in (("policy", policy), ("human", human)):
        values |= {f"{prefix}_{name}": value for name, value in (kernel or {}).items()}
    values |= options
    missing = [name for name in ("obs_size", "action_size") if name not in values]
    if missing:
        raise ValueError(
            f"{' and '.join(missing)} missing: give sizes, or one of the envs {', '.join(SIZES)}"
        )
    for name in ("obs_size", "action_size"):
        values[name] = _size(name, values[name])
    return (
        _coach(**_known(values, _COACH))
        if algo == "coach"
        else _gpc(algo == "gpc-ns", **_known(values, _GPC))
    )


_SHARED = {"obs_size", "action_size"}
_COACH = _SHARED | {"lower", "upper", "counts", "beta", "magnitude", "coach_constant"}
_GPC = _SHARED | {
    *("policy_variance", "policy_length_scale", "policy_nu", "human_variance", "human_length_scale"),
    *("constant_rate", "static_rate", "noise", "scaling", "sparsify", "on_full"),
    *("capacity", "policy_capacity", "human_capacity"),
}


def _known(values: dict[str, Any], names: set[str]) -> dict[str, Any]:
    unknown = sorted(values.keys() - names)
    if unknown:
        raise ValueError(
            f"{unknown[0]!r} is not an option of this learner: choose from {', '.join(sorted(names))}"
        )
    return values


def _gpc(
    normalise: bool,
    *,
    obs_size: int,
    action_size: int,
    policy_variance: Any,
    policy_length_scale: Any,
    policy_nu: Any,
    human_variance: Any,
    human_length_scale: Any,
    constant_rate: Any,
    static_rate: Any = None,
    noise: Any = DEFAULT_NOISE,
    scaling: Any = None,
    sparsify: bool = True,
    on_full: str = "error",
    capacity: Any = DEFAULT_CAPACITY,
    policy_capacity: Any = None,
    human_capacity: Any = None,
) -> GPC:
    if on_full not in ON_FULL:
        raise ValueError(f"on_full {on_full!r} is not known: choose one of {', '.join(ON_FULL)}")
    if policy_nu not in (0.5, 1.5, 2.5):
        raise ValueError(f"policy_nu {policy_nu}: choose 0.5, 1.5 or 2.5")
    processes = {
        name: GaussianProcess(
            Kernel(
                variance=_number(f"{name}_variance", variance, positive=True),
                length_scale=_number(f"{name}_length_scale", length_scale, positive=True),
                smoothness=smoothness,
            ),
            noise=_number("noise", noise, positive=True),
            normalise=normalise,
            keeps_weights=name == "policy",
            replaces=name == "policy" or on_full == "replace-nearest",
        )
        for name, variance, length_scale, smoothness in (
            ("policy", policy_variance, policy_length_scale, float(policy_nu)),
            ("human", human_variance, human_length_scale, SQUARED_EXPONENTIAL),
        )
    }
    return GPC(
        policy=processes["policy"],
        human=processes["human"],
        scaling=_vector("scaling", (1.0,) * obs_size if scaling is None else scaling, obs_size),
        constant_rate=_number("constant_rate", constant_rate),
        static_rate=None if static_rate is None else _number("static_rate", static_rate),
        obs_size=obs_size,
        action_size=action_size,
        sparsify=bool(sparsify),
        on_full=on_full,
        policy_capacity=_size("policy_capacity", capacity if policy_capacity is None else policy_capacity),
        human_capacity=_size("human_capacity", capacity if human_capacity is None else human_capacity),
    )


def _coach(
    *,
    obs_size: int,
    action_size: int,
    lower: Any = None,
    upper: Any = None,
    counts: Any = None,
    beta: Any = 30.0,
    magnitude: Any = 5.0,
    coach_constant: Any = 1.8,
) -> COACH:
    if lower is None or upper is None or counts is None:
        raise ValueError(
            "COACH needs its grid: lower, upper and counts, one value for each observation dimension"
        )
    counts = tuple(_size("counts", count) for count in counts)
    lower, upper = _vector("lower", lower, obs_size), _vector("upper", upper, obs_size)
    if len(counts) != obs_size or min(counts) < 2:
        raise ValueError(f"counts {counts}: give {obs_size} numbers of at least 2")
    if not (np.asarray(lower) < np.asarray(upper)).all():
        raise ValueError(
            f"lower {np.asarray(lower).tolist()} must be below upper {np.asarray(upper).tolist()}"
        )
    return COACH(
        grid=Grid(lower=lower, upper=upper, counts=counts),
        beta=_vector("beta", beta, action_size, "positive"),
        magnitude=_vector("magnitude", magnitude, action_size, "positive"),
        constant=_vector("coach_constant", coach_constant, action_size, "non-negative"),
        obs_size=obs_size,
        action_size=action_size,
    )


def _number(name: str, value: Any, positive: bool = False) -> Any:
    number = _float(value)
    if not math.isfinite(number) or number < 0 or (positive and number == 0):
        raise ValueError(f"{name} {value!r}: give a {'positive' if positive else 'non-negative'} number")
    return jnp.asarray(number, float)


def _vector(name: str, value: Any, size: int, kind: str = "finite") -> Any:
    array = np.array([_float(each) for each in ([value] if np.ndim(value) == 0 else value)])
    array = np.full(size, array[0]) if np.ndim(value) == 0 else array
    inside = {"finite": array > -np.inf, "positive": array > 0, "non-negative": array >= 0}[kind]
    if array.shape != (size,) or not (np.isfinite(array) & inside).all():
        raise ValueError(f"{name} {value!r}: give one {kind} number, or {size} of them")
    return jnp.asarray(array)


def _float(value: Any) -> float:
    """Not a number where `value` is none."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _size(name: str, value: Any) -> int:
    if isinstance(value, bool | str) or not _float(value).is_integer() or value < 1:
        raise ValueError(f"{name} {value!r}: give a whole number of at least 1")
    return int(value)
