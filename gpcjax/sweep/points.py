"""Points of a sweep: settings that belong together, where not every combination of lists is wanted. Loads no jax.

A search asks for points, and so may a person: `[[points]]` tables in TOML, or dicts in Python.
"""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from gpcjax.allowed import entries, shown
from gpcjax.errors import UserError
from gpcjax.sweep.options import LARGEST

POINTS = "points"

Point = tuple[tuple[str, float], ...]
"""Names of settings and their values."""

_GIVE = "give tables of numbers with the same names, as in [[points]] policy_length_scale = 0.2"


def accepted(value: Any, source: str, accept: Callable[[str, Any, str], float]) -> tuple[Point, ...]:
    """The points of a list of tables, each once, in the order of their names.

    Args:
        value: as TOML or Python has it.
        source: where it stood, for messages.
        accept: gives the checked value of a setting, from its name, value and where it stood; raises UserError.

    Raises:
        UserError: it is no such list, or a name or value is not allowed.
    """
    tables = entries(source, value, LARGEST + 1)
    if not tables or not all(isinstance(table, Mapping) and table for table in tables):
        raise UserError(f"{source} {shown(value)}: {_GIVE}")
    if len(tables) > LARGEST:
        raise UserError(f"{source}: more than {LARGEST:,} points, give fewer")
    names = list(dict.fromkeys(_name(key, source) for key in tables[0]))
    points = []
    for number, table in enumerate(tables, 1):
        place = f"{source}: point {number}: "
        written = {_name(key, source): (key, each) for key, each in table.items()}
        if len(written) != len(table) or set(written) != set(names):
            raise UserError(f"{place}it has {', '.join(map(str, table))}, not {', '.join(names)}: {_GIVE}")
        points.append(tuple((name, accept(name, written[name][1], f"{place}{name}")) for name in names))
    return tuple(dict.fromkeys(points))


def _name(key: object, source: str) -> str:
    if not isinstance(key, str):
        raise UserError(f"{source}: {shown(key)} is no name of a setting: {_GIVE}")
    return key.replace("-", "_")


def names_of(points: Iterable[Point]) -> list[str]:
    """The settings that points have."""
    return list(dict.fromkeys(name for point in points for name, _ in point))


def values_of(points: Iterable[Point], name: str) -> tuple[float, ...]:
    """The values of a setting, each once."""
    return tuple(dict.fromkeys(value for point in points for each, value in point if each == name))


@functools.lru_cache(maxsize=64)
def cut(points: tuple[Point, ...], names: frozenset[str]) -> tuple[Point, ...]:
    """The points with these settings alone, each once; one without any where there are none."""
    left = (tuple((name, value) for name, value in point if name in names) for point in points or ((),))
    return tuple(dict.fromkeys(left))


def as_json(points: Iterable[Point]) -> list[dict[str, float]]:
    """As a manifest holds them."""
    return [dict(point) for point in points]


def from_json(tables: Any) -> tuple[Point, ...]:
    """What `as_json` gave. Raises TypeError, ValueError or AttributeError for anything else."""
    return tuple(
        tuple((str(name), _number(value)) for name, value in sorted(table.items(), key=_order(tables)))
        for table in tables
    )


def _number(value: Any) -> float:
    """The number as it is: a whole one written as another makes another hash."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise TypeError(f"{shown(value)} is no number")
    return value


def _order(tables: Any) -> Callable[[tuple[str, float]], int]:
    """The names of all tables in the order of the first one."""
    places = {name: place for place, name in enumerate(tables[0])}
    return lambda item: places[item[0]]


def given(specification: Mapping[str, Any]) -> dict[str, Any]:
    """The values that each hyperparameter of a specification has, alone or in points, as JSON has it."""
    points = from_json(specification.get(POINTS) or [])
    joint = {name: list(values_of(points, name)) for name in names_of(points)}
    return {**(specification.get("hyperparameters") or {}), **joint}
