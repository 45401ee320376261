"""How tasks and learners that are not built in are called in reports: a manifest says it. Loads no jax.

A report runs nobody's module, and a folder may be reported on where that is not. So a sweep writes down what the
descriptions say, in an entry of its manifest that is there if it says something:

    {"task": {"mytask:DRIFT": {"label": "Drift", "unit": "reward"}}, "learner": {"mine:LINEAR": {"label": "Linear"}}}
"""

from collections.abc import Mapping
from typing import Any

from gpcjax.describe import LearnerSpec, TaskSpec
from gpcjax.envs.brax_tasks import KNOWN
from gpcjax.registry import Kind, built_in, find, found
from gpcjax.sweep.spec import SweepSpec

LABELS = "labels"
"""The entry of a manifest."""

_FIELDS: Mapping[Kind, tuple[str, ...]] = {"task": ("label", "unit", "actions"), "learner": ("label",)}

_TOLD: dict[tuple[str, str], TaskSpec | LearnerSpec] = {}
"""What the manifests that were reported on in this process say."""


def labels_of(spec: SweepSpec, before: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The entry for a sweep, by its name, beside what was there `before`; nothing where there is nothing to say."""
    labels = {kind: dict(told) for kind, told in (before or {}).items()}
    asked: Mapping[Kind, tuple[str, ...]] = {"task": (spec.env,), "learner": spec.algo}
    for kind, names in asked.items():
        for name in (name for name in names if name not in built_in(kind)):
            said = {field: getattr(find(kind, name), field) for field in _FIELDS[kind]}
            said = {
                field: list(value) if field == "actions" else value for field, value in said.items() if value
            }
            if said:
                labels.setdefault(kind, {})[name] = said
    return {LABELS: labels} if labels else {}


def remember(manifest: Mapping[str, Any]) -> None:
    """Takes down what a manifest says, for `known`; what it does not say as it should is left out."""
    labels = _table(manifest.get(LABELS))
    for name, said in _table(labels.get("learner")).items():
        _TOLD["learner", name] = LearnerSpec(name, "", label=str(_table(said).get("label", "")))
    for name, said in _table(labels.get("task")).items():
        label, unit = (str(_table(said).get(field, "")) for field in ("label", "unit"))
        actions = _table(said).get("actions")
        dimensions = tuple(map(str, actions)) if isinstance(actions, list) else ()
        _TOLD["task", name] = TaskSpec(name, "", label=label, unit=unit, actions=dimensions)


def _table(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def known(kind: Kind, name: str) -> Any:
    """The description of a name, with its label at least; None where none is known, or a module would be run for it."""
    if name in built_in(kind):
        return find(kind, name)
    told = _TOLD.get((kind, name)) or found(kind, name)
    prefix, _, own = name.partition(":")
    if told is None and kind == "task" and prefix == "brax" and (task := KNOWN.get(own)):
        return TaskSpec(name, "", label=task.label, unit=task.unit, actions=task.actions)
    return told
