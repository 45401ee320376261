"""Resamples of runs and what they bound: the bootstrap behind `gpcjax.report.statistics`, which says why."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from gpcjax.report.distributions import student_quantile

RESAMPLES = 5000
LEVEL = 0.95
BOOTSTRAP_SEED = 20190312
TAILS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)

MANY_RUNS = 5000
"""From so many runs on nothing is resampled: a mean has Student's interval, a median that of order statistics."""

MOST_POINTS = 400
"""Samples of the same number of runs whose resamples are held at once."""

_LARGEST_BLOCK = 2_000_000
"""Counts that are held at once."""


def studentised(
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

    least = student_quantile(TAILS[1], runs - 1) / np.sqrt(runs - 1)
    sides = np.full((2, len(variance)), least)
    if runs < MANY_RUNS:
        low, high = np.quantile(_bootstrap((runs, tasks), resampled), TAILS, axis=0)
        sides = np.maximum([high, -low], least)
    width = np.zeros((2, points))
    width[:, differ] = sides * np.sqrt(variance) * scale[differ] / tasks
    centre = mean.mean(axis=0)
    return centre - width[0], centre + width[1]


def median_bounds(
    samples: Sequence[Float[np.ndarray, "runs"]],
) -> tuple[Float[np.ndarray, "samples"], Float[np.ndarray, "samples"]]:
    """Bounds of the median of each sample; all of them have as many runs. Between two draws nothing is interpolated.

    A resample has taken `counts @ (sample <= value)` runs of at most a value. These are whole numbers, and in one
    product as exact as in a sum for each sample; times are few, so that a sample has few values.
    """
    runs = len(samples[0])
    known = [np.unique(sample) for sample in samples]
    bounds = np.array([[values[0]] * 2 for values in known]).T  # of runs that are all equal
    open_ = [place for place, values in enumerate(known) if len(values) > 1]
    for block in _blocks(open_, [len(known[place]) - 1 for place in open_]):
        columns = np.concatenate(
            [samples[place][:, None] <= known[place][None, :-1] for place in block], axis=1
        ).astype(np.float32)  # numbers up to 2^24 are exact
        starts = np.cumsum([0, *(len(known[place]) - 1 for place in block[:-1])])
        offsets = np.cumsum([0, *(len(known[place]) for place in block[:-1])])
        values = np.concatenate([known[place] for place in block])

        def resampled(
            counts: np.ndarray,
            columns: np.ndarray = columns,
            starts: np.ndarray = starts,
            offsets: np.ndarray = offsets,
            values: np.ndarray = values,
        ) -> np.ndarray:
            taken = counts[:, :, 0].astype(np.float32) @ columns
            lower, upper = (
                values[offsets + np.add.reduceat(taken <= middle, starts, axis=1, dtype=np.int64)]
                for middle in ((runs - 1) // 2, runs // 2)
            )
            return np.where(lower == upper, lower, (lower + upper) / 2)

        medians = _bootstrap((runs, 1), resampled)
        bounds[:, block] = np.quantile(medians, TAILS, axis=0, method="inverted_cdf")
    lower, upper = bounds
    return lower, upper


def _blocks(places: Sequence[int], widths: Sequence[int]) -> list[list[int]]:
    """The places in order, in blocks that are together no wider than `MOST_POINTS`, or hold one place."""
    blocks: list[list[int]] = []
    room = 0
    for place, width in zip(places, widths, strict=True):
        if width > room:
            blocks.append([])
            room = MOST_POINTS
        blocks[-1].append(place)
        room -= width
    return blocks


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
