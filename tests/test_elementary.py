"""The polynomials against numpy's functions, at extended precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.elementary import decay, sin_cos, tanh

decay_of, sin_cos_of, tanh_of = map(jax.jit, (decay, sin_cos, tanh))


def test_decay_is_as_accurate_as_a_library():
    x = np.concatenate(
        [[0.0, 1e-300, 1e-17, 707.99], np.linspace(0, 40, 40_001), np.geomspace(1e-12, 707, 40_001)]
    )
    exact = np.exp(-x.astype(np.longdouble))
    assert np.abs(np.asarray(decay_of(x)) / exact - 1).max() < 1e-15


def test_decay_at_its_ends():
    """One at zero; zero from where a number would no longer be normal; NaN stays."""
    ends = decay_of(np.array([0.0, 709.0, 1e300, np.inf, np.nan]))
    np.testing.assert_array_equal(ends, [1.0, 0.0, 0.0, 0.0, np.nan])


@pytest.mark.parametrize("reach", [0.3, 10.0, 1e6])
def test_sine_and_cosine_are_as_accurate_as_a_library(reach):
    x = np.random.default_rng(0).uniform(-reach, reach, 100_000)
    sin, cos = sin_cos_of(x)
    exact = x.astype(np.longdouble)
    assert np.abs(np.asarray(sin) - np.sin(exact)).max() < 1e-15
    assert np.abs(np.asarray(cos) - np.cos(exact)).max() < 1e-15


def test_sine_and_cosine_at_multiples_of_a_quarter_turn():
    """Every quadrant, and signs."""
    x = np.arange(-9, 10) * np.pi / 2
    sin, cos = sin_cos_of(np.append(x, np.nan))
    np.testing.assert_allclose(sin, np.sin(np.append(x, np.nan)), atol=1e-15)
    np.testing.assert_allclose(cos, np.cos(np.append(x, np.nan)), atol=1e-15)


def test_derivatives():
    """Written by hand, as rounding and bits have none."""
    x = jnp.asarray(0.7)
    assert jax.grad(decay)(x) == pytest.approx(-np.exp(-x), rel=1e-15)
    assert jax.grad(lambda x: sin_cos(x)[0])(x) == pytest.approx(np.cos(x), rel=1e-15)
    assert jax.grad(lambda x: sin_cos(x)[1])(x) == pytest.approx(-np.sin(x), rel=1e-15)
    assert jax.grad(jax.grad(decay))(x) == pytest.approx(np.exp(-x), rel=1e-15)


def test_in_a_batch_and_compiled():
    x = jnp.linspace(0.0, 5.0, 33)
    np.testing.assert_allclose(jax.jit(jax.vmap(decay))(x), decay_of(x), rtol=1e-15)
    assert decay(x[5]) == pytest.approx(float(decay_of(x)[5]), rel=1e-15)


def test_the_hyperbolic_tangent():
    """As accurate as a library's; one and minus one far out, odd, with its derivative at zero too."""
    x = np.concatenate([np.linspace(-30, 30, 60_001), np.geomspace(1e-17, 700, 1001), [0.0]])
    assert np.abs(np.asarray(tanh_of(x)) - np.tanh(x.astype(np.longdouble))).max() < 1e-15
    ends = tanh_of(np.array([-1e300, -np.inf, 0.0, 1e300, np.nan]))
    np.testing.assert_array_equal(ends, [-1.0, -1.0, 0.0, 1.0, np.nan])
    np.testing.assert_array_equal(tanh_of(-x), -tanh_of(x))
    slope = jax.jit(jax.grad(tanh))
    for at in (0.0, -0.7, 3.0):
        assert slope(at) == pytest.approx(1 - np.tanh(at) ** 2, rel=1e-13)
