"""What a specification asks for as a box of values: is a cell in it, is another box within it? Loads no jax."""

import dataclasses
import functools
import operator
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from gpcjax.registry import find
from gpcjax.sweep.options import concerns, settings_of
from gpcjax.sweep.plan import Cell, joint_of, plan
from gpcjax.sweep.points import Point, names_of, values_of
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import SweepSpec


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


def given_settings(spec: SweepSpec) -> list[str]:
    """Those that a specification gives values of."""
    return [*spec.hyperparameters, *names_of(spec.points)]


class Box(NamedTuple):
    """What a specification asks for: every combination, for each learner, of values and points."""

    seeds: Seeds
    combinations: frozenset[tuple[str, str, float]]
    """Learner, oracle, error."""
    settings: dict[str, dict[str, frozenset[float | None]]]
    """Values by setting and learner."""
    joint: dict[str, frozenset[Point]]
    """Points by learner; the empty one for a learner whom they do not concern."""

    def holds(self, cell: Cell) -> bool:
        """Whether a cell is asked for, whatever its seed."""
        return (
            (cell.algo, cell.oracle, cell.error) in self.combinations
            and all(setting_of(cell, name) in values[cell.algo] for name, values in self.settings.items())
            and self._has_point(cell)
        )

    def _has_point(self, cell: Cell) -> bool:
        points = self.joint[cell.algo]
        names = [name for name, _ in next(iter(points))]
        return not names or tuple((name, setting_of(cell, name)) for name in names) in points

    def within(self, other: "Box") -> bool:
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


def uncovered(spec: SweepSpec, boxes: Sequence[Box]) -> int:
    """How many cells of a specification are in none of the boxes, whose settings have all of its names.

    Seeds are not gone through one by one: it takes as long as there are combinations of the rest.
    """

    @functools.cache
    def new_seeds(which: tuple[int, ...]) -> int:
        held = [boxes[place].seeds for place in which]
        both = functools.reduce(operator.or_, held, spec.seeds)
        return len(both) - len(functools.reduce(operator.or_, held)) if held else len(both)

    return sum(
        new_seeds(tuple(place for place, box in enumerate(boxes) if box.holds(cell)))
        for cell in _combinations(spec)
    )


def is_within(spec: SweepSpec, box: Box) -> bool:
    """Whether a box, whose settings have all names of a specification, has all of its cells."""
    return len(spec.seeds | box.seeds) == len(box.seeds) and all(map(box.holds, _combinations(spec)))


@functools.lru_cache(maxsize=1)
def _combinations(spec: SweepSpec) -> list[Cell]:
    """The cells of one seed: each request of a folder is held against them."""
    first, _ = spec.seeds.spans[0]
    return plan(dataclasses.replace(spec, seeds=Seeds(((first, first),))))


def box_of(spec: SweepSpec, names: Iterable[str]) -> Box:
    """The box of a specification, with the settings of these names beside `delta` and `rate`."""
    combinations = {
        (algo, oracle, error) for algo in spec.algo for oracle in spec.oracle for error in spec.error
    }
    settings = {
        name: {algo: frozenset(values_in(spec, algo, name)) for algo in spec.algo}
        for name in ("delta", "rate", *names)
    }
    joint = {algo: frozenset(joint_of(spec, algo)) for algo in spec.algo}
    return Box(spec.seeds, frozenset(combinations), settings, joint)


def values_in(spec: SweepSpec, algo: str, name: str) -> tuple[float | None, ...]:
    """Those of a setting for one learner."""
    if name in ("delta", "rate"):
        return getattr(spec, name)
    if concerns(name, find("learner", algo), find("teacher", spec.teacher)):
        given = spec.hyperparameters.get(name) or values_of(spec.points, name)
        if given:
            return given
    return (usual(spec.env, algo, spec.teacher, name),)
