"""The numeric hyperparameters that a sweep may vary, in one table. Standard library only: it loads no jax."""

from dataclasses import dataclass

from gpcjax.allowed import NON_NEGATIVE, POSITIVE, Allowed, Numbers, OneOf

ALGORITHMS = ("gpc", "gpc-ns", "coach")
ON_FULL = ("error", "replace-nearest", "drop")
CAPACITY = Numbers(1, 16384, whole=True)
"""Points for which a dictionary may have room from the start."""
_GP = ("gpc", "gpc-ns")
_COACH = ("coach",)
_SMOOTHNESS = OneOf((0.5, 1.5, 2.5))


@dataclass(frozen=True)
class Hyperparameter:
    """One row. `name` is the TOML key and, with dashes, the flag; where it is not given, the thesis' value holds."""

    name: str
    symbol: str
    algorithms: tuple[str, ...]
    allowed: Allowed
    text: str


HYPERPARAMETERS: dict[str, Hyperparameter] = {
    row.name: row
    for row in (
        Hyperparameter("policy_length_scale", "l_p", _GP, POSITIVE, "length-scale of the policy"),
        Hyperparameter("policy_variance", "c_p", _GP, POSITIVE, "signal variance of the policy"),
        Hyperparameter("policy_nu", "nu_p", _GP, _SMOOTHNESS, "smoothness of the policy's Matern kernel"),
        Hyperparameter("human_length_scale", "l_h", _GP, POSITIVE, "length-scale of the human model"),
        Hyperparameter("human_variance", "c_h", _GP, POSITIVE, "signal variance of the human model"),
        Hyperparameter("constant_rate", "c_r", _GP, NON_NEGATIVE, "constant part of the learning rate (3.5)"),
        Hyperparameter("static_rate", "r_c", _GP, POSITIVE, "learning rate that replaces the adaptive one"),
        Hyperparameter("noise", "sigma_n^2", _GP, POSITIVE, "noise variance on both diagonals"),
        Hyperparameter("active_gain", "c_a", _GP, NON_NEGATIVE, "gain of active learning (3.6), 0 is off"),
        Hyperparameter("beta", "beta", _COACH, POSITIVE, "learning rate of COACH's human model"),
        Hyperparameter("magnitude", "e", _COACH, POSITIVE, "error magnitude that COACH assumes"),
        Hyperparameter("coach_constant", "c_c", _COACH, NON_NEGATIVE, "constant part of COACH's rate (2.3)"),
    )
}
