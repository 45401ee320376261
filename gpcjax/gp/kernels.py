"""Stationary kernels: the squared exponential (3.3) and the Matern family (3.4) of the thesis, in closed form.

Notation: c is the signal variance, l the length-scale, nu the smoothness, r the Euclidean distance of two inputs
that the caller has already scaled per dimension.
"""

import functools
import math
import operator
from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import gpcjax._x64  # noqa: F401
from gpcjax.elementary import decay
from gpcjax.gp.smoothness import SMOOTHNESSES as SMOOTHNESSES
from gpcjax.gp.smoothness import SQUARED_EXPONENTIAL as SQUARED_EXPONENTIAL


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def correlation(squared: Float[Array, "*shape"], smoothness: float) -> Float[Array, "*shape"]:
    """`closed_form`, with derivatives also at distance zero, where that of a root is infinite.

    For nu = 0.5, which has a cusp there, this derivative is zero, as from both sides together.
    """
    return closed_form(squared, smoothness)


@correlation.defjvp
def _(smoothness: float, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (squared,), (change,) = primals, tangents
    if smoothness == SQUARED_EXPONENTIAL:
        slope = -0.5 * correlation(squared, smoothness)
    elif smoothness == 0.5:
        apart = squared > 0
        slope = jnp.where(
            apart, -0.5 * correlation(squared, 0.5) / jnp.sqrt(jnp.where(apart, squared, 1.0)), 0.0
        )
    elif smoothness == 1.5:
        slope = -0.5 * correlation(squared, 0.5)
    else:
        slope = correlation(squared, 1.5) / -6.0
    return correlation(squared, smoothness), slope * change


def closed_form(squared: Float[Array, "*shape"], smoothness: float) -> Float[Array, "*shape"]:
    """Correlation at a squared distance that is already divided by `stretch(smoothness) ** 2 * l ** 2`.

    One branch per smoothness, chosen at trace time:
    0.5: exp(-d); 1.5: (1 + d) exp(-d); 2.5: (1 + d + d^2/3) exp(-d); infinity: exp(-d^2/2).
    """
    if smoothness == SQUARED_EXPONENTIAL:
        return decay(0.5 * squared)
    distance = jnp.sqrt(squared)
    falling = decay(distance)
    if smoothness == 0.5:
        return falling
    if smoothness == 1.5:
        return (1.0 + distance) * falling
    return (1.0 + distance + squared / 3.0) * falling


class Kernel(eqx.Module):
    """`variance * correlation(r / length_scale)`, the thesis' ConstantKernel times SE or Matern.

    Fields:
        variance: c_h or c_p, a variance (not a standard deviation), in units of action or advice squared.
        length_scale: l_h or l_p, in units of the scaled inputs.
        smoothness: nu of (3.4), one of `SMOOTHNESSES`; infinity is the squared exponential (3.3). Static.
    """

    variance: Float[Array, ""]
    length_scale: Float[Array, ""]
    smoothness: float = eqx.field(static=True)

    def __check_init__(self):
        if self.smoothness not in SMOOTHNESSES:
            raise ValueError(f"smoothness nu = {self.smoothness}: closed forms exist for {SMOOTHNESSES}")

    @property
    def inverse_length(self) -> Float[Array, ""]:
        """What inputs are multiplied by so that `correlation` takes their squared distance."""
        root = 1.0 if self.smoothness == SQUARED_EXPONENTIAL else math.sqrt(2.0 * self.smoothness)
        return root / self.length_scale

    def covariances(
        self, points: Float[Array, "n d"], point: Float[Array, " d"], scale: Float[Array, " d"]
    ) -> Float[Array, " n"]:
        """k(x_i, x) for each row of `points`; inputs are multiplied by `scale` first.

        Distances come from differences: the dot-product form loses half of the digits for near repeats.
        """
        factor = scale * self.inverse_length
        return self.of_differences((points[:, i] - point[i]) * factor[i] for i in range(points.shape[1]))

    def gram(self, points: Float[Array, "n d"], scale: Float[Array, " d"]) -> Float[Array, "n n"]:
        """k(x_i, x_j) for all pairs of rows."""
        columns = (points * (scale * self.inverse_length)[None]).T
        return self.of_differences(column[:, None] - column[None] for column in columns)

    def of_differences(self, differences: Iterable[Float[Array, "*shape"]]) -> Float[Array, "*shape"]:
        """The covariances of pairs that differ so in each dimension, of inputs that are multiplied already."""
        return self.variance * correlation(sum_of_squares(differences), self.smoothness)


def sum_of_squares(differences: Iterable[Float[Array, "*shape"]]) -> Float[Array, "*shape"]:
    """Added up term by term: a reduction over a short last axis would not vectorise on a CPU."""
    return functools.reduce(operator.add, (difference * difference for difference in differences))
