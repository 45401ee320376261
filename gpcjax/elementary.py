"""The innermost functions of kernels and tasks, written so that XLA vectorises the loops around them on a CPU.

There, XLA calls libm for every single sine, and its own exponential keeps some loops around it from being
vectorised. These are polynomials without branches or tables, as accurate as the library's. In the batched loop a
cart-pole's step takes a third and a policy's mean half of the time (`benchmarks/README.md`). Other devices use their
own functions.

XLA takes a polynomial for cheap, and may compute it anew in each loop that uses it: not for values that many use.
"""

import math

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

import gpcjax._x64  # noqa: F401

_SHIFT = 1.5 * 2.0**52
"""Added to a small integer, it leaves that integer in the lowest bits of the sum."""

_LOG2_E = 1.4426950408889634
# Constants in parts: the first have so few digits that their product with a small integer is exact.
_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_HALF_PI = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21

_EXP = [1.0 / math.factorial(k) for k in range(13)]
_SIN = [(-1) ** k / math.factorial(2 * k + 1) for k in range(8)]
_COS = [(-1) ** k / math.factorial(2 * k) for k in range(9)]
"""Taylor coefficients; on the short intervals where they are used the rest is below 1e-16."""

_SMALLEST = -708.0
"""exp(-708) = 3e-308: what is smaller is no normal number, and taken for zero."""


@jax.custom_jvp
def decay(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """exp(-x) for x >= 0, to a relative error of 1e-15; zero where x > 708. NaN stays NaN."""
    return lax.platform_dependent(x, cpu=_decay, default=lambda x: jnp.exp(-x))


@jax.custom_jvp
def sin_cos(x: Float[Array, "*shape"]) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Sine and cosine, to an absolute error of 1e-15 for |x| < 1e6. NaN stays NaN."""
    return lax.platform_dependent(x, cpu=_sin_cos, default=lambda x: (jnp.sin(x), jnp.cos(x)))


@jax.custom_jvp
def tanh(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The hyperbolic tangent, to an absolute error of 1e-15. NaN stays NaN."""
    small = decay(2.0 * jnp.abs(x))
    return jnp.sign(x) * (1.0 - small) / (1.0 + small)


@decay.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    value = decay(*primals)
    return value, -value * tangents[0]


@tanh.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    value = tanh(*primals)
    return value, (1.0 - value * value) * tangents[0]


@sin_cos.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    sin, cos = sin_cos(*primals)
    return (sin, cos), (cos * tangents[0], -sin * tangents[0])


def _decay(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    x = -x
    limited = jnp.maximum(x, _SMALLEST)
    power = _nearest(limited * _LOG2_E)
    value = _horner(_EXP, (limited - power * _LN2[0]) - power * _LN2[1])
    value = lax.bitcast_convert_type(
        lax.bitcast_convert_type(value, jnp.int64) + (_low_bits(power) << 52), value.dtype
    )
    return jnp.where(x < _SMALLEST, 0.0, value)


def _sin_cos(x: Float[Array, "*shape"]) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    turns = _nearest(x * (2.0 / math.pi))
    rest = ((x - turns * _HALF_PI[0]) - turns * _HALF_PI[1]) - turns * _HALF_PI[2]
    square = rest * rest
    sin, cos = rest * _horner(_SIN, square), _horner(_COS, square)
    quarter = _low_bits(turns)
    odd = (quarter & 1) == 1
    sin, cos = jnp.where(odd, cos, sin), jnp.where(odd, sin, cos)
    return jnp.where((quarter & 2) == 2, -sin, sin), jnp.where(((quarter + 1) & 2) == 2, -cos, cos)


def _nearest(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    return lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN)


def _low_bits(integer: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """A small integer, in the lowest bits of the result; a conversion would not vectorise."""
    return lax.bitcast_convert_type(integer + _SHIFT, jnp.int64)


def _horner(coefficients: list[float], x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
