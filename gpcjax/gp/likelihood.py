r"""Hyperparameters from what was taught, by marginal likelihood (thesis 2.4.2), with a length-scale for each input.

That is automatic relevance determination: Rasmussen and Williams (2006), section 5.1.

Where `gpcjax.gp.fit` fits one data set, here are many: the dictionaries of all runs, padded to one capacity and masked.
They are explained by hyperparameters of their own, or all by the same, whose log likelihood is the sum of theirs.

| symbol | here |
|---|---|
| log p(y \| X), R&W (2.30) | `log_likelihood`, in nats |
| its slope, R&W (5.9) | the rule of `_density` |
| c, l_1 ... l_d, sigma_n^2 | `variance`, `length_scales`, `noise` |
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gpcjax._x64 import under_own_settings
from gpcjax.gp import cholesky
from gpcjax.gp.fit import bent, minimise, unbent
from gpcjax.gp.kernels import SMOOTHNESSES, Kernel, closed_form, sum_of_squares
from gpcjax.gp.threads import one_thread

TOLERANCE = 1e-5
"""An ascent ends where the gradient's norm is below this, in nats a point."""

AT_BOUND = 0.01
"""Of a range of logarithms: what ends as near to a bound is reported to be there."""


class Dictionaries(NamedTuple):
    """What one model had learned in several runs, in `each` dictionaries a run (one for each action dimension)."""

    points: Float[np.ndarray, "runs each n d"]
    """Inputs, scaled by the caller; rows from the count on do not matter."""
    targets: Float[np.ndarray, "runs each n"]
    counts: Int[np.ndarray, "runs each"]
    """Points in use."""

    @property
    def active(self) -> Bool[np.ndarray, "runs each n"]:
        """Which rows are in use."""
        return np.arange(self.targets.shape[-1]) < self.counts[..., None]


class Optima(NamedTuple):
    """Hyperparameters of largest likelihood, those of all runs (`fits` is 1) or of each."""

    variance: Float[np.ndarray, " fits"]
    length_scales: Float[np.ndarray, "fits scales"]
    """One for each input, or one for all."""
    noise: Float[np.ndarray, " fits"]
    log_likelihood: Float[np.ndarray, " fits"]
    """Summed over the dictionaries of a fit, in nats."""
    at_bound: Bool[np.ndarray, "fits numbers"]
    """Which of variance, length-scales and noise, in this order, ended at a bound: the data do not tell them."""

    @property
    def numbers(self) -> Float[np.ndarray, "fits numbers"]:
        """Variance, length-scales and noise, as bounds and starts have them."""
        return np.column_stack([self.variance, self.length_scales, self.noise])


@under_own_settings
def log_likelihood(
    numbers: Float[Array, " numbers"],
    smoothness: float,
    points: Float[Array, "n d"],
    targets: Float[Array, " n"],
    active: Bool[Array, " n"],
) -> Float[Array, ""]:
    """Of the targets in use of one dictionary, in nats; it has a gradient, but no forward derivative.

    `numbers` are variance, length-scales (one for each input, or one for all) and noise. NaN if K + noise I is singular
    to rounding; 0 without points.
    """
    points, targets = jnp.where(active[:, None], points, 0.0), jnp.where(active, targets, 0.0)
    kernel = Kernel(numbers[0], jnp.ones(()), smoothness)
    scale = kernel.inverse_length / jnp.broadcast_to(numbers[1:-1], points.shape[1:])
    squared = sum_of_squares(column[:, None] - column[None] for column in (points * scale[None]).T)
    # A root has no slope at 0, where the correlation is 1 whatever the length-scale.
    both = active[:, None] & active[None]
    apart = (squared > 0) & both
    gram = kernel.variance * jnp.where(apart, closed_form(jnp.where(apart, squared, 1.0), smoothness), 1.0)
    diagonal = jnp.diag(jnp.where(active, numbers[-1], 1.0))
    return _density(jnp.where(both, gram, 0.0) + diagonal, targets, active)


@jax.custom_vjp
def _density(
    matrix: Float[Array, "n n"], targets: Float[Array, " n"], active: Bool[Array, " n"]
) -> Float[Array, ""]:
    """Log density of `targets`, zero where not in use, with covariance `matrix`, the identity there: R&W (2.30)."""
    return _density_and_weights(matrix, targets, active)[0]


def _density_and_weights(
    matrix: Float[Array, "n n"], targets: Float[Array, " n"], active: Bool[Array, " n"]
) -> tuple[Float[Array, ""], tuple[Float[Array, " n"], Float[Array, "n n"]]]:
    lower = cholesky.factor(matrix, jnp.ones(active.shape, bool), jnp.zeros(()))
    inverted = cholesky.inverse(lower)
    whitened = inverted @ targets
    entropy = jnp.log(jnp.diag(lower)).sum() + 0.5 * active.sum() * jnp.log(2.0 * jnp.pi)
    return -0.5 * (whitened * whitened).sum() - entropy, (whitened @ inverted, inverted)


def _slope_of_density(
    kept: tuple[Float[Array, " n"], Float[Array, "n n"]], change: Float[Array, ""]
) -> tuple[Float[Array, "n n"], Float[Array, " n"], None]:
    """R&W (5.9): half of a a^T - K^-1, where a are the weights. A third of what the derivative of a factor takes."""
    weights, inverted = kept
    matrix = 0.5 * (weights[:, None] * weights[None] - inverted.T @ inverted)
    return change * matrix, -change * weights, None


_density.defvjp(_density_and_weights, _slope_of_density)


@under_own_settings
def fit_dictionaries(
    data: Dictionaries,
    smoothness: float,
    bounds: Float[np.ndarray, "..."],
    starts: Float[np.ndarray, "..."],
    shared: bool = True,
) -> Optima:
    """Variance, length-scales and noise of largest marginal likelihood, by L-BFGS from each of `starts`.

    Args:
        data: what is to be explained.
        smoothness: of the kernel, one of `gpcjax.gp.kernels.SMOOTHNESSES`; it is not fitted.
        bounds: (numbers, 2), least and largest variance, length-scales (one for each input, or a single one for all)
            and noise.
        starts: (starts, numbers), where to climb from, in the same order.
        shared: the same hyperparameters for all runs; otherwise those of each.

    Raises:
        ValueError: shapes that do not fit, a fit with fewer than two points, numbers that are not finite, bounds out of
            order, a smoothness without a closed form, or data that no start can explain.
    """
    _check(data, smoothness, bounds, starts, shared)
    if shared:  # all dictionaries as those of one run
        data = Dictionaries(*(leaf.reshape(1, -1, *leaf.shape[2:]) for leaf in data))
    logs = np.log(bounds), np.log(starts)
    with one_thread():
        ends = _climb(smoothness, data.points, data.targets, data.active, *logs)
        numbers, values = map(np.asarray, jax.block_until_ready(ends))
    found = np.where(np.isfinite(values) & np.isfinite(numbers).all(-1), values, -np.inf)
    if not np.isfinite(found.max(1)).all():
        raise ValueError("no start has a finite likelihood: raise the least noise in bounds")
    best = found.argmax(1)
    every = np.arange(len(best))
    low, high = np.log(bounds).T
    end = np.log(numbers[every, best])
    edge = AT_BOUND * (high - low)
    inside = np.clip(numbers[every, best], *bounds.T)  # rounded by exp
    return Optima(
        variance=inside[:, 0],
        length_scales=inside[:, 1:-1],
        noise=inside[:, -1],
        log_likelihood=found[every, best],
        at_bound=(end < low + edge) | (end > high - edge),
    )


def _check(
    data: Dictionaries,
    smoothness: float,
    bounds: Float[np.ndarray, "..."],
    starts: Float[np.ndarray, "..."],
    shared: bool,
) -> None:
    """Raises ValueError."""
    points, targets, counts = data
    if smoothness not in SMOOTHNESSES:
        raise ValueError(f"smoothness nu = {smoothness}: closed forms exist for {SMOOTHNESSES}")
    if points.ndim != 4 or targets.shape != points.shape[:3] or counts.shape != points.shape[:2]:
        raise ValueError(
            f"points {points.shape}, targets {targets.shape}, counts {counts.shape}: give (runs, each, n, d), "
            "(runs, each, n) and (runs, each)"
        )
    if (counts.sum() if shared else counts.sum(1).min(initial=2)) < 2 or counts.max() > points.shape[2]:
        raise ValueError("a fit needs two points, and a dictionary cannot hold more than it has room for")
    if not (np.isfinite(points[data.active]).all() and np.isfinite(targets[data.active]).all()):
        raise ValueError("points and targets must be finite")
    if bounds.shape not in ((3, 2), (points.shape[3] + 2, 2)):
        raise ValueError(
            f"bounds {bounds.shape}: give two for each of variance, length-scales and noise, (3, 2) or "
            f"({points.shape[3] + 2}, 2)"
        )
    if not (np.isfinite(bounds).all() and (bounds[:, 0] > 0).all() and (bounds[:, 0] < bounds[:, 1]).all()):
        raise ValueError("bounds: give 0 < least < largest for each of variance, length-scales and noise")
    if starts.ndim != 2 or not len(starts) or starts.shape[1] != len(bounds) or not (starts > 0).all():
        raise ValueError("starts: give rows of positive variance, length-scales and noise")


@jax.jit(static_argnums=0)
def _climb(
    smoothness: float,
    points: Float[Array, "fits each n d"],
    targets: Float[Array, "fits each n"],
    active: Bool[Array, "fits each n"],
    limits: Float[Array, "numbers 2"],
    starts: Float[Array, "starts numbers"],
) -> tuple[Float[Array, "fits starts numbers"], Float[Array, "fits starts"]]:
    """Hyperparameters and log likelihood at the end of each ascent. `limits` and `starts` are logarithms."""
    low, width = limits[:, 0], limits[:, 1] - limits[:, 0]

    def one_fit(data: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        total = jnp.maximum(data[2].sum(), 1)
        begin = jax.vmap(lambda start: unbent(start, low, width))(starts)

        def loss(free: Float[Array, " numbers"]) -> Float[Array, ""]:
            """A point's mean, so that its slope does not grow with the data."""
            explained: Array = _summed(jnp.exp(bent(free, low, width)), smoothness, *data)
            return -explained / total

        def ascend(start: Float[Array, " numbers"]) -> tuple[Array, Array]:
            free = minimise(loss, start, TOLERANCE)
            return jnp.exp(bent(free, low, width)), -total * loss(free)

        return jax.lax.map(ascend, begin)

    # One after the other: together, all would take as many steps, and as many in a line search, as the longest, and a
    # factor is computed alone in any case (`cholesky.one_at_a_time`).
    return jax.lax.map(one_fit, (points, targets, active))


@functools.partial(jax.custom_vjp, nondiff_argnums=(1,))
def _summed(
    numbers: Float[Array, " numbers"],
    smoothness: float,
    points: Float[Array, "each n d"],
    targets: Float[Array, "each n"],
    active: Bool[Array, "each n"],
) -> Float[Array, ""]:
    """The log likelihood of several dictionaries."""
    return _summed_with_slope(numbers, smoothness, points, targets, active)[0]


def _summed_with_slope(
    numbers: Float[Array, " numbers"],
    smoothness: float,
    points: Float[Array, "each n d"],
    targets: Float[Array, "each n"],
    active: Bool[Array, "each n"],
) -> tuple[Float[Array, ""], Float[Array, " numbers"]]:
    """Both at once, one dictionary after the other: kept for later, a slope would take n^2 numbers of each."""

    def one(data: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        return jax.value_and_grad(log_likelihood)(numbers, smoothness, *data)

    values, slopes = jax.lax.map(one, (points, targets, active))
    return values.sum(), slopes.sum(0)


def _slope_of_sum(
    smoothness: float, slope: Float[Array, " numbers"], change: Float[Array, ""]
) -> tuple[Float[Array, " numbers"], None, None, None]:
    return change * slope, None, None, None


_summed.defvjp(_summed_with_slope, _slope_of_sum)
