"""From a specification to its cells, each a single run with one seed. Loads no jax."""

import functools
import hashlib
import itertools
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.errors import UserError
from gpcjax.registry import built_in, find
from gpcjax.sweep.options import LARGEST, OPTIONS, concerns, settings_of
from gpcjax.sweep.points import Point, cut, names_of, values_of
from gpcjax.sweep.scales import SCALES
from gpcjax.sweep.source import FIELDS as SOURCE
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import ORACLE, SweepSpec, as_dict


@dataclass(frozen=True)
class Cell:
    """One run: what its rows depend on, and nothing else."""

    env: str
    algo: str
    oracle: str
    error: float
    delta: float
    rate: float
    rate_schedule: tuple[float, ...]
    seed: int
    episodes: int
    hyperparameters: tuple[tuple[str, float], ...]
    """Names and values, of those given only the ones that concern `algo`."""
    sparsify: bool
    on_full: str
    max_capacity: int
    teacher: str = ORACLE
    start: Source | None = None
    scaling: tuple[float, ...] = ()
    human_scaling: tuple[float, ...] = ()


class Program(NamedTuple):
    """What the cells of one pool have in common: everything that is compiled in."""

    env: str
    algo: str
    oracle: str
    episodes: int
    sparsify: bool
    on_full: str
    max_capacity: int
    scheduled: bool
    """Whether a teacher of a person's own has a schedule: the built-in ones always have one."""
    teacher: str
    compiled: tuple[tuple[str, float | bool | None], ...]
    """What of the settings is compiled in, by name."""
    scaled: tuple[bool, ...] = (False,) * len(SCALES)
    """Which scalings are given: whether they are arrays of the program."""


def program_of(cell: Cell) -> Program:
    """The program that runs `cell`: cells that differ in numbers alone share one."""
    return Program(
        env=cell.env,
        algo=cell.algo,
        oracle=cell.oracle,
        episodes=cell.episodes,
        sparsify=cell.sparsify,
        on_full=cell.on_full,
        max_capacity=cell.max_capacity,
        scheduled=bool(cell.rate_schedule) and cell.teacher not in built_in("teacher"),
        teacher=cell.teacher,
        compiled=_compiled_in(cell.algo, cell.teacher, cell.hyperparameters),
        scaled=tuple(bool(getattr(cell, name)) for name in SCALES),
    )


@functools.lru_cache(maxsize=4096)
def _compiled_in(
    algo: str, teacher: str, given: tuple[tuple[str, float], ...]
) -> tuple[tuple[str, float | bool | None], ...]:
    values = dict(given)
    settings = settings_of([find("learner", algo)], [find("teacher", teacher)])
    return tuple(
        (name, each.in_program(values.get(name)))
        for name, (each, *_) in settings.items()
        if each.compiled != "no"
    )


def plan(spec: SweepSpec) -> list[Cell]:
    """All cells, each once, ordered by algo, oracle, hyperparameters, error, delta, rate, seed.

    Raises:
        UserError: there are more than a million.
    """
    count(spec)
    teacher = find("teacher", spec.teacher)
    scales = {
        algo: {name: getattr(spec, name) for name in SCALES if concerns(name, find("learner", algo), teacher)}
        for algo in spec.algo
    }
    return [
        Cell(
            env=spec.env,
            algo=algo,
            oracle=oracle,
            error=error,
            delta=delta,
            rate=rate,
            rate_schedule=spec.rate_schedule,
            seed=seed,
            episodes=spec.episodes,
            hyperparameters=point,
            sparsify=spec.sparsify,
            on_full=spec.on_full,
            max_capacity=spec.max_capacity,
            teacher=spec.teacher,
            start=spec.start,
            **scales[algo],
        )
        for algo in spec.algo
        for oracle, point, error, delta, rate, seed in itertools.product(
            spec.oracle, _points(spec, algo), spec.error, spec.delta, spec.rate, spec.seeds
        )
    ]


def count(spec: SweepSpec) -> int:
    """How many cells `plan` makes.

    Raises:
        UserError: more than a million.
    """
    each = len(spec.seeds) * len(spec.oracle) * len(spec.error) * len(spec.delta) * len(spec.rate)
    points = {algo: math.prod(map(len, axes_of(spec, algo).values())) for algo in spec.algo}
    cells = sum(each * number * len(joint_of(spec, algo)) for algo, number in points.items())
    if cells > LARGEST:
        raise UserError(f"{cells:,} cells: give fewer seeds or values, {LARGEST:,} cells are allowed")
    return cells


def varying(spec: SweepSpec) -> list[str]:
    """The columns that tell cells apart beside algo, oracle, error and seed: settings with more than one value."""
    joint = {name: values_of(spec.points, name) for name in names_of(spec.points)}
    axes = {"delta": spec.delta, "rate": spec.rate, **spec.hyperparameters, **joint}
    return [name for name, values in axes.items() if len(values) > 1]


def specification_hash(spec: SweepSpec) -> str:
    """Twelve hex digits that specifications share if they differ in the order of their lists alone."""
    return hash_of(as_dict(spec))


def hash_of(specification: Mapping[str, Any]) -> str:
    """The same of a specification as JSON has it, as a manifest holds it."""
    text = json.dumps(canonical(specification), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def default_out(spec: SweepSpec) -> Path:
    """Where a sweep goes if nobody says."""
    return Path("runs", f"{re.sub(r'[^A-Za-z0-9_.-]+', '-', spec.env)}-{specification_hash(spec)}")


def canonical(value: object) -> object:
    """JSON values with their lists sorted and without repeats, but for a series, whose order is its meaning.

    Of what runs begin with, its digest alone: it may be moved.
    """
    if isinstance(value, Mapping) and set(value) == SOURCE:
        return value["digest"]
    if isinstance(value, Mapping):
        return {
            name: inner if name in OPTIONS and OPTIONS[name].series else canonical(inner)
            for name, inner in value.items()
        }
    return sorted(set(map(_text, value))) if isinstance(value, list) else value


def _text(item: object) -> str:
    """As JSON has it; of numbers, of which a folder that grew has thousands, in a fifth of the time."""
    if type(item) is float and math.isfinite(item):
        return repr(item)
    return json.dumps(item, sort_keys=True)


def joint_of(spec: SweepSpec, algo: str) -> tuple[Point, ...]:
    """The points of a specification as far as they concern a learner; an empty one where it has none."""
    learner, teacher = find("learner", algo), find("teacher", spec.teacher)
    names = frozenset(name for name in names_of(spec.points) if concerns(name, learner, teacher))
    return cut(spec.points, names)


def axes_of(spec: SweepSpec, algo: str) -> dict[str, tuple[float, ...]]:
    """The hyperparameters of a specification that concern a learner, by name, each with all its values."""
    learner, teacher = find("learner", algo), find("teacher", spec.teacher)
    named = spec.hyperparameters.items()
    return {name: values for name, values in named if concerns(name, learner, teacher)}


def _points(spec: SweepSpec, algo: str) -> list[Point]:
    axes = axes_of(spec, algo)
    return [
        (*zip(axes, values, strict=True), *point)
        for point in joint_of(spec, algo)
        for values in itertools.product(*axes.values())
    ]
