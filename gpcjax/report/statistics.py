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

From 5,000 runs on nothing is resampled: Student's t is the interval of a mean, and a median lies between two order
statistics (`median_band`). Percent of 1,500 samples, by the same module, with the mean width in brackets:

| returns | bootstrap-t, 4,999 runs | Student's t, 5,000 runs |
|---|---|---|
| normal | 95.8 (0.0559) | 95.7 (0.0554) |
| exponential | 95.3 (0.0561) | 95.1 (0.0554) |
| 2500 in 1 of 10 | 95.5 (42.2) | 95.4 (41.6) |
| 2500 in half | 94.5 (69.8) | 94.5 (69.3) |
| 2500 in 9 of 10 | 95.7 (42.2) | 95.5 (41.6) |
| 2500 in 1 of 100 | 95.7 (14.6) | 94.6 (13.8) |
| 2500 in 1 of 500 | 97.5 (8.42) | 93.2 (6.10) |

What differs is the upper side of outcomes so rare that ten of all runs have them.

The draws are counts of how often each run was taken; they depend on the number of runs and a fixed seed alone, so that
the same store gives the same table. Medians, of times until something happens and of learning rates, keep percentile
and order-statistic intervals.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from gpcjax.report import bootstrap
from gpcjax.report.bootstrap import LEVEL, MANY_RUNS, RESAMPLES, TAILS, median_bounds, studentised
from gpcjax.report.distributions import fair_binomial_quantile, student_tail

__all__ = ["LEVEL", "MANY_RUNS", "RESAMPLES"]

LARGEST_SAMPLE = 10_000_000
"""Scores of which intervals are made at once: what is computed of them takes several times their memory."""


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
    lower, upper = studentised(scores[:, :, None])
    return Interval(estimate, float(lower[0]), float(upper[0]))


def mean_intervals(samples: Sequence[Float[np.ndarray, "runs"]]) -> list[Interval]:
    """Mean of each sample, as `mean_interval` has it up to rounding: those with as many runs share a product."""
    estimates = [float(sample.mean()) if sample.size else np.nan for sample in samples]
    bounds = np.full((2, len(samples)), np.nan)
    bounded = [place for place, sample in enumerate(samples) if np.isfinite(sample).all()]
    for block in _alike(samples, bounded):
        bounds[:, block] = studentised(np.stack([samples[place] for place in block], axis=-1)[:, None])
    return [Interval(*numbers) for numbers in zip(estimates, *bounds.tolist(), strict=True)]


def median_interval(times: Float[np.ndarray, "runs"]) -> Interval:
    """Median of `times`, among which inf stands for never: the median is inf once half of them are."""
    return median_intervals([times])[0]


def median_intervals(samples: Sequence[Float[np.ndarray, "runs"]]) -> list[Interval]:
    """Median of each sample of times, to the bit as `median_interval` has it."""
    estimates, bounds = [_median(times) for times in samples], np.full((2, len(samples)), np.nan)
    known = [place for place, times in enumerate(samples) if not np.isnan(times).any()]
    for block in _alike(samples, known):
        if len(samples[block[0]]) < MANY_RUNS:
            bounds[:, block] = median_bounds([samples[place] for place in block])
        else:
            bounds[:, block] = median_band(np.stack([samples[place] for place in block], axis=-1))[1:]
    return [Interval(*numbers) for numbers in zip(estimates, *bounds.tolist(), strict=True)]


def _median(times: Float[np.ndarray, "runs"]) -> float:
    if not times.size:
        return np.nan
    ordered, middle = np.sort(times), np.array([(times.size - 1) // 2, times.size // 2])
    return float(ordered[middle].mean())


def _alike(samples: Sequence[np.ndarray], places: Iterable[int]) -> Iterator[list[int]]:
    """These of the samples in blocks of as many runs, which are two or more."""
    found: dict[int, list[int]] = {}
    for place in places:
        found.setdefault(len(samples[place]), []).append(place)
    for runs, members in found.items():
        if runs > 1:
            most = _together(runs)
            yield from (members[start : start + most] for start in range(0, len(members), most))


def _together(runs: int) -> int:
    """Samples of so many runs whose intervals are made at once."""
    return max(1, min(bootstrap.MOST_POINTS, LARGEST_SAMPLE // runs))


def mean_band(curves: Float[np.ndarray, "runs points"]) -> Band:
    """Mean over runs at each point, with its interval; nan is where a run has no value and counts nowhere."""
    present = ~np.isnan(curves)
    count = present.sum(axis=0)
    mean = _ratio(np.where(present, curves, 0.0).sum(axis=0), count)
    lower, upper = np.full_like(mean, np.nan), np.full_like(mean, np.nan)
    if not present.all():  # nan comes last
        curves = np.take_along_axis(curves, np.argsort(~present, axis=0, kind="stable"), axis=0)
    for runs in np.unique(count[count > 1]):
        points = np.flatnonzero(count == runs)
        for block in np.array_split(points, -(-len(points) // _together(int(runs)))):
            lower[block], upper[block] = studentised(curves[:runs, None, block])
    return Band(mean, lower, upper)


def median_band(curves: Float[np.ndarray, "runs points"]) -> Band:
    """Median over runs at each point, with a 95% interval; nan is where a run has no value and counts nowhere.

    The interval lies between two order statistics (binomial with p = 1/2), so that it holds for any distribution:
    what a few runs do that diverge moves neither it nor the median. `Band.mean` holds the median.
    """
    ordered = np.sort(curves, axis=0)  # nan comes last
    count = (~np.isnan(curves)).sum(axis=0)
    below = np.maximum(fair_binomial_quantile(TAILS[0], count), 1).astype(int) - 1
    point = np.arange(curves.shape[1])
    last = np.maximum(count - 1, 0)
    middle = (ordered[last // 2, point] + ordered[np.minimum(count // 2, last), point]) / 2
    lower, upper = ordered[np.minimum(below, last), point], ordered[np.maximum(last - below, 0), point]
    return Band(middle, lower, upper)


def paired_difference(first: Scores, second: Scores) -> tuple[Interval, int]:
    """Mean of first minus second over the seeds that both have, and how many those are."""
    differences = _differences(first, second)
    return mean_interval(differences[:, None]), len(differences)


def paired_differences(pairs: Sequence[tuple[Scores, Scores]]) -> list[tuple[Interval, int]]:
    """The same of each pair, up to rounding."""
    differences = [_differences(*pair) for pair in pairs]
    return list(zip(mean_intervals(differences), map(len, differences), strict=True))


def _differences(first: Scores, second: Scores) -> Float[np.ndarray, "pairs"]:
    if np.array_equal(first.seeds, second.seeds):
        return first.values - second.values
    _, mine, theirs = np.intersect1d(first.seeds, second.seeds, assume_unique=True, return_indices=True)
    return first.values[mine] - second.values[theirs]


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
    return float(2 * student_tail(abs(scaled.mean()) / error, len(values) - 1))


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
    others = [index for index in means if index != best]
    found = paired_differences([(points[best], points[index]) for index in others])
    tied[others] = [not difference.lower > 0 for difference, _ in found]
    tied[best] = True
    return best, tied


def _ratio(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return np.divide(sums, counts, out=np.full(np.shape(sums), np.nan), where=counts > 0)
