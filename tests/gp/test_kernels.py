import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from gpcjax.gp.kernels import SMOOTHNESSES, SQUARED_EXPONENTIAL, Kernel

every_smoothness = pytest.mark.parametrize("nu", SMOOTHNESSES)
RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(7, 3))
SCALE = np.array([1.0, 1 / 6, 3.0])


def make(nu: float, variance: float = 0.3, length_scale: float = 0.7) -> Kernel:
    return Kernel(variance=jnp.asarray(variance), length_scale=jnp.asarray(length_scale), smoothness=nu)


def sklearn(nu: float, scale: np.ndarray = SCALE):
    """Inputs multiplied by w are length-scales divided by it."""
    lengths = 0.7 / scale
    return ConstantKernel(0.3) * (RBF(lengths) if nu == SQUARED_EXPONENTIAL else Matern(lengths, nu=nu))


@every_smoothness
def test_against_scikit_learn(nu):
    kernel, expected = make(nu), sklearn(nu)(POINTS)
    np.testing.assert_allclose(kernel.gram(jnp.asarray(POINTS), jnp.asarray(SCALE)), expected, rtol=1e-13)
    for i, point in enumerate(POINTS):
        got = kernel.covariances(jnp.asarray(POINTS), jnp.asarray(point), jnp.asarray(SCALE))
        np.testing.assert_allclose(got, expected[:, i], rtol=1e-13)


@every_smoothness
def test_a_repeat_and_a_point_far_away(nu):
    points = jnp.asarray([[1.0, 2.0], [1e6, -1e6], [-1e100, 0.0]])
    got = make(nu).covariances(points, points[0], jnp.ones(2))
    np.testing.assert_array_equal(got, [0.3, 0.0, 0.0])


@every_smoothness
def test_near_repeats_lose_no_digits(nu):
    """The distance comes from the difference, which is exact here, however far from zero the points are."""
    near, far = jnp.asarray([[2.0**-10]]), jnp.asarray([[2.0**20 + 2.0**-10]])
    at_zero = make(nu).covariances(near, jnp.zeros(1), jnp.ones(1))
    np.testing.assert_array_equal(make(nu).covariances(far, jnp.full(1, 2.0**20), jnp.ones(1)), at_zero)
    assert at_zero[0] < 0.3


def test_the_squared_exponential_is_the_limit_of_the_matern_family():
    """Smoother means larger covariances near by, whatever the branch."""
    near = [
        float(make(nu).covariances(jnp.zeros((1, 1)), jnp.full(1, 0.2), jnp.ones(1))[0])
        for nu in SMOOTHNESSES
    ]
    assert near == sorted(near) and len(set(near)) == len(near)


def test_a_grid_of_hyperparameters_is_a_vmap():
    lengths, points, scale = jnp.asarray([0.1, 0.7, 2.0]), jnp.asarray(POINTS), jnp.asarray(SCALE)
    kernels = jax.vmap(lambda length: Kernel(jnp.asarray(0.3), length, 1.5))(lengths)
    grid = jax.vmap(lambda kernel: kernel.gram(points, scale))(kernels)
    for length, gram in zip(lengths, grid, strict=True):
        np.testing.assert_allclose(
            gram, make(1.5, length_scale=float(length)).gram(points, scale), rtol=1e-14
        )


@pytest.mark.parametrize("nu", [0.0, 1.0, 3.5, -math.inf])
def test_a_smoothness_without_closed_form_is_refused(nu):
    with pytest.raises(
        ValueError, match=rf"smoothness nu = {nu}: closed forms exist for \(0.5, 1.5, 2.5, inf\)"
    ):
        make(nu)


@every_smoothness
def test_derivatives_where_points_meet(nu):
    """A stationary kernel is flat there, and curved as (3.4) says."""
    kernel, scale = make(nu), jnp.asarray(SCALE)
    value = jax.jit(lambda point: kernel.covariances(jnp.asarray(POINTS), point, scale).sum())
    one = jax.jit(lambda point: kernel.covariances(jnp.asarray(POINTS[:1]), point, scale)[0])
    at = POINTS[0]
    np.testing.assert_array_equal(jax.jit(jax.grad(one))(at), 0.0)
    if nu > 0.5:
        step, rows = 1e-5, np.eye(3)
        differences = [(value(at + step * row) - value(at - step * row)) / (2 * step) for row in rows]
        np.testing.assert_allclose(jax.jit(jax.grad(value))(at), differences, rtol=1e-6, atol=1e-8)
        curves = [(one(at + 1e-4 * row) - 2 * one(at) + one(at - 1e-4 * row)) / 1e-8 for row in rows]
        np.testing.assert_allclose(np.diag(jax.jit(jax.hessian(one))(at)), curves, rtol=1e-3)
    else:
        away = at + 0.3
        differences = [(value(away + 1e-6 * row) - value(away - 1e-6 * row)) / 2e-6 for row in np.eye(3)]
        np.testing.assert_allclose(jax.jit(jax.grad(value))(away), differences, rtol=1e-6, atol=1e-8)
