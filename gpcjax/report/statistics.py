"""Estimates with 95% intervals over seeds: numpy arrays in, numbers out.

The statistic is the mean over runs, everywhere. Its interval is a studentised bootstrap (bootstrap-t): how far the mean
of a resample lies from that of the runs, in units of its own standard error, says how far the mean of the runs may lie
from the truth. Returns are skewed and often of two kinds (the pole stood, or it fell at once), and runs are few, so
that the percentiles of the resampled means alone, as rliable takes them, are too narrow. Two guards make it safe:

- the variance of a resample is shrunk towards that of the runs as if one run more had had it: resamples of equal runs
  would have none, and their t would be infinite;
- neither side is narrower than Student's t.

Percent of 4,000 samples whose interval contains the true mean (`python -m tests.report.coverage`), with the mean width
in brackets, in that of 1.96 standard errors to either side:

| returns | runs | all equal | percentile | BCa | Student's t | bootstrap-t | this one |
|---|---|---|---|---|---|---|---|
| normal | 5 | 0% | 84.1 (0.88) | 83.9 (0.91) | 95.1 (1.42) | 95.2 (2.28) | 95.6 (1.50) |
| | 10 | 0% | 90.5 (0.94) | 89.9 (0.95) | 95.1 (1.15) | 94.6 (1.23) | 95.7 (1.23) |
| | 20 | 0% | 93.5 (0.97) | 93.1 (0.97) | 95.7 (1.07) | 95.7 (1.08) | 96.2 (1.11) |
| | 100 | 0% | 94.8 (0.99) | 94.7 (0.99) | 95.2 (1.01) | 95.1 (1.01) | 95.4 (1.02) |
| exponential | 5 | 0% | 78.9 (0.87) | 80.0 (0.93) | 88.3 (1.42) | 93.5 (3.12) | 89.8 (1.52) |
| | 10 | 0% | 84.5 (0.93) | 86.2 (0.99) | 88.8 (1.15) | 93.4 (1.53) | 92.9 (1.38) |
| | 20 | 0% | 90.0 (0.96) | 91.5 (1.02) | 91.8 (1.07) | 94.2 (1.23) | 94.9 (1.27) |
| | 100 | 0% | 93.4 (0.99) | 93.1 (1.01) | 93.7 (1.01) | 93.8 (1.04) | 95.2 (1.10) |
| 0 or 2500, half each | 5 | 6% | 94.0 (0.81) | 80.9 (0.79) | 94.0 (1.42) | 94.0 (over 10) | 94.0 (1.63) |
| | 10 | 0% | 97.1 (0.94) | 94.8 (0.93) | 97.5 (1.15) | 99.7 (over 10) | 97.5 (1.51) |
| | 20 | 0% | 95.7 (0.91) | 96.5 (0.95) | 95.7 (1.07) | 97.0 (over 10) | 97.0 (1.11) |
| | 100 | 0% | 95.3 (1.00) | 95.8 (0.99) | 93.8 (1.01) | 94.7 (1.02) | 94.7 (1.04) |
| 2500 in 1 of 10 (or in 9) | 5 | 58% | 40.9 (0.78) | 39.6 (0.78) | 41.6 (1.42) | 41.7 (over 10) | 41.6 (1.48) |
| | 10 | 34% | 66.1 (0.84) | 65.8 (0.98) | 66.1 (1.15) | 66.1 (over 10) | 66.1 (1.62) |
| | 20 | 12% | 87.7 (0.89) | 87.4 (1.03) | 87.7 (1.07) | 86.8 (over 10) | 87.7 (2.03) |
| | 100 | 0% | 95.3 (0.99) | 96.2 (1.04) | 92.2 (1.01) | 95.6 (over 10) | 96.6 (1.22) |

Runs that are all equal have an interval of no width, as they hold no sign of what else may happen: no interval made of
runs alone covers more than the samples that are not all equal, and of those the last three rows cover all. With fewer
than twenty skewed runs it is still too narrow: 93% at ten, 90% at five.

The draws are counts of how often each run was taken; they depend on the number of runs and a fixed seed alone, so that
the same store gives the same table. Medians, of times until something happens and of learning rates, keep percentile
and order-statistic intervals.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import binom
from scipy.stats import t as student

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


def mean_interval(scores: Float[np.ndarray, "runs tasks"]) -> Interval:
    """Mean of `scores`; the runs of each task are resampled for themselves. No bounds where a score is not finite."""
    estimate = float(scores.mean()) if scores.size else np.nan
    if len(scores) < 2 or not np.isfinite(scores).all():
        return Interval(estimate, np.nan, np.nan)
    lower, upper = _studentised(scores[:, :, None])
    return Interval(estimate, float(lower[0]), float(upper[0]))


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
    count = present.sum(axis=0)
    mean = _ratio(np.where(present, curves, 0.0).sum(axis=0), count)
    lower, upper = np.full_like(mean, np.nan), np.full_like(mean, np.nan)
    known = np.take_along_axis(curves, np.argsort(~present, axis=0, kind="stable"), axis=0)  # nan comes last
    for runs in np.unique(count[count > 1]):
        points = np.flatnonzero(count == runs)
        for block in np.array_split(points, -(-len(points) // _MOST_POINTS)):
            lower[block], upper[block] = _studentised(known[:runs, None, block])
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


def student_p(values: Float[np.ndarray, "runs"]) -> float:
    """Two-sided p of Student's t for a mean of zero; nan with fewer than two values or one that is not finite.

    The bootstrap behind the intervals cannot tell a p below one in its resamples, which is too coarse for a family of
    a hundred tests. Values that are all equal have p 0, or 1 if they are zero.
    """
    if len(values) < 2 or not np.isfinite(values).all():
        return np.nan
    if np.ptp(values) == 0:
        return float(values[0] == 0)
    scaled = values / np.abs(values).max()  # squares neither overflow nor vanish
    error = scaled.std(ddof=1) / np.sqrt(len(values))
    return float(2 * student.sf(abs(scaled.mean()) / error, len(values) - 1))


def holm(p: Sequence[float]) -> list[float]:
    """Holm's adjusted p of a family: significant at a level where it is at most that level."""
    order = np.argsort(p, kind="stable")
    factors = len(p) - np.arange(len(p))
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(np.asarray(p)[order] * factors), 1.0)
    return adjusted.tolist()


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
    """The point of a grid with the highest mean (of equal ones the first), and which points are tied with it.

    Tied are the best point and those whose paired difference to it is not significant: best minus point, over
    the seeds that both have, is not wholly above zero. There is no correction for the number of points. A point
    without a run is neither, and without any run nothing is best.
    """
    tied = np.zeros(len(points), dtype=bool)
    means = {index: float(point.values.mean()) for index, point in enumerate(points) if point.values.size}
    if not means:
        return None, tied
    best = max(means, key=lambda index: means[index])
    for index in means:
        tied[index] = index == best or not paired_difference(points[best], points[index])[0].lower > 0
    return best, tied


_TAILS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)


_LARGEST_BLOCK = 2_000_000
"""Counts that are held at once."""

_MOST_POINTS = 400
"""Of curves whose resampled means are held at once."""


def _studentised(
    scores: Float[np.ndarray, "runs tasks points"],
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """Bounds of the mean over runs and tasks, at each point for itself."""
    runs, tasks, points = scores.shape
    mean = scores.mean(axis=0)
    centred = scores - mean
    scale = np.abs(centred).max(axis=(0, 1))  # squares neither overflow nor vanish
    differ = (
        np.ptp(scores, axis=0).max(axis=0) > 0
    )  # a mean of equal numbers may differ from them by rounding
    centred = centred[:, :, differ] / scale[differ]
    variance = (centred**2).mean(axis=0).sum(axis=0)  # of the sum over tasks, times the number of runs

    def resampled(counts: np.ndarray) -> np.ndarray:
        moved, varied = np.zeros((2, len(counts), centred.shape[2]))
        for task in range(tasks):
            taken = counts[:, :, task] / runs
            shift = taken @ centred[:, task]
            moved += shift
            varied += taken @ centred[:, task] ** 2 - shift**2
        shrunk = (runs * varied.clip(0) + variance) / (runs + 1)
        return moved / np.sqrt(shrunk)

    least = student.ppf(_TAILS[1], runs - 1) / np.sqrt(runs - 1)
    low, high = np.quantile(_bootstrap((runs, tasks), resampled), _TAILS, axis=0)
    width = np.zeros((2, points))
    width[:, differ] = np.maximum([high, -low], least) * np.sqrt(variance) * scale[differ] / tasks
    centre = mean.mean(axis=0)
    return centre - width[0], centre + width[1]


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
    drawn = generator.integers(runs, size=(block * tasks, runs)) + runs * np.arange(block * tasks)[:, None]
    counts = np.bincount(drawn.reshape(-1), minlength=runs * block * tasks).reshape(block, tasks, runs)
    counts = np.ascontiguousarray(counts.swapaxes(1, 2), dtype=np.float64)
    counts.setflags(write=False)
    return counts


def _bounds(
    resampled: Float[np.ndarray, "resamples"], method: Literal["linear", "inverted_cdf"] = "linear"
) -> tuple[float, float]:
    lower, upper = np.quantile(resampled, _TAILS, method=method)
    return float(lower), float(upper)


def _ratio(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return np.divide(sums, counts, out=np.full(np.shape(sums), np.nan), where=counts > 0)
