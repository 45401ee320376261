"""Hyperparameters of a Gaussian process by maximising its log marginal likelihood (thesis 2.4.2).

The likelihood is that of Rasmussen and Williams (2006), (2.30) and section 5.4.1. It has several maxima, so L-BFGS
climbs from several starting points and the best end is taken.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from gpcjax._x64 import under_own_settings
from gpcjax.gp import cholesky
from gpcjax.gp.kernels import Kernel, closed_form, sum_of_squares

BOUNDS = ((1e-5, 1e5), (1e-5, 1e5), (1e-5, 1e5))
"""Least and largest variance, length-scale and noise: scikit-learn's defaults."""

MOST_STEPS = 200
TOLERANCE = 1e-8
"""An ascent ends where the gradient's norm is below this."""


class Fit(NamedTuple):
    """Hyperparameters and how well they explain the data."""

    kernel: Kernel
    noise: Float[Array, ""]
    """Variance of the observation noise, in units of the targets squared."""
    log_likelihood: Float[Array, ""]


@under_own_settings
def log_marginal_likelihood(
    kernel: Kernel, noise: Float[Array, ""], points: Float[Array, "n d"], targets: Float[Array, " n"]
) -> Float[Array, ""]:
    """Of targets given points, log p(y | X) of a zero-mean process, in nats: R&W (2.30); it can be differentiated.

    Points (n, d) are scaled by the caller; targets (n,). NaN if K + noise I is singular to rounding.
    """
    squared = sum_of_squares(column[:, None] - column[None] for column in points.T)
    # A root has no slope at 0, where the correlation is 1 whatever the length-scale: `Kernel.gram` would give NaN.
    apart = squared > 0
    nearby = closed_form(jnp.where(apart, squared, 1.0) * kernel.inverse_length**2, kernel.smoothness)
    gram = kernel.variance * jnp.where(apart, nearby, 1.0)
    lower = cholesky.factor(gram, jnp.ones(targets.shape, bool), noise)
    whitened = cholesky.solve(lower, targets)
    log_determinant = 2.0 * jnp.log(jnp.diag(lower)).sum()
    return -0.5 * ((whitened * whitened).sum() + log_determinant + targets.size * jnp.log(2.0 * jnp.pi))


@under_own_settings
def fit(
    points: Real[ArrayLike, "..."],
    targets: Real[ArrayLike, "..."],
    smoothness: float,
    bounds: Sequence[tuple[float, float]] = BOUNDS,
    starts: Real[ArrayLike, "..."] | Sequence[tuple[float, float, float]] | None = None,
) -> Fit:
    """Variance, length-scale and noise of largest marginal likelihood (thesis 2.4.2; R&W 5.4.1).

    Args:
        points: (n, d), inputs, scaled by the caller: one length-scale serves all dimensions.
        targets: (n,), outputs, about zero: the process has no mean.
        smoothness: of the kernel, one of `gpcjax.gp.kernels.SMOOTHNESSES`; it is not fitted.
        bounds: (least, largest) of variance, length-scale and noise, which stay within.
        starts: (k, 3), variance, length-scale and noise to climb from; by default `starting_points` of the data.

    Raises:
        ValueError: shapes that do not fit, fewer than two points, numbers that are not finite, bounds out of order, a
            smoothness without a closed form, or data that no start can explain (K + noise I is singular everywhere).
    """
    inputs, outputs = np.asarray(points, float), np.asarray(targets, float)
    if inputs.ndim != 2 or outputs.shape != inputs.shape[:1] or len(inputs) < 2:
        raise ValueError(
            f"points {inputs.shape} and targets {outputs.shape}: give (n, d) and (n,), n at least 2"
        )
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        raise ValueError("points and targets must be finite")
    limits = np.asarray(bounds, float)
    if limits.shape != (3, 2) or not ((limits[:, 0] > 0) & (limits[:, 0] < limits[:, 1])).all():
        raise ValueError(
            f"bounds {bounds}: give 0 < least < largest for each of variance, length-scale, noise"
        )
    begin = starting_points(inputs, outputs) if starts is None else np.asarray(starts, float)
    if begin.ndim != 2 or begin.shape[1] != 3 or not (begin > 0).all():
        raise ValueError("starts: give rows of positive variance, length-scale and noise")
    ends = _climb_from_each(smoothness, inputs, outputs, np.log(limits), np.log(begin))
    numbers, values = map(np.asarray, ends)
    if not np.isfinite(values).any():
        raise ValueError("no starting point has a finite likelihood: raise the least noise in bounds")
    best = int(np.nanargmax(np.where(np.isfinite(values), values, np.nan)))
    inside = np.clip(numbers[best], limits[:, 0], limits[:, 1])  # rounded by exp
    variance, length_scale, noise, value = (jnp.asarray(each) for each in (*inside, values[best]))
    return Fit(Kernel(variance, length_scale, smoothness), noise, value)


def starting_points(
    points: Float[np.ndarray, "n d"], targets: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "6 3"]:
    """Explanations between all signal and much noise, rough and smooth, in the units of the data."""
    power = max(float((targets**2).mean()), 1e-10)
    spread = max(float(np.sqrt(2.0 * points.var(0).sum())), 1e-10)  # root mean square distance of two points
    return np.array(
        [[power, share * spread, noise * power] for share in (0.1, 0.3, 1.0) for noise in (1e-4, 0.1)]
    )


@jax.jit(static_argnums=0)
def _climb_from_each(
    smoothness: float,
    points: Float[Array, "n d"],
    targets: Float[Array, " n"],
    limits: Float[Array, "3 2"],
    starts: Float[Array, "starts 3"],
) -> tuple[Float[Array, "starts 3"], Float[Array, " starts"]]:
    """Hyperparameters and log likelihood at the end of each ascent. `limits` and `starts` are logarithms."""
    low, width = limits[:, 0], limits[:, 1] - limits[:, 0]

    def hyperparameters(free: Float[Array, "3"]) -> Float[Array, "3"]:
        return jnp.exp(bent(free, low, width))

    def loss(free: Float[Array, "3"]) -> Float[Array, ""]:
        variance, length_scale, noise = hyperparameters(free)
        return -log_marginal_likelihood(Kernel(variance, length_scale, smoothness), noise, points, targets)

    def ascend(start: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, ""]]:
        free = minimise(loss, unbent(start, low, width))
        return hyperparameters(free), -loss(free)

    # One after the other: together, all would take as many steps, and as many in a line search, as the longest.
    return jax.lax.map(ascend, starts)


def bent(free: Float[Array, " p"], low: Float[Array, " p"], width: Float[Array, " p"]) -> Float[Array, " p"]:
    """L-BFGS knows no bounds: it moves logarithms that a sigmoid bends into their ranges, of slope 1 halfway."""
    return low + width * jax.nn.sigmoid(4.0 / width * free)


def unbent(
    start: Float[Array, " p"], low: Float[Array, " p"], width: Float[Array, " p"]
) -> Float[Array, " p"]:
    """What is bent to `start`, or where that is at a bound or beyond, to just within: at a bound there is no slope."""
    share = jnp.clip((start - low) / width, 1e-3, 1.0 - 1e-3)
    return 0.25 * width * (jnp.log(share) - jnp.log1p(-share))


def minimise(
    loss: Callable[[Float[Array, " p"]], Float[Array, ""]],
    start: Float[Array, " p"],
    tolerance: float = TOLERANCE,
) -> Float[Array, " p"]:
    """L-BFGS with its zoom line search, until the gradient's norm is below `tolerance` or `MOST_STEPS`."""
    import optax  # takes a sixteenth of a worker's start

    optimiser = optax.lbfgs()
    value_and_gradient = optax.value_and_grad_from_state(loss)

    def unfinished(carry: tuple) -> Array:
        steps, slope = carry[2:]
        return (steps < MOST_STEPS) & (slope >= tolerance)

    def step(carry: tuple) -> tuple:
        parameters, state, steps, _ = carry
        value, gradient = value_and_gradient(parameters, state=state)
        updates, state = optimiser.update(
            gradient, state, parameters, value=value, grad=gradient, value_fn=loss
        )
        return optax.apply_updates(parameters, updates), state, steps + 1, jnp.linalg.norm(gradient)

    begin = (start, optimiser.init(start), jnp.zeros((), jnp.int32), jnp.asarray(jnp.inf))
    return jax.lax.while_loop(unfinished, step, begin)[0]
