"""What the runs of a sweep have come to so far: a few numbers for each group, as rows come in. Loads no jax.

It is for whoever watches. The report counts what is in the store, with all that statistics ask for.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from gpcjax.sweep.boxes import setting_of
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.rows import Run

FINAL_EPISODES = 5
"""The last episodes of a run, whose mean is its final return: here and in reports."""

_ALWAYS = ("algo", "error")


@dataclass
class Group:
    """The runs that differ in their seeds alone."""

    label: tuple[Any, ...]
    """The values of `SoFar.names`."""
    runs: int = 0
    """That are to come, all in all."""
    finished: int = 0
    stopped: int = 0
    """Of these, the runs that ended before their last episode: they count in no mean."""
    final: float = 0.0
    """Mean return of the last episodes, over the runs that went to their end; 0 before the first."""
    curve: Float[np.ndarray, "episodes"] = field(default_factory=lambda: np.zeros(0))
    """Mean return of each episode, over the same runs; empty before the first."""

    def add(self, returns: Float[np.ndarray, "episodes"], complete: bool) -> None:
        """Counts a run."""
        self.finished += 1
        if not complete:
            self.stopped += 1
            return
        share = 1.0 / (self.finished - self.stopped)
        self.curve = returns.copy() if share == 1.0 else self.curve + share * (returns - self.curve)
        self.final += share * (returns[-FINAL_EPISODES:].mean() - self.final)


class Range(NamedTuple):
    """Between which returns a curve is drawn."""

    low: float
    high: float


class SoFar:
    """All groups of a sweep, in the order of its cells.

    Args:
        cells: what is to run.
        varying: settings with more than one value.
    """

    def __init__(self, cells: Iterable[Cell], varying: Sequence[str] = ()):
        cells = list(cells)
        oracles = {cell.oracle for cell in cells}
        self.names: tuple[str, ...] = (
            *_ALWAYS,
            *(["oracle"] if len(oracles) > 1 else []),
            *(name for name in varying if name not in _ALWAYS),
        )
        self._groups: dict[tuple[Any, ...], Group] = {}
        for cell in cells:
            label = self._label(cell)
            self._groups.setdefault(label, Group(label)).runs += 1

    @property
    def groups(self) -> list[Group]:
        """Each of them, also those without a run yet."""
        return list(self._groups.values())

    @property
    def range(self) -> Range | None:
        """From the lowest to the highest mean return of an episode, of all groups; None before the first run."""
        curves = [group.curve for group in self._groups.values() if group.curve.size]
        if not curves:
            return None
        return Range(min(curve.min() for curve in curves), max(curve.max() for curve in curves))

    def add(self, run: Run) -> None:
        """Counts a run that came in."""
        returns = np.asarray(run.returns, np.float64)
        complete = len(returns) == run.cell.episodes and bool(np.isfinite(returns).all())
        self._groups[self._label(run.cell)].add(returns, complete)

    def _label(self, cell: Cell) -> tuple[Any, ...]:
        own = {"algo": cell.algo, "error": cell.error, "oracle": cell.oracle}
        return tuple(own[name] if name in own else setting_of(cell, name) for name in self.names)
