"""One number for each seed, and arithmetic on them: what claims are made of. Loads no jax."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gpcjax.report.statistics import Scores


@dataclass(frozen=True, eq=False)
class Measure:
    """A number for each seed. Two of them meet on the seeds that both have: runs of one seed share starts and coins.

    | Field    | Shape  | Meaning                    |
    |----------|--------|----------------------------|
    | `seeds`  | (runs,) | each once, ascending      |
    | `values` | (runs,) | finite, in any unit       |
    """

    seeds: Int[np.ndarray, " runs"]
    values: Float[np.ndarray, " runs"]

    def __add__(self, other: "Measure | float") -> "Measure":
        return self._with(other, np.add)

    def __sub__(self, other: "Measure | float") -> "Measure":
        return self._with(other, np.subtract)

    def __mul__(self, other: "Measure | float") -> "Measure":
        return self._with(other, np.multiply)

    def __truediv__(self, other: "Measure | float") -> "Measure":
        return self._with(other, np.divide)

    __rmul__ = __mul__

    @property
    def runs(self) -> int:
        """How many have a value."""
        return len(self.seeds)

    @property
    def mean(self) -> float:
        """Over all runs; nan without any."""
        return float(self.values.mean()) if self.runs else np.nan

    def log10(self) -> "Measure":
        """Of values above zero; a run with another one has none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return known(self.seeds, np.log10(self.values))

    def _with(self, other: "Measure | float", operation: Callable[..., np.ndarray]) -> "Measure":
        if not isinstance(other, Measure):
            return Measure(self.seeds, operation(self.values, other))
        mine, theirs = paired(self, other)
        return Measure(mine.seeds, operation(mine.values, theirs.values))


def known(seeds: Int[np.ndarray, " runs"], values: Float[np.ndarray, " runs"]) -> Measure:
    """What runs have a finite value."""
    finite = np.isfinite(values)
    return Measure(seeds[finite], values[finite])


def measure(scores: Scores) -> Measure:
    """Scores of a report, to count with."""
    return known(np.asarray(scores.seeds, np.int64), np.asarray(scores.values, np.float64))


def paired(first: Measure, second: Measure) -> tuple[Measure, Measure]:
    """Both, on the seeds that both have."""
    seeds, mine, theirs = np.intersect1d(first.seeds, second.seeds, assume_unique=True, return_indices=True)
    return Measure(seeds, first.values[mine]), Measure(seeds, second.values[theirs])


def average(measures: Sequence[Measure]) -> Measure:
    """The mean of several, on the seeds that all have."""
    total = measures[0]
    for each in measures[1:]:
        total = total + each
    return total / len(measures)


def ratio_of_means(top: Measure, bottom: Measure) -> Measure:
    """What each seed adds to mean(top) / mean(bottom): the jackknife's pseudo-values.

    Their mean is that ratio, but for its bias of order 1 / runs, and their spread is its spread: so a ratio of totals
    (all corrections of all runs pooled, say) is tested as any mean is.
    """
    top, bottom = paired(top, bottom)
    count, above, below = top.runs, top.values.sum(), bottom.values.sum()
    with np.errstate(divide="ignore", invalid="ignore"):
        if count < 2:
            return known(top.seeds, top.values / bottom.values)
        without = (above - top.values) / (below - bottom.values)
        return known(top.seeds, count * (above / below) - (count - 1) * without)


def slopes(curves: Float[np.ndarray, "runs points"]) -> Float[np.ndarray, " runs"]:
    """Of each curve the slope of its line of least squares, a point; nan with fewer than two points."""
    points = curves.shape[1]
    if points < 2:
        return np.full(len(curves), np.nan)
    place = np.arange(points) - (points - 1) / 2
    return curves @ place / (place @ place)


def rank_correlations(
    first: Float[np.ndarray, "runs points"], second: Float[np.ndarray, "runs points"]
) -> Float[np.ndarray, " runs"]:
    """Spearman's within each run, over the points that both know; nan with fewer than three, or without change."""
    correlations = np.full(len(first), np.nan)
    for run, (x, y) in enumerate(zip(first, second, strict=True)):
        both = np.isfinite(x) & np.isfinite(y)
        if both.sum() >= 3:
            ranks = np.stack([_ranks(x[both]), _ranks(y[both])])
            if (ranks.std(axis=1) > 0).all():
                correlations[run] = np.corrcoef(ranks)[0, 1]
    return correlations


def _ranks(values: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
    """From 0; those that are equal share the mean of theirs."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (counts.cumsum() - (counts + 1) / 2)[place]
