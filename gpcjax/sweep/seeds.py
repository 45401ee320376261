"""Which seeds a sweep has: the first n, or a range or list of them. Standard library only."""

import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from gpcjax.allowed import COUNT, converted, entries, is_no_data, plain

MOST = int(COUNT.high)
"""Seeds of a sweep."""

LARGEST_SEED = 999_999_999

_SPAN = re.compile(r"\s*([0-9]{1,9})\s*(?:-\s*([0-9]{1,9})\s*)?")
_COUNT = re.compile(r"\s*\+?([0-9]+)\s*")

WORDS = f"{COUNT} (seeds 0 to n-1), or which, as in 100-199 or 3,7"
"""What a value of seeds may be, for messages."""


@dataclass(frozen=True)
class Seeds:
    """A set of seeds: `spans` of the first and the last of each run of them, ascending, with gaps between."""

    spans: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, value: object) -> "Seeds | None":
        """From a number n (seeds 0 to n - 1), a text such as "100-199" or "3,7", or whole numbers; None for others.

        A text is how many, too, where it is no more than a number: so flags have it.
        """
        value = plain(value)
        if isinstance(value, cls):
            return value
        if isinstance(value, str):
            if single := _COUNT.fullmatch(value):
                return cls.of(int(single[1])) if len(single[1]) < 20 else None
            return cls._of_words(value.split(","))
        if (count := converted(int, value)) is not None:
            return cls(((0, count - 1),)) if COUNT.admits(count) else None
        several = None if is_no_data(value) else entries("seeds", value, MOST + 1)
        if not several or len(several) > MOST:
            return None
        each = [converted(int, one) for one in several]
        return cls._joined((one, one) for one in each) if None not in each else None

    @classmethod
    def _of_words(cls, words: Iterable[str]) -> "Seeds | None":
        found = [_SPAN.fullmatch(word) for word in words]
        if None in found:
            return None
        return cls._joined((int(each[1]), int(each[2] or each[1])) for each in found if each is not None)

    @classmethod
    def _joined(cls, spans: Iterable[tuple[int, int]]) -> "Seeds | None":
        """None where one is the wrong way round or out of bounds, or there are too many seeds."""
        ordered = sorted(spans)
        if not all(0 <= first <= last <= LARGEST_SEED for first, last in ordered):
            return None
        seeds = cls._united(ordered)
        return seeds if 0 < len(seeds) <= MOST else None

    @classmethod
    def _united(cls, ordered: Iterable[tuple[int, int]]) -> "Seeds":
        joined: list[tuple[int, int]] = []
        for first, last in ordered:
            if joined and first <= joined[-1][1] + 1:
                joined[-1] = joined[-1][0], max(joined[-1][1], last)
            else:
                joined.append((first, last))
        return cls(tuple(joined))

    def __len__(self) -> int:
        return sum(last - first + 1 for first, last in self.spans)

    def __iter__(self) -> Iterator[int]:
        return itertools.chain.from_iterable(range(first, last + 1) for first, last in self.spans)

    def __contains__(self, seed: object) -> bool:
        return isinstance(seed, int) and any(first <= seed <= last for first, last in self.spans)

    def __or__(self, other: "Seeds") -> "Seeds":
        """The seeds of both: more than `MOST`, perhaps, which no sweep has."""
        return Seeds._united(sorted([*self.spans, *other.spans]))

    def __str__(self) -> str:
        return str(self.as_json())

    @property
    def words(self) -> str:
        """In a sentence: "100 seeds", "seeds 100-199"."""
        text = self.as_json()
        return f"{text} seeds" if isinstance(text, int) else f"seeds {text}"

    def as_json(self) -> int | str:
        """The number of the first seeds, where it is these: as it was when a sweep could have no others."""
        if len(self.spans) == 1 and self.spans[0][0] == 0:
            return len(self)
        alone = len(self.spans) == 1  # a number without a comma would be how many
        return ",".join(
            f"{first}-{last}" if last > first or alone else str(first) for first, last in self.spans
        )
