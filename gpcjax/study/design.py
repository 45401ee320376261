"""Who teaches what in which order: counterbalanced, deterministic from the study's seed. Standard library only.

A *treatment* is a learner in an arm: what stands behind a letter. A *cell* is all that can differ between participants:
the order of treatments, the order of tasks, and with arms between participants the arm. A *slot* is the place of one
participant: it has a cell, and is given again when its participant drops out.
"""

import hashlib
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from gpcjax.errors import UserError

ORDERS = ("complete", "latin", "fixed")
"""Every order; a balanced Latin square; the order of the file."""

MOST_ORDERS = 720
"""Of six things all orders: more cells than a study has participants balance nothing."""

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"

T = TypeVar("T")


class Treatment(NamedTuple):
    """What a letter stands for."""

    learner: str
    arm: str


@dataclass(frozen=True)
class Arm:
    """A condition of the study, beside the learners."""

    name: str
    learners: tuple[str, ...]
    cue: bool = False
    """Whether the page shows how sure the learner is of the present state (sigma_h, 3.4.2 of the thesis)."""
    delay: float = 0.0
    """Seconds by which a key reaches the learner later."""
    most: int | None = None
    """Participants, where arms are between participants."""


class Cell(NamedTuple):
    """What can differ between participants."""

    arm: str | None
    """None: each participant has all arms."""
    treatments: tuple[Treatment, ...]
    tasks: tuple[str, ...]


def orders(things: Sequence[T], kind: str) -> tuple[tuple[T, ...], ...]:
    """The orders among which participants are spread.

    "latin" is a square of Williams (1949): each thing is as often at each place as any, and as often right behind each
    other one. With an odd number of things it takes the reversed orders, too.

    Raises:
        UserError: there are too many.
    """
    count = len(things)
    if kind == "fixed" or count == 1:
        return (tuple(things),)
    if kind == "complete":
        if count > 6:
            raise UserError(f"all orders of {count} are too many to balance: give latin or fixed")
        return tuple(itertools.permutations(things))
    first = [0]
    for step in range(1, count):
        first.append((first[-1] + (step if step % 2 else -step)) % count)
    rows = [[(place + shift) % count for place in first] for shift in range(count)]
    if count % 2:
        rows += [row[::-1] for row in rows]
    return tuple(tuple(things[place] for place in row) for row in rows)


def cells(
    arms: Sequence[Arm], within: bool, tasks: Sequence[str], of_learners: str, of_tasks: str
) -> tuple[Cell, ...]:
    """All cells of a study.

    Raises:
        UserError: there are too many.
    """
    orders_of_tasks = orders(tasks, of_tasks)
    found = []
    for arm in [None] if within else arms:
        each = [
            Treatment(name, one.name) for one in (arms if arm is None else [arm]) for name in one.learners
        ]
        for treatments in orders(each, of_learners):
            found += [Cell(arm and arm.name, treatments, order) for order in orders_of_tasks]
    if len(found) > MOST_ORDERS * len(arms):
        raise UserError(
            f"{len(found):,} orders are too many to balance: give latin or fixed for learners or tasks"
        )
    return tuple(found)


def slots(
    every: Sequence[Cell], participants: int, seed: int, most: int | None, arms: Iterable[Arm]
) -> tuple[Cell, ...]:
    """The cell of each participant, in the order in which they come; fewer than `participants` if the caps say so.

    Arms take turns, and in each of them every cell comes once before one comes again; within that all is shuffled by
    the seed. So after any number of participants no cell of an arm is ahead of another by more than one, nor is an arm
    that has not reached its cap.

    Args:
        every: the cells of a study.
        participants: how many are wanted.
        seed: of the shuffling.
        most: participants with one cell; None for any number.
        arms: of which some may have a cap.
    """
    caps = {arm.name: arm.most for arm in arms if arm.most is not None}
    by_arm: dict[str | None, list[Cell]] = {}
    for cell in every:
        by_arm.setdefault(cell.arm, []).append(cell)
    queues = {arm: _endless(own, f"{seed}/{arm}", most) for arm, own in by_arm.items()}
    found: list[Cell] = []
    taken: Counter[str | None] = Counter()
    for turn in itertools.count():
        before = len(found)
        for arm in _shuffled(list(queues), f"{seed}/arms/{turn}"):
            if len(found) == participants:
                return tuple(found)
            if arm in caps and taken[arm] >= caps[arm]:
                continue
            cell = next(queues[arm], None)
            if cell is not None:
                taken[arm] += 1
                found.append(cell)
        if len(found) == before:
            return tuple(found)
    raise AssertionError  # the count never ends


def _endless(own: Sequence[Cell], word: str, most: int | None) -> Iterator[Cell]:
    """All cells, each time in another order; `most` times, or for ever."""
    for turn in itertools.count() if most is None else range(most):
        yield from _shuffled(own, f"{word}/{turn}")


def free_slot(count: int, held: Iterable[int]) -> int | None:
    """The first of so many slots that nobody holds; None if all are held."""
    taken = set(held)
    return next((slot for slot in range(count) if slot not in taken), None)


def base_seed(seed: int, number: int) -> int:
    """Of a participant: the seed of his or her n-th run of each learner and task is this plus n.

    The same starts so for each learner: differences between learners are paired.
    """
    return seed + 100 * number


def _shuffled(things: Sequence[T], word: str) -> list[T]:
    """In an order that depends on `word` alone, in each version of Python."""
    keys = {index: hashlib.sha256(f"{word}/{index}".encode()).digest() for index in range(len(things))}
    return [things[index] for index in sorted(keys, key=keys.__getitem__)]
