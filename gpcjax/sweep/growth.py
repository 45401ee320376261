"""A run folder that grows: more seeds, errors, learners or grid points asked of it later. Loads no jax.

A folder that was asked more than once lists in its manifest all that it was `asked` for; `specification` is then their
union, each list with all values, and `varying` what has several there. What is there to run is what was asked: not
every combination of the union.

What had one value in an earlier request has no column in the parts that were written then. Its value was the one that
was given, or the learner's usual one: the manifest keeps it as `filled`, so that nobody has to know the learners to
read the rows.
"""

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.labels import LABELS, labels_of
from gpcjax.sweep.layout import GIVE_NEW, GROWN, UNSEALED
from gpcjax.sweep.options import concerns, settings_of
from gpcjax.sweep.plan import Cell, canonical, hash_of, joint_of, plan, varying
from gpcjax.sweep.points import POINTS, Point, names_of, values_of
from gpcjax.sweep.seeds import MOST, Seeds
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import SweepSpec, as_dict, from_dict

LISTS = ("algo", "oracle", "error", "delta", "rate")
"""What may get more values, beside `seeds`, `hyperparameters` and `points`."""

Filled = Mapping[str, Mapping[str, float | None]]
"""Setting -> learner -> the value of its cells; None where it does not concern the learner."""


def requests(manifest: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Each specification that was asked of the folder, the first one first: `hash`, `specification`, `filled`."""
    alone = {"hash": manifest["hash"], "specification": manifest["specification"], "filled": {}}
    return manifest.get("asked") or [alone]


def hashes(manifest: Mapping[str, Any]) -> dict[str, Filled]:
    """The specifications whose parts are rows of this folder: what their missing columns hold, by their hash."""
    return {each["hash"]: each["filled"] for each in requests(manifest)}


def contradictions(held: Mapping[str, Any], asked: Mapping[str, Any]) -> list[str]:
    """What of a specification cannot be added to the one that a folder holds, as "episodes 30, not 40"."""
    grow = (*LISTS, "seeds", "hyperparameters", POINTS)
    fixed = [name for name in {**asked, **held} if name not in grow]
    return [
        f"{name} {_shown(held.get(name))}, not {_shown(asked.get(name))}"
        for name in fixed
        if canonical(held.get(name)) != canonical(asked.get(name))
    ]


def covering(manifest: Mapping[str, Any], spec: SweepSpec) -> str | None:
    """The hash of a request that asked for all of `spec` already; None if there is none."""
    for each in requests(manifest):
        held = from_dict(each["specification"])
        if contradictions(each["specification"], as_dict(spec)):
            continue
        names = dict.fromkeys([*_settings(held), *_settings(spec)])
        box = _box(held, names)
        # Points are not every combination, so they are looked at one by one.
        if all(map(box.holds, plan(spec))) if held.points or spec.points else _box(spec, names).within(box):
            return each["hash"]
    return None


def grown(manifest: Mapping[str, Any], spec: SweepSpec) -> dict[str, Any]:
    """The manifest of a folder that is asked for `spec` too: one that contradicts nothing, and is not covered.

    Raises:
        UserError: a setting has several values now, and what it was before is no number; or too many seeds.
    """
    specs = [from_dict(each["specification"]) for each in requests(manifest)]
    union = _united([*specs, spec])
    names = varying(union)
    asked = [
        {"hash": hash_of(as_dict(one)), "specification": as_dict(one), "filled": _filled(one, names)}
        for one in (*specs, spec)
    ]
    held = [_box(one, names) for one in specs]
    new = sum(not any(box.holds(cell) for box in held) for cell in plan(spec))
    return {
        **manifest,
        **({"unsealed": True} if manifest["format"] == UNSEALED else {}),
        "format": GROWN,
        "hash": hash_of(as_dict(union)),
        "specification": as_dict(union),
        **labels_of(spec, manifest.get(LABELS)),
        "varying": names,
        "asked": asked,
        "cells": manifest["cells"] + new,
        "complete": False,
    }


def check(out: Path, manifest: Mapping[str, Any], spec: SweepSpec) -> None:
    """Refuse a specification that a folder cannot be asked for.

    Raises:
        UserError: it contradicts what the folder holds, or its rows could not be told from those that are there.
    """
    if covering(manifest, spec) is not None:
        return
    differences = contradictions(manifest["specification"], as_dict(spec))
    if differences:
        more = f" and {len(differences) - 3} more" if len(differences) > 3 else ""
        raise UserError(
            f"{out}: it holds another specification ({', '.join(differences[:3])}{more}): a folder grows by seeds, "
            f"learners, oracles, errors and hyperparameters alone, {GIVE_NEW}"
        )
    _united([*(from_dict(each["specification"]) for each in requests(manifest)), spec])


def setting_of(cell: Cell, name: str) -> float | None:
    """The value of a varying setting of a cell, given or usual; None where it does not concern its learner."""
    if name in ("delta", "rate"):
        return getattr(cell, name)
    for given, value in cell.hyperparameters:
        if given == name:
            return value
    return usual(cell.env, cell.algo, cell.teacher, name)


@functools.lru_cache(maxsize=4096)
def usual(env: str, algo: str, teacher: str, name: str) -> float | None:
    """The value of a hyperparameter that nobody gave, by the task's presets; None where there is none."""
    learner, theirs = find("learner", algo), find("teacher", teacher)
    if not concerns(name, learner, theirs):
        return None
    declared, *_ = settings_of([learner], [theirs])[name]
    value = {**learner.defaults, **find("task", env).presets.get(algo, {})}.get(name, declared.default)
    known = isinstance(value, int | float) and not isinstance(value, bool) and declared.compiled != "given"
    return float(value) if known else None


def _settings(spec: SweepSpec) -> list[str]:
    """Those that a specification gives values of."""
    return [*spec.hyperparameters, *names_of(spec.points)]


class _Box(NamedTuple):
    """What a specification asks for: every combination, for each learner, of values and points."""

    seeds: Seeds
    combinations: frozenset[tuple[str, str, float]]
    """Learner, oracle, error."""
    settings: dict[str, dict[str, frozenset[float | None]]]
    """Values by setting and learner."""
    joint: dict[str, frozenset[Point]]
    """Points by learner; the empty one for a learner whom they do not concern."""

    def holds(self, cell: Cell) -> bool:
        return (
            cell.seed in self.seeds
            and (cell.algo, cell.oracle, cell.error) in self.combinations
            and all(setting_of(cell, name) in values[cell.algo] for name, values in self.settings.items())
            and self._has_point(cell)
        )

    def _has_point(self, cell: Cell) -> bool:
        points = self.joint[cell.algo]
        names = [name for name, _ in next(iter(points))]
        return not names or tuple((name, setting_of(cell, name)) for name in names) in points

    def within(self, other: "_Box") -> bool:
        """Whether `other`, which has the same settings, asks for all of it; neither has points."""
        algos = {algo for algo, *_ in self.combinations}
        return (
            len(self.seeds | other.seeds) == len(other.seeds)
            and self.combinations <= other.combinations
            and all(
                values[algo] <= other.settings[name][algo]
                for name, values in self.settings.items()
                for algo in algos
            )
        )


def _box(spec: SweepSpec, names: Iterable[str]) -> _Box:
    combinations = {
        (algo, oracle, error) for algo in spec.algo for oracle in spec.oracle for error in spec.error
    }
    settings = {
        name: {algo: frozenset(_values(spec, algo, name)) for algo in spec.algo}
        for name in ("delta", "rate", *names)
    }
    joint = {algo: frozenset(joint_of(spec, algo)) for algo in spec.algo}
    return _Box(spec.seeds, frozenset(combinations), settings, joint)


def _values(spec: SweepSpec, algo: str, name: str) -> tuple[float | None, ...]:
    """Those of a setting for one learner."""
    if name in ("delta", "rate"):
        return getattr(spec, name)
    if concerns(name, find("learner", algo), find("teacher", spec.teacher)):
        given = spec.hyperparameters.get(name) or values_of(spec.points, name)
        if given:
            return given
    return (usual(spec.env, algo, spec.teacher, name),)


def _united(specs: Sequence[SweepSpec]) -> SweepSpec:
    """One specification with all the values of several that differ in nothing else, points among them."""

    def all_of(each: Iterable[Iterable[Any]]) -> tuple[Any, ...]:
        return tuple(dict.fromkeys(value for values in each for value in values if value is not None))

    names = dict.fromkeys(name for spec in specs for name in _settings(spec))
    for name in names:
        _refuse_unknown(name, specs)
    seeds = functools.reduce(lambda one, other: one | other, (spec.seeds for spec in specs))
    if len(seeds) > MOST:
        raise UserError(f"{len(seeds):,} seeds in all: a folder has {MOST:,} at most, give a new one (--out)")
    return dataclasses.replace(
        specs[0],
        **{name: all_of(getattr(spec, name) for spec in specs) for name in LISTS},
        seeds=seeds,
        hyperparameters={
            name: all_of(_values(spec, algo, name) for spec in specs for algo in spec.algo) for name in names
        },
        points=(),
    )


def _refuse_unknown(name: str, specs: Sequence[SweepSpec]) -> None:
    """Refuse to tell cells apart by a setting whose value nobody knows where it was not given."""
    for spec in specs:
        teacher = find("teacher", spec.teacher)
        for algo in spec.algo:
            concerned = concerns(name, find("learner", algo), teacher)
            if concerned and name not in _settings(spec) and None in _values(spec, algo, name):
                raise UserError(
                    f"{name} was not given to {algo} in one of the two: what it is then is no number that its rows "
                    "could be told apart by, give a new folder (--out)"
                )


def _filled(spec: SweepSpec, names: Iterable[str]) -> dict[str, dict[str, float | None]]:
    """The settings of `names` that have one value in a specification."""
    each = {name: {algo: _values(spec, algo, name) for algo in spec.algo} for name in names}
    return {
        name: {algo: values[0] for algo, values in by_learner.items()}
        for name, by_learner in each.items()
        if all(len(values) == 1 for values in by_learner.values())
    }


def _shown(value: object) -> str:
    if isinstance(value, Mapping):
        value = Source(**value).label
    return "as usual" if value is None or value == [] else shown(value)
