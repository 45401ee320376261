"""What a learner that was kept was made with: its settings and variants, by its card and its arrays. Loads no jax."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gpcjax.allowed import converted, shown
from gpcjax.describe import LearnerSpec, TaskSpec
from gpcjax.errors import UserError
from gpcjax.lateness import CREDIT
from gpcjax.registry import find
from gpcjax.sweep.given import Given, Unchecked, said
from gpcjax.sweep.options import OPTIONS
from gpcjax.sweep.scales import SCALES

Arrays = Mapping[str, np.ndarray]

_FIELDS = {
    "policy_variance": "policy.kernel.variance",
    "policy_length_scale": "policy.kernel.length_scale",
    "human_variance": "human.kernel.variance",
    "human_length_scale": "human.kernel.length_scale",
    "noise": "policy.noise",
    "human_noise": "human.noise",
    "coach_constant": "constant",
}
"""Where a built-in learner has a setting, if not in a field of its name."""

_NORMALISED = {"scaling": "policy.scaling", "human_scaling": "human.scaling"}
"""Where one has its scales that normalises."""

_NOISE = 1e-7
"""`gpcjax.learners.factory.DEFAULT_NOISE`, which would load jax."""


def made_with(
    place: str,
    spec: LearnerSpec,
    env: str,
    card: Mapping[str, Any],
    arrays: Arrays,
    credit: Mapping[str, Any],
) -> dict[str, Any]:
    """The settings and variants (`gpcjax.teach.course.VARIANTS`) that are others than a learner has on a task anyway.

    Args:
        place: begins messages.
        spec: of the learner.
        env: the task.
        card, arrays: of the learner, as `gpcjax.learners.packed` packs it.
        credit: how it reckoned with late advice, of which these say nothing.

    Raises:
        UserError: it has a setting of each action dimension, which no lesson has, or one that is no number.
    """
    task = find("task", env)
    own = {each.name: each.default for each in spec.settings if each.default is not None}
    usual = {"noise": _NOISE, **own, **spec.defaults, **task.presets.get(spec.name, {})}
    usual["human_noise"] = arrays.get("learner.policy.noise")
    # One that is NaN was not given.
    arrays = {
        name: array
        for name, array in arrays.items()
        if name != "learner.static_rate" or np.all(array == array)
    }
    if "learner.static_rate" in arrays:
        usual["constant_rate"] = arrays.get("learner.constant_rate")  # beside it, that one changes nothing
    told = {**card, **table(card, "recipe", "settings")}
    settings: dict[str, Any] = {}
    kinds = {each.name: each.kind for each in spec.settings} | dict.fromkeys(CREDIT, float)
    for name, kind in kinds.items():
        held = credit.get(name) if name in CREDIT else told.get(name)
        value = _number(
            f"{place}: its {name}",
            kind,
            arrays.get(f"learner.{_FIELDS.get(name, name)}", held),
            usual.get(name),
        )
        if value is not None:
            settings[name] = value
    if spec.dictionary and told.get("sparsify") is False:
        settings["sparsify"] = False
    return settings | _scales(spec, task, told, arrays)


def as_given(place: str, settings: Mapping[str, Any]) -> dict[str, Given | Unchecked]:
    """The same as settings that a person gives; `place` is where."""
    given: dict[str, Given | Unchecked] = {}
    for name, value in settings.items():
        plain = Unchecked(value, f"{place}: {name}", name)
        given[name] = said(plain, OPTIONS[name]) if name in OPTIONS else plain
    return given


def table(card: Mapping[str, Any], *names: str) -> Mapping[str, Any]:
    """A table within a table of a card; nothing where there is none."""
    found: Any = card
    for name in names:
        found = found.get(name) if isinstance(found, Mapping) else None
    return found if isinstance(found, Mapping) else {}


def _number(source: str, kind: type, value: Any, usual: Any) -> float | None:
    """What a setting was; None where nothing says it, or it is the usual one. Raises UserError."""
    if value is None or isinstance(value, str | bool):
        return None
    if isinstance(value, np.ndarray) and value.size:
        if not np.issubdtype(value.dtype, np.number):
            return None
        if usual is not None and np.all(np.equal(value, usual)):
            return None
        values = np.unique(value)
        if len(values) != 1:
            raise UserError(
                f"{source} is another one in each action dimension, and a lesson has one for all: give another folder"
            )
        value = values[0]
    number = converted(float, value)
    if number is None or (kind is int and not number.is_integer()):
        raise UserError(f"{source} {shown(value)} is no number: what was kept there is damaged")
    return None if usual is not None and np.all(np.equal(number, usual)) else kind(number)


def _scales(spec: LearnerSpec, task: TaskSpec, told: Mapping[str, Any], arrays: Arrays) -> dict[str, Any]:
    """Those of `SCALES` that are others than a learner has on a task anyway."""
    fields = _NORMALISED if spec.normalises else {}
    held = {
        name: arrays.get(f"learner.{fields.get(name, name)}", told.get(name))
        for name in SCALES
        if name in spec.options
    }
    scales = {name: tuple(np.ravel(value).tolist()) for name, value in held.items() if value is not None}
    usual = dict(task.presets.get(spec.name, {}))
    if not spec.normalises and spec.name not in task.presets and task.obs_scale is not None:
        usual["scaling"] = [1.0 / scale for scale in task.obs_scale]
    if not spec.normalises:
        usual.setdefault("scaling", 1.0)
    elif "scaling" in scales:
        usual.setdefault("human_scaling", (*scales["scaling"], 1.0))
    return {
        name: value
        for name, value in scales.items()
        if name not in usual or not _is_same(value, np.ravel(usual[name]))
    }


def _is_same(scale: tuple[float, ...], usual: np.ndarray) -> bool:
    return len(usual) in (1, len(scale)) and bool((np.array(scale) == usual).all())
