"""Estimates with bootstrap intervals over seeds: numpy arrays in, numbers out.

Scores are matrices (runs, tasks). Intervals are 95% percentile intervals of a stratified bootstrap as in rliable
(Agarwal et al. 2021): each task's runs are drawn again with replacement, for itself. The draws are counts of how
often each run was taken; they depend on the shape and a fixed seed alone, so the same store gives the same table.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import binom

RESAMPLES = 5000
LEVEL = 0.95
BOOTSTRAP_SEED = 20190312


class Interval(NamedTuple):
    """An estimate and its interval; with fewer than two runs there is none and the bounds are nan."""

    estimate: float
    lower: float
    upper: float

    @property
    def excludes_zero(self) -> bool:
        return self.lower > 0 or self.upper < 0


class Band(NamedTuple):
    """A mean curve and its pointwise interval."""

    mean: Float[np.ndarray, "points"]
    lower: Float[np.ndarray, "points"]
    upper: Float[np.ndarray, "points"]


class Scores(NamedTuple):
    """One number a run, and the seeds they belong to (each once, ascending)."""

    seeds: Int[np.ndarray, "runs"]
    values: Float[np.ndarray, "runs"]


def interquartile_mean(scores: Float[np.ndarray, "runs tasks"]) -> float:
    """Mean of the middle half of all scores: a quarter of their number, rounded down, is cut from each end."""
    if not scores.size:
        return np.nan
    ordered, cut = np.sort(scores, axis=None), scores.size // 4
    return float(ordered[cut : scores.size - cut].mean())


def interquartile_interval(scores: Float[np.ndarray, "runs tasks"]) -> Interval:
    """Interquartile mean of `scores`.

    A resample is never sorted: in the order of the original scores, the cumulative counts say which of its
    entries lie in the middle half.
    """
    if len(scores) < 2:
        return Interval(interquartile_mean(scores), np.nan, np.nan)
    order, cut = np.argsort(scores, axis=None, kind="stable"), scores.size // 4
    ordered = scores.reshape(-1)[order]

    def resampled(counts: np.ndarray) -> np.ndarray:
        taken = counts.reshape(len(counts), -1)[:, order].cumsum(axis=1)
        middle = np.diff(taken.clip(cut, scores.size - cut), axis=1, prepend=cut)
        return middle @ ordered / (scores.size - 2 * cut)

    return Interval(interquartile_mean(scores), *_bounds(_bootstrap(scores.shape, resampled)))


def mean_interval(scores: Float[np.ndarray, "runs tasks"]) -> Interval:
    """Mean of `scores`."""
    if len(scores) < 2:
        return Interval(float(scores.mean()) if scores.size else np.nan, np.nan, np.nan)
    resampled = _bootstrap(scores.shape, lambda counts: np.einsum("brt,rt->b", counts, scores) / scores.size)
    return Interval(float(scores.mean()), *_bounds(resampled))


def median_interval(times: Float[np.ndarray, "runs"]) -> Interval:
    """Median of `times`, among which inf stands for never: the median is inf once half of them are."""
    if not times.size:
        return Interval(np.nan, np.nan, np.nan)
    ordered, middle = np.sort(times), np.array([(times.size - 1) // 2, times.size // 2])
    median = float(ordered[middle].mean())
    if len(times) < 2:
        return Interval(median, np.nan, np.nan)
    order = np.argsort(times, kind="stable")

    def resampled(counts: np.ndarray) -> np.ndarray:
        taken = counts[:, order, 0].cumsum(axis=1)
        return ordered[(taken[:, :, None] > middle).argmax(axis=1)].mean(axis=1)

    # No interpolation between draws: there is nothing between a time and never.
    return Interval(median, *_bounds(_bootstrap((len(times), 1), resampled), method="inverted_cdf"))


def mean_band(curves: Float[np.ndarray, "runs points"]) -> Band:
    """Mean over runs at each point, with its interval; nan is where a run has no value and counts nowhere."""
    present = ~np.isnan(curves)
    filled, weight = np.where(present, curves, 0.0), present.astype(np.float64)
    mean = _ratio(filled.sum(axis=0), weight.sum(axis=0))
    lower, upper = np.full_like(mean, np.nan), np.full_like(mean, np.nan)
    if len(curves) > 1:
        resampled = _bootstrap((len(curves), 1), lambda c: _ratio(c[:, :, 0] @ filled, c[:, :, 0] @ weight))
        known = present.any(axis=0)
        # A resample that took none of the runs with a value at a point says nothing about that point.
        lower[known], upper[known] = np.nanquantile(resampled[:, known], _TAILS, axis=0)
    return Band(mean, lower, upper)


def median_band(curves: Float[np.ndarray, "runs points"]) -> Band:
    """Median over runs at each point, with a 95% interval; nan is where a run has no value and counts nowhere.

    The interval lies between two order statistics (binomial with p = 1/2), so that it holds for any distribution:
    what a few runs do that diverge moves neither it nor the median. `Band.mean` holds the median.
    """
    ordered = np.sort(curves, axis=0)  # nan comes last
    count = (~np.isnan(curves)).sum(axis=0)
    below = np.maximum(binom.ppf(_TAILS[0], count, 0.5), 1).astype(int) - 1
    point = np.arange(curves.shape[1])
    last = np.maximum(count - 1, 0)
    middle = (ordered[last // 2, point] + ordered[np.minimum(count // 2, last), point]) / 2
    lower, upper = ordered[np.minimum(below, last), point], ordered[np.maximum(last - below, 0), point]
    return Band(middle, lower, upper)


def paired_difference(first: Scores, second: Scores) -> tuple[Interval, int]:
    """Mean of first minus second over the seeds that both have, and how many those are."""
    _, mine, theirs = np.intersect1d(first.seeds, second.seeds, assume_unique=True, return_indices=True)
    differences = first.values[mine] - second.values[theirs]
    return mean_interval(differences[:, None]), len(differences)


def first_crossing(curves: Float[np.ndarray, "runs episodes"], threshold: float) -> Float[np.ndarray, "runs"]:
    """The first episode (from 1) of each run with at least `threshold`; inf for none, nan if `threshold` is nan."""
    if np.isnan(threshold):
        return np.full(len(curves), np.nan)
    reached = curves >= threshold
    return np.where(reached.any(axis=1), reached.argmax(axis=1) + 1.0, np.inf)


def walking_mean(
    curves: Float[np.ndarray, "runs episodes"], window: int = 3
) -> Float[np.ndarray, "runs episodes"]:
    """Mean over `window` (odd) episodes around each one; at the ends over those of them that exist."""
    reach, episodes = window // 2, curves.shape[1]
    sums = np.concatenate([np.zeros((len(curves), 1)), curves.cumsum(axis=1)], axis=1)
    start = (np.arange(episodes) - reach).clip(0)
    stop = (np.arange(episodes) + reach + 1).clip(max=episodes)
    return (sums[:, stop] - sums[:, start]) / (stop - start)


def best_and_tied(points: Sequence[Scores]) -> tuple[int | None, Bool[np.ndarray, "points"]]:
    """The point of a grid with the highest interquartile mean (then mean), and which points are tied with it.

    Tied are the best point and those whose paired difference to it is not significant: best minus point, over
    the seeds that both have, is not wholly above zero. There is no correction for the number of points. A point
    without a run is neither, and without any run nothing is best.
    """
    tied = np.zeros(len(points), dtype=bool)
    ranks = {
        index: (interquartile_mean(point.values[:, None]), float(point.values.mean()))
        for index, point in enumerate(points)
        if point.values.size
    }
    if not ranks:
        return None, tied
    best = max(ranks, key=lambda index: ranks[index])
    for index in ranks:
        tied[index] = index == best or not paired_difference(points[best], points[index])[0].lower > 0
    return best, tied


_TAILS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)


_LARGEST_BLOCK = 2_000_000
"""Counts that are held at once."""


def _bootstrap(shape: tuple[int, ...], statistic: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """`statistic` of all resamples: it maps counts (block, runs, tasks) to (block, ...)."""
    runs, tasks = shape
    block = max(1, _LARGEST_BLOCK // (runs * tasks))
    starts = range(0, RESAMPLES, block)
    return np.concatenate(
        [statistic(_counts(runs, tasks, start, min(block, RESAMPLES - start))) for start in starts]
    )


@lru_cache(maxsize=8)
def _counts(runs: int, tasks: int, start: int, block: int) -> Float[np.ndarray, "block runs tasks"]:
    """How often each run is taken in resamples `start` to `start + block`: `runs` draws for each task."""
    generator = np.random.default_rng([BOOTSTRAP_SEED, start])
    drawn = generator.multinomial(runs, np.full(runs, 1 / runs), size=(block, tasks))
    counts = np.ascontiguousarray(drawn.swapaxes(1, 2), dtype=np.float64)
    counts.setflags(write=False)
    return counts


def _bounds(
    resampled: Float[np.ndarray, "resamples"], method: Literal["linear", "inverted_cdf"] = "linear"
) -> tuple[float, float]:
    lower, upper = np.quantile(resampled, _TAILS, method=method)
    return float(lower), float(upper)


def _ratio(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return np.divide(sums, counts, out=np.full(np.shape(sums), np.nan), where=counts > 0)
