"""What a value may be, as data: tested and worded in one place. Standard library only.

Flags, TOML and Python ask the same objects: `checked` for one value, `checked_series` for one or several.
"""

import difflib
import itertools
import math
import numbers
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError


@dataclass(frozen=True)
class Numbers:
    """Finite numbers from `low` to `high`; `above` leaves `low` itself out, `whole` wants integers."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    whole: bool = False

    def admits(self, value: object) -> bool:
        """Whether `value` is one of these numbers."""
        if isinstance(value, bool) or not isinstance(value, int if self.whole else int | float):
            return False
        inside = self.low < value if self.above else self.low <= value
        return inside and value <= self.high and (isinstance(value, int) or math.isfinite(value))

    def __str__(self) -> str:
        noun = "a whole number" if self.whole else "a number"
        if self.low == -math.inf and self.high == math.inf:
            return noun if self.whole else "a finite number"
        if self.high < math.inf:
            return f"{noun} from {self.low:g} to {self.high:,.12g}"
        return f"{noun} above {self.low:g}" if self.above else f"{noun} of at least {self.low:g}"


@dataclass(frozen=True)
class OneOf:
    """A few words or numbers: the `choices`."""

    choices: tuple[str | float, ...]

    def admits(self, value: object) -> bool:
        """Whether `value` is one of the choices."""
        return not isinstance(value, bool) and value in self.choices

    def __str__(self) -> str:
        *first, last = map(str, self.choices)
        return f"{', '.join(first)} or {last}" if first else last


@dataclass(frozen=True)
class Anything:
    """A switch or a path: whatever its kind admits. `words` says what that is."""

    words: str

    def admits(self, value: object) -> bool:
        """True: the kind of the option has been checked before."""
        return True

    def __str__(self) -> str:
        return self.words


Allowed = Numbers | OneOf | Anything

FINITE = Numbers()
POSITIVE = Numbers(low=0, above=True)
NON_NEGATIVE = Numbers(low=0)
PROBABILITY = Numbers(0, 1)
COUNT = Numbers(1, 1_000_000, whole=True)
"""How many: seeds, episodes, starts, sizes. What is more is a slip of the finger."""
STEPS = Numbers(1, 2_000_000_000, whole=True)
"""Steps of an episode, counted in an int32."""
SWITCH = Anything("true or false")


def converted(kind: type, value: object) -> Any:
    """`value` as exactly `kind` (str, bool, int or float), or None where it is none.

    No text for numbers, no fractions or floats for integers, no truth for numbers, no 0 or 1 for switches, no number so
    small that float64 has not all of its digits. Numpy's scalars, and arrays without axes, are what they hold, if that
    is data (`is_no_data`).
    """
    given: Any = plain(value)
    if is_no_data(given):
        return None
    wanted = {str: str, bool: bool, int: numbers.Integral, float: numbers.Real}[kind]
    if not isinstance(given, wanted) or (isinstance(given, bool) and kind is not bool):
        return None
    if kind is not float:
        return kind(given)
    try:
        number = float(given) + 0.0  # -0.0 becomes 0.0: one value, one cell
    except OverflowError:
        return None
    return None if given != 0 and abs(number) < sys.float_info.min else number


def checked(source: str, value: object, kind: type, allowed: Allowed) -> Any:
    """`value` as `kind`, if it is allowed. Raises UserError, which begins with `source`."""
    result = converted(kind, value)
    if result is None or not allowed.admits(result):
        choices = allowed.choices if isinstance(allowed, OneOf) and kind is str else ()
        raise UserError(f"{source} {shown(value)}: give {allowed}{suggestion(value, choices)}")
    return result


def checked_series(source: str, value: object, size: int, allowed: Numbers) -> tuple[float, ...]:
    """`size` numbers, from as many or from one for all. Raises UserError, which begins with `source`."""
    several = entries(source, value, size + 1)
    each = [value] * size if several is None else several
    found = tuple(converted(float, one) for one in each)
    if len(found) != size or not all(one is not None and allowed.admits(one) for one in found):
        raise UserError(f"{source} {shown(value)}: give {allowed}, or {size} of them")
    return found


def entries(source: str, value: object, most: int) -> list[Any] | None:
    """The first `most` of several values, in their order; None for one value, a text, a table, an array without axes.

    Raises:
        UserError: a set, whose order is another in each process; the message begins with `source`.
    """
    if isinstance(value, set | frozenset):
        raise UserError(f"{source} {shown(value)}: a set has no order, give a list")
    one = isinstance(value, str | bytes | bytearray | Mapping) or getattr(value, "shape", None) == ()
    return None if one or not isinstance(value, Iterable) else list(itertools.islice(value, most))


def is_no_data(value: object) -> bool:
    """Whether an array or a scalar of numpy holds what is no number, though numpy makes numbers of it.

    Spans of time and dates have a unit that would be dropped; what lies under a mask is what was to be left out.
    """
    if getattr(getattr(value, "dtype", None), "kind", "") in ("m", "M"):
        return True
    mask = getattr(value, "mask", None)  # a method where pandas made it
    return mask is not None and not callable(mask) and bool(getattr(mask, "any", lambda: False)())


def holds_numbers(value: object) -> bool:
    """Whether it is an array, or a scalar of numpy, of real numbers, also one that jax traces."""
    return getattr(getattr(value, "dtype", None), "kind", "") in tuple("fiu") and not is_no_data(value)


def checked_path(source: str, value: object) -> Path:
    """A path, given as text or as a path. Raises UserError, which begins with `source`."""
    text = os.fspath(value) if isinstance(value, os.PathLike) else value
    if not isinstance(text, str) or not text.strip() or "\0" in text:
        raise UserError(f"{source} {shown(value)}: give a path")
    return Path(text)


def shown(value: object) -> str:
    """`value` as it stands in a message: on one line, and never longer than a line should be."""
    try:
        text = " ".join(repr(plain(value)).split())
    except (RecursionError, ValueError):  # tables in tables, or an integer of more digits than Python writes
        text = f"of type {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


def plain(value: object) -> object:
    """What an array without axes holds; any other value as it is: one that jax traces, and one that is no data."""
    if getattr(value, "shape", None) != () or not hasattr(value, "item") or is_no_data(value):
        return value
    try:
        return value.item()  # pyright: ignore[reportAttributeAccessIssue]
    except (TypeError, NotImplementedError):  # of what jax traces, and of a random key
        return value


def suggestion(word: object, known: Iterable[object]) -> str:
    """' (did you mean X?)', or nothing where no known word is near."""
    near = difflib.get_close_matches(str(word).lower(), [str(name) for name in known], n=1, cutoff=0.6)
    return f" (did you mean {near[0]}?)" if near else ""
