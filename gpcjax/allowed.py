"""What a value may be, as data: tested and worded in one place. Standard library only."""

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass


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
        return inside and value <= self.high and math.isfinite(value)

    def __str__(self) -> str:
        noun = "a whole number" if self.whole else "a number"
        if self.high < math.inf:
            return f"{noun} from {self.low:g} to {self.high:,.12g}"
        return f"{noun} above {self.low:g}" if self.above else f"{noun} of at least {self.low:g}"


@dataclass(frozen=True)
class OneOf:
    """A few words or numbers."""

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

POSITIVE = Numbers(low=0, above=True)
NON_NEGATIVE = Numbers(low=0)


def suggestion(word: object, known: Iterable[object]) -> str:
    """' (did you mean X?)', or nothing where no known word is near."""
    near = difflib.get_close_matches(str(word).lower(), [str(name) for name in known], n=1, cutoff=0.6)
    return f" (did you mean {near[0]}?)" if near else ""
