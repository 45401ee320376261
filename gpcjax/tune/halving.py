"""Successive halving: many points on few seeds and short runs, the best of them on more.

Jamieson and Talwalkar 2016, "Non-stochastic best arm identification and hyperparameter optimization"; here a rung is a
number of seeds and of episodes, and the points of one batch go up together. Standard library only.
"""

import itertools
import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from gpcjax.allowed import COUNT, Numbers, shown
from gpcjax.errors import UserError
from gpcjax.sweep.seeds import Seeds

FORM = "numbers of seeds that grow, each with the episodes of its runs if need be: 4x10,8x20,16"
ETA = Numbers(1.1, 100)

_RUNG = re.compile(r"([0-9]{1,9})(?:x([0-9]{1,9}))?")


class Rung(NamedTuple):
    """How long points are looked at, before the better of them go on to the next rung."""

    seeds: int
    """The first so many of the search's seeds."""
    episodes: int


def rungs_of(text: str | None, seeds: Seeds, episodes: int, source: str) -> tuple[Rung, ...]:
    """The rungs of a text like "4x10,16", whose last one is all seeds and episodes; that alone without a text.

    Raises:
        UserError: it is no such text, or has more seeds or episodes than there are, or a rung less than the one before.
    """
    whole = Rung(len(seeds), episodes)
    rungs = []
    for word in () if text is None else text.split(","):
        found = _RUNG.fullmatch(word.strip())
        if found is None:
            raise UserError(f"{source} {shown(text)}: give {FORM}")
        count, length = found.groups()
        rung = Rung(int(count), episodes if length is None else int(length))
        if not (COUNT.admits(rung.seeds) and COUNT.admits(rung.episodes)):
            raise UserError(f"{source} {shown(word)}: give {FORM}")
        if rung.seeds > whole.seeds or rung.episodes > whole.episodes:
            raise UserError(
                f"{source} {shown(word)}: there are {whole.seeds} seeds and {whole.episodes} episodes, give no more"
            )
        rungs.append(rung)
    if not rungs or rungs[-1] != whole:
        rungs.append(whole)
    for before, after in itertools.pairwise(rungs):
        if after.seeds < before.seeds or after.episodes < before.episodes or after == before:
            raise UserError(
                f"{source} {shown(text)}: a rung looks at less than the one before it, give {FORM}"
            )
    return tuple(rungs)


def first(seeds: Seeds, count: int) -> Seeds:
    """The first so many seeds."""
    chosen = Seeds.of([seed for seed, _ in zip(seeds, range(count), strict=False)])
    assert chosen is not None
    return chosen


def go_on(order: Sequence[int], eta: float) -> list[int]:
    """Those of a rung that go up: one in `eta`, one at least."""
    return list(order[: max(1, math.ceil(len(order) / eta))])
