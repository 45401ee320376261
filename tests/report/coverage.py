"""How often 95% intervals of a mean contain it: `python -m tests.report.coverage` prints the table of `statistics`."""

from collections.abc import Callable

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from gpcjax.report import statistics

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]


def bimodal(part: float) -> Draw:
    """A cart-pole that stands in this part of the runs, and falls at once in the others."""
    return lambda random, shape: 2500.0 * (random.random(shape) < part)


RETURNS: dict[str, tuple[Draw, float]] = {
    "normal": (lambda random, shape: random.normal(size=shape), 0.0),
    "exponential": (lambda random, shape: random.exponential(size=shape), 1.0),
    "0 or 2500, p = 0.1": (bimodal(0.1), 250.0),
    "0 or 2500, p = 0.5": (bimodal(0.5), 1250.0),
    "0 or 2500, p = 0.9": (bimodal(0.9), 2250.0),
}
"""By name: how runs are drawn, and the true mean."""


def covered(name: str, runs: int, samples: int, seed: int = 5) -> tuple[float, float]:
    """Of our intervals for so many samples: the part that contains the mean, and the part of samples all equal."""
    draw, mean = RETURNS[name]
    values = draw(np.random.default_rng(seed), (runs, samples))
    return _part(statistics.mean_band(values)[1:], mean), float((np.ptp(values, axis=0) == 0).mean())


def table(runs: tuple[int, ...] = (5, 10, 20, 100), samples: int = 4000) -> str:
    """Coverage in percent and mean width of each method, a row for each distribution and number of runs."""
    lines = []
    for name, (draw, mean) in RETURNS.items():
        for number in runs:
            values = draw(np.random.default_rng(5), (number, samples))
            unequal = np.ptp(values, axis=0) > 0
            normal = 2 * norm.ppf(0.975) * values.std(axis=0, ddof=1)[unequal] / np.sqrt(number)
            cells = []
            for bounds in (*_others(values), statistics.mean_band(values)[1:]):
                width = ((bounds[1] - bounds[0])[unequal] / normal).mean()
                shown = f"{width:.2f}" if width < 10 else "over 10"
                cells.append(f"{100 * _part(bounds, mean):5.1f} ({shown})")
            lines.append(f"{name:19s} {number:4d}  {100 * (1 - unequal.mean()):3.0f}%  " + "  ".join(cells))
    return "\n".join(lines)


def taken_over(samples: int = 1500) -> str:
    """Coverage in percent, and mean width, with one run fewer than where Student's t takes over, and there."""
    rare = {f"0 or 2500, p = {part}": (bimodal(part), 2500 * part) for part in (0.01, 0.002)}
    lines = []
    for name, (draw, mean) in (RETURNS | rare).items():
        cells = []
        for runs in (statistics.MANY_RUNS - 1, statistics.MANY_RUNS):
            values = draw(np.random.default_rng(5), (runs, samples))
            bounds = statistics.mean_band(values)[1:]
            cells.append(
                f"{runs:5d} runs {100 * _part(bounds, mean):5.1f} ({(bounds[1] - bounds[0]).mean():.4g})"
            )
        lines.append(f"{name:20s}  " + "  ".join(cells))
    return "\n".join(lines)


def _part(bounds: tuple[np.ndarray, np.ndarray], mean: float) -> float:
    return float(((bounds[0] <= mean) & (mean <= bounds[1])).mean())


def _others(values: np.ndarray, resamples: int = 3000) -> list[tuple[np.ndarray, np.ndarray]]:
    """Percentile, BCa, Student's t, bootstrap-t without guards."""
    runs, samples = values.shape
    counts = np.random.default_rng(1).multinomial(runs, np.full(runs, 1 / runs), size=resamples) / runs
    mean, centred = values.mean(axis=0), values - values.mean(axis=0)
    moved = np.sort(counts @ centred, axis=0)
    percentile = mean + np.quantile(moved, 0.025, axis=0), mean + np.quantile(moved, 0.975, axis=0)

    below = (moved < 0).mean(axis=0) + 0.5 * (moved == 0).mean(axis=0)
    bias = norm.ppf(below.clip(1 / resamples, 1 - 1 / resamples))
    squares = (centred**2).sum(axis=0)
    skew = np.divide((centred**3).sum(axis=0), 6 * squares**1.5, out=np.zeros(samples), where=squares > 0)
    bca = []
    for z in norm.ppf((0.025, 0.975)):
        level = norm.cdf(bias + (bias + z) / (1 - skew * (bias + z)))
        place = (level * (resamples - 1)).round().astype(int)
        bca.append(mean + np.take_along_axis(moved, place[None], axis=0)[0])

    half = student.ppf(0.975, runs - 1) * values.std(axis=0, ddof=1) / np.sqrt(runs)
    shift = counts @ centred
    error = np.sqrt((counts @ centred**2 - shift**2).clip(1e-9 * squares / runs))
    ratio = np.divide(shift, error, out=np.zeros_like(shift), where=error > 0)
    low, high = np.quantile(ratio, (0.025, 0.975), axis=0) * values.std(axis=0)
    return [percentile, (bca[0], bca[1]), (mean - half, mean + half), (mean - high, mean - low)]


if __name__ == "__main__":
    print(table())
    print(taken_over())
