"""Where a search looks: a range or a list of values for each setting. Loads no jax, no optuna."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from gpcjax.allowed import FINITE, checked, entries, shown
from gpcjax.errors import UserError

FORM = "NAME=LOW:HIGH, NAME=LOW:HIGH:linear or NAME=A,B,C"


@dataclass(frozen=True)
class Range:
    """All numbers from `low` to `high`; `log` says that factors count, not differences."""

    low: float
    high: float
    log: bool

    @property
    def ends(self) -> tuple[float, ...]:
        """The least and the largest value."""
        return self.low, self.high

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Values:
    """These numbers alone."""

    values: tuple[float, ...]

    @property
    def ends(self) -> tuple[float, ...]:
        """All of them."""
        return self.values

    def __str__(self) -> str:
        return ", ".join(f"{value:g}" for value in self.values)


Space = dict[str, Range | Values]
"""By the name of the setting."""


def of_words(words: Iterable[str]) -> Space:
    """From the values of `--search`. Raises UserError."""
    space: Space = {}
    for word in words:
        key, equals, text = word.partition("=")
        name = key.strip().replace("-", "_")
        if not equals or not name.isidentifier():
            raise UserError(f"--search {shown(word)}: give {FORM}")
        if name in space:
            raise UserError(f"--search {name} is given twice: give it once")
        space[name] = _of_text(text, f"--search {name}")
    return space


def of_table(table: Mapping[str, Any], prefix: str) -> Space:
    """From a table `search` of TOML: texts as `--search` has them, or lists of numbers. Raises UserError."""
    space: Space = {}
    for key, value in table.items():
        name, source = str(key).replace("-", "_"), f"{prefix}{key}"
        if name in space:
            raise UserError(f"{source} is given twice, with a dash and with an underscore: give it once")
        several = entries(source, value, 1001)
        if isinstance(value, str):
            space[name] = _of_text(value, source)
        elif several is not None:
            space[name] = _values([checked(source, one, float, FINITE) for one in several], source)
        else:
            raise UserError(f'{source} {shown(value)}: give "LOW:HIGH" in quotes, or a list of values')
    return space


def _of_text(text: str, source: str) -> Range | Values:
    parts = [part.strip() for part in text.split(":")]
    if len(parts) == 1:
        return _values([_number(word, source) for word in text.split(",")], source)
    if len(parts) > 3 or (len(parts) == 3 and parts[2] not in ("log", "linear")):
        raise UserError(f"{source} {shown(text)}: give {FORM}")
    low, high = (_number(word, source) for word in parts[:2])
    if not low < high:
        raise UserError(f"{source} {shown(text)}: the first number must be below the second one")
    log = parts[2] == "log" if len(parts) == 3 else low > 0
    if log and not low > 0:
        raise UserError(f"{source} {shown(text)}: factors of what is not above zero say nothing, give linear")
    return Range(low, high, log)


def _values(values: list[float], source: str) -> Values:
    if not 0 < len(values) <= 1000:
        raise UserError(f"{source}: give up to 1,000 values")
    return Values(tuple(dict.fromkeys(values)))


def _number(word: str, source: str) -> float:
    try:
        return checked(source, float(word), float, FINITE)
    except ValueError:
        raise UserError(f"{source} {shown(word)}: give {FORM}") from None


def grid_of(space: Space) -> dict[str, tuple[float, ...]]:
    """The lists of a grid. Raises UserError for a range, which is no list."""
    for name, domain in space.items():
        if isinstance(domain, Range):
            raise UserError(
                f"search {name}: a grid needs values: give {name}=A,B,C, or --method tpe for a range"
            )
    return {name: domain.ends for name, domain in space.items()}


def corners(space: Space) -> list[dict[str, float]]:
    """Points with all the extreme values: what they allow, all points between do."""
    longest = max(len(domain.ends) for domain in space.values())
    return [
        {name: domain.ends[min(place, len(domain.ends) - 1)] for name, domain in space.items()}
        for place in range(longest)
    ]


def as_json(space: Space) -> dict[str, Any]:
    """As `tune.json` holds it."""
    return {
        name: list(domain.values) if isinstance(domain, Values) else [domain.low, domain.high, domain.log]
        for name, domain in space.items()
    }


def at_edge(space: Space, point: Mapping[str, float]) -> list[str]:
    """Settings whose value lies at an end of their range, within a hundredth of it: a wider one may hold a better."""
    found = []
    for name, domain in space.items():
        if isinstance(domain, Range):
            scale = math.log if domain.log else float
            low, high, value = (scale(number) for number in (domain.low, domain.high, point[name]))
            if min(value - low, high - value) < 0.01 * (high - low):
                found.append(name)
    return found
