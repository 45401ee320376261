"""Learners by name: the thesis' tables, or the sizes and hyperparameters of a task of one's own."""

import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import (
    COUNT,
    FINITE,
    POSITIVE,
    SWITCH,
    Numbers,
    OneOf,
    checked,
    checked_series,
    entries,
    shown,
    suggestion,
)
from gpcjax.describe import LearnerSpec, TaskSpec
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.gp.appending import Appending
from gpcjax.gp.kernels import SQUARED_EXPONENTIAL, Kernel
from gpcjax.gp.process import GaussianProcess
from gpcjax.gp.renormalised import Renormalised
from gpcjax.gp.replacing import Replacing
from gpcjax.learners.base import Learner
from gpcjax.learners.coach import COACH
from gpcjax.learners.descriptions import CAPACITY, ON_FULL
from gpcjax.learners.descriptions import COACH as COACH_SPEC
from gpcjax.learners.descriptions import GPC as GPC_SPEC
from gpcjax.learners.foreign import arguments, check_sizes, checked_settings
from gpcjax.learners.gpc import GPC
from gpcjax.policies.grid import Grid
from gpcjax.registry import built_in, find, resolve

ALLOWED = {setting.name: setting.allowed for spec in (GPC_SPEC, COACH_SPEC) for setting in spec.settings}
"""Values of the built-in learners' settings."""

DEFAULT_CAPACITY = 512
DEFAULT_NOISE = 1e-7


@under_own_settings
def make_learner(
    algo: Any,
    env: Any = None,
    *,
    policy: Any = None,
    human: Any = None,
    **options: Any,
) -> Learner:
    """A learner with the hyperparameters of the thesis for `env`, or for a task of one's own.

    GPC and GPC-NS are Alg. 2 with SPARS (Alg. 3) of the thesis, COACH is its Alg. 1, D-COACH arXiv:1810.00466.

    Args:
        algo: "gpc", "gpc-ns", "coach" or "d-coach", one that an installed package registers, or `module:NAME`.
        env: a task's name, as `make_env` takes it: its sizes, and its presets (Tables 5.1 to 5.3 and A.1 for
            "cartpole", "pendulum" and "lunarlander"). Without it, `obs_size` and `action_size` are needed. Where there
            is no preset, GPC and GPC-NS have the lander's kernels (Table 5.3), unscaled.
        policy, human: for GPC and GPC-NS, kernel values by name: `{"variance": c, "length_scale": l, "nu": nu}`
            (`nu` for the policy only).
        **options: `obs_size`, `action_size`, and
            for GPC and GPC-NS `capacity` (points in each dictionary, 512), `policy_capacity`, `human_capacity`,
            `scaling` (w, one factor for each observation dimension; GPC-NS multiplies by it what it has normalised),
            `human_scaling` (that of the human model, for observation and action), `constant_rate`, `static_rate`,
            `noise`, `human_noise`, `sparsify`, `on_full`;
            for COACH `lower`, `upper` and `counts` (the grid), `beta`, `magnitude`, `coach_constant`;
            for D-COACH `learning_rate`, `magnitude`, `buffer_size`, `batch_size`, `replay_every`, `width`, `scaling`;
            for a learner of one's own, its settings.

    All values are bounded as on the command line (`gpcjax.learners.descriptions`); numpy's numbers are numbers.

    Raises:
        ValueError: an unknown name, a missing size, or a value out of its range; the message names it.
    """
    spec: LearnerSpec = find("learner", algo)
    task: TaskSpec | None = None if env is None else find("task", env)
    given = {**_kernel_options("policy", policy), **_kernel_options("human", human)}
    twice = sorted(given.keys() & options.keys())
    if twice:
        raise UserError(f"{twice[0]} is given twice, by its kernel's name and by its own: give it once")
    given |= options
    if given.get("static_rate") is not None and given.get("constant_rate") is not None:
        raise UserError("constant_rate: beside static_rate it changes nothing, give one of the two")
    values = dict(spec.defaults)
    if task is not None:
        values |= {**sizes_of(task), **_scaling(spec, task), **task.presets.get(spec.name, {})}
    values |= given
    missing = [name for name in ("obs_size", "action_size") if name not in values]
    if missing:
        raise UserError(
            f"{' and '.join(missing)} missing: give sizes, or a task's name, one of {', '.join(built_in('task'))}"
        )
    own = algo not in built_in("learner")
    names = {"obs_size", "action_size", *(each.name for each in spec.settings), *spec.options}
    values = _known(values, names | set(arguments(spec) if own else ()))
    for name in ("obs_size", "action_size"):
        values[name] = checked(name, values[name], int, COUNT)
    if own:
        values = checked_settings(spec, values)
    made = resolve(spec.make)(**values)
    if not own:
        return made
    check_sizes(algo, made, values)
    return fixed(made)


def sizes_of(task: TaskSpec) -> dict[str, int]:
    """Those of a task's observations and actions, by name."""
    if task.sizes is None:
        env = resolve(task.make)()
        return {"obs_size": env.obs_size, "action_size": env.action_size}
    return dict(zip(("obs_size", "action_size"), task.sizes, strict=True))


def _scaling(spec: LearnerSpec, task: TaskSpec) -> dict[str, Any]:
    """W of a learner that scales its observations, for a task that has no preset and says how large they are."""
    if (
        "scaling" not in spec.options
        or spec.normalises
        or task.obs_scale is None
        or spec.name in task.presets
    ):
        return {}
    return {"scaling": tuple(1.0 / scale for scale in task.obs_scale)}


def _known(values: dict[str, Any], names: set[str]) -> dict[str, Any]:
    unknown = sorted(values.keys() - names)
    if unknown:
        near = suggestion(unknown[0], names)
        raise UserError(
            f"{shown(unknown[0])} is not an option of this learner{near}: choose from {', '.join(sorted(names))}"
        )
    return values


def _kernel_options(process: str, kernel: Any) -> dict[str, Any]:
    """The values of a kernel as options of the learner."""
    if kernel is None:
        return {}
    if not isinstance(kernel, Mapping) or not all(isinstance(name, str) for name in kernel):
        raise UserError(
            f"{process} {shown(kernel)}: give values by name, such as {{'variance': 0.01, 'length_scale': 0.2}}"
        )
    return {f"{process}_{name}": value for name, value in kernel.items()}


def make_gpc(**values: Any) -> GPC:
    """GPC: see `make_learner`."""
    return _gpc(False, **values)


def make_gpc_ns(**values: Any) -> GPC:
    """GPC-NS: see `make_learner`."""
    return _gpc(True, **values)


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
    human_noise: Any = None,
    scaling: Any = None,
    human_scaling: Any = None,
    sparsify: Any = True,
    on_full: Any = "error",
    capacity: Any = DEFAULT_CAPACITY,
    policy_capacity: Any = None,
    human_capacity: Any = None,
) -> GPC:
    on_full = checked("on_full", on_full, str, OneOf(ON_FULL))
    policy_capacity, human_capacity = (
        checked(name, capacity if value is None else value, int, CAPACITY)
        for name, value in (("policy_capacity", policy_capacity), ("human_capacity", human_capacity))
    )
    static = math.nan if static_rate is None else checked("static_rate", static_rate, float, POSITIVE)
    noises = _number("noise", noise), _number("human_noise", noise if human_noise is None else human_noise)
    policy = Kernel(
        variance=_number("policy_variance", policy_variance),
        length_scale=_number("policy_length_scale", policy_length_scale),
        smoothness=checked("policy_nu", policy_nu, float, ALLOWED["policy_nu"]),
    )
    human = Kernel(
        variance=_number("human_variance", human_variance),
        length_scale=_number("human_length_scale", human_length_scale),
        smoothness=SQUARED_EXPONENTIAL,
    )
    weights = None if scaling is None else _vector("scaling", scaling, obs_size)
    pair = None if human_scaling is None else _vector("human_scaling", human_scaling, obs_size + 1)
    if normalise:
        processes = _normalised(policy, human, noises, weights, pair)
    else:
        processes = Replacing(policy, noises[0]), _human_model(on_full, human, noises[1])
    return GPC(
        policy=processes[0],
        human=processes[1],
        scaling=jnp.ones(obs_size) if weights is None else weights,
        constant_rate=_number("constant_rate", constant_rate),
        static_rate=jnp.asarray(static, float),
        obs_size=obs_size,
        action_size=action_size,
        sparsify=checked("sparsify", sparsify, bool, SWITCH),
        on_full=on_full,
        policy_capacity=policy_capacity,
        human_capacity=human_capacity,
        human_scaling=None if normalise else pair,
    )


def _normalised(
    policy: Kernel, human: Kernel, noises: tuple[Array, Array], weights: Array | None, pair: Array | None
) -> tuple[GaussianProcess, GaussianProcess]:
    """P and H of GPC-NS; as in GPC, w is that of H too, and the action's factor 1, where H has none of its own."""
    if pair is None and weights is not None:
        pair = jnp.append(weights, 1.0)
    return (
        Renormalised(policy, noises[0], scaling=weights),
        Renormalised(human, noises[1], keeps_weights=False, scaling=pair),
    )


def _human_model(on_full: str, kernel: Kernel, noise: Array) -> GaussianProcess:
    """H of GPC, of which only the uncertainty is wanted; it replaces points only where a full one is to."""
    if on_full == "replace-nearest":
        return Replacing(kernel, noise, keeps_weights=False)
    return Appending(kernel, noise)


def make_coach(
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
    """COACH: see `make_learner`. It has no default grid, as it must know where the observations lie."""
    bounds = ("lower", lower), ("upper", upper)
    if lower is None or upper is None or counts is None:
        raise UserError(
            "COACH needs its grid: lower, upper and counts, one value for each observation dimension"
        )
    given = entries("counts", counts, obs_size + 1)
    if given is None or len(given) != obs_size:
        raise UserError(f"counts {shown(counts)}: give {obs_size} numbers of at least 2")
    counts = tuple(checked("counts", count, int, _NODES) for count in given)
    if math.prod(counts) * action_size > _LARGEST_GRID:
        raise UserError(
            f"counts {shown(counts)}: {math.prod(counts):,} features for each of {action_size} actions, "
            f"give {_LARGEST_GRID:,} in all at most"
        )
    low, high = (checked_series(name, value, obs_size, FINITE) for name, value in bounds)
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise UserError(f"lower {shown(list(low))} must be below upper {shown(list(high))}")
    return COACH(
        grid=Grid(lower=jnp.asarray(low), upper=jnp.asarray(high), counts=counts),
        beta=_vector("beta", beta, action_size),
        magnitude=_vector("magnitude", magnitude, action_size),
        constant=_vector("coach_constant", coach_constant, action_size),
        obs_size=obs_size,
        action_size=action_size,
    )


_NODES = Numbers(2, COUNT.high, whole=True)
"""Nodes of COACH's grid along one dimension."""
_LARGEST_GRID = 2**26
"""Weights of COACH in each of its two models: half a gigabyte."""


def _number(name: str, value: Any) -> Array:
    """A hyperparameter of the table."""
    return jnp.asarray(checked(name, value, float, ALLOWED[name]), float)


def _vector(name: str, value: Any, size: int) -> Array:
    """One hyperparameter for each of `size` dimensions; a scale, which is in no table, is above 0."""
    allowed = ALLOWED.get(name, POSITIVE)
    assert isinstance(allowed, Numbers)
    return jnp.asarray(checked_series(name, value, size, allowed), float)
