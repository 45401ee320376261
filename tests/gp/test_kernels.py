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


gram, covariances = jax.jit(Kernel.gram), jax.jit(Kernel.covariances)


def make(nu: float, variance: float = 0.3, length_scale: float = 0.7) -> Kernel:
    return Kernel(variance=jnp.asarray(variance), length_scale=jnp.asarray(length_scale), smoothness=nu)


def sklearn(nu: float, scale: np.ndarray = SCALE):
    """Inputs multiplied by w are length-scales divided by it."""
    lengths = 0.7 / scale
    return ConstantKernel(0.3) * (RBF(lengths) if nu == SQUARED_EXPONENTIAL else Matern(lengths, nu=nu))


@every_smoothness
def test_against_scikit_learn(nu):
    kernel, expected = make(nu), sklearn(nu)(POINTS)
    np.testing.assert_allclose(gram(kernel, POINTS, SCALE), expected, rtol=1e-13)
    for i, point in enumerate(POINTS):
        got = covariances(kernel, POINTS, point, SCALE)
        np.testing.assert_allclose(got, expected[:, i], rtol=1e-13)


@every_smoothness
def test_a_repeat_and_a_point_far_away(nu):
    points = np.array([[1.0, 2.0], [1e6, -1e6], [-1e100, 0.0]])
    got = covariances(make(nu), points, points[0], np.ones(2))
    np.testing.assert_array_equal(got, [0.3, 0.0, 0.0])


@every_smoothness
def test_near_repeats_lose_no_digits(nu):
    """The distance comes from the difference, which is exact here, however far from zero the points are."""
    near, far = np.array([[2.0**-10]]), np.array([[2.0**20 + 2.0**-10]])
    at_zero = covariances(make(nu), near, np.zeros(1), np.ones(1))
    np.testing.assert_array_equal(covariances(make(nu), far, np.full(1, 2.0**20), np.ones(1)), at_zero)
    assert at_zero[0] < 0.3


def test_the_squared_exponential_is_the_limit_of_the_matern_family():
    """Smoother means larger covariances near by, whatever the branch."""
    near = [
        float(covariances(make(nu), np.zeros((1, 1)), np.full(1, 0.2), np.ones(1))[0]) for nu in SMOOTHNESSES
    ]
    assert near == sorted(near) and len(set(near)) == len(near)


def test_a_grid_of_hyperparameters_is_a_vmap():
    lengths = np.array([0.1, 0.7, 2.0])
    kernels = jax.vmap(lambda length: Kernel(jnp.asarray(0.3), length, 1.5))(lengths)
    grid = jax.jit(jax.vmap(Kernel.gram, in_axes=(0, None, None)))(kernels, POINTS, SCALE)
    for length, got in zip(lengths, grid, strict=True):
        np.testing.assert_allclose(got, gram(make(1.5, length_scale=length), POINTS, SCALE), rtol=1e-14)


@pytest.mark.parametrize("nu", [0.0, 1.0, 3.5, -math.inf])
def test_a_smoothness_without_closed_form_is_refused(nu):
    with pytest.raises(
        ValueError, match=rf"smoothness nu = {nu}: closed forms exist for \(0.5, 1.5, 2.5, inf\)"
    ):
        make(nu)


@pytest.mark.parametrize(
    "nu", [pytest.param(nu, marks=[pytest.mark.slow] if nu in (1.5, 2.5) else []) for nu in SMOOTHNESSES]
)
def test_derivatives_where_points_meet(nu):
    """A stationary kernel is flat there, and curved as (3.4) says."""
    kernel, scale = make(nu), jnp.asarray(SCALE)
    value = lambda point: kernel.covariances(jnp.asarray(POINTS), point, scale).sum()  # noqa: E731
    one = lambda point: kernel.covariances(jnp.asarray(POINTS[:1]), point, scale)[0]  # noqa: E731
    sum_and_slope = jax.jit(jax.value_and_grad(value))
    whole = jax.jit(lambda point: (one(point), jax.grad(one)(point), jax.hessian(one)(point)))
    at, rows = POINTS[0], np.eye(3)
    middle, slope, curvature = whole(at)
    np.testing.assert_array_equal(slope, 0.0)
    step, place = (1e-5, at) if nu > 0.5 else (1e-6, at + 0.3)
    ends = [[sum_and_slope(place + side * row)[0] for side in (step, -step)] for row in rows]
    differences = [(above - below) / (2 * step) for above, below in ends]
    np.testing.assert_allclose(sum_and_slope(place)[1], differences, rtol=1e-6, atol=1e-8)
    if nu > 0.5:
        curves = [(whole(at + 1e-4 * row)[0] - 2 * middle + whole(at - 1e-4 * row)[0]) / 1e-8 for row in rows]
        np.testing.assert_allclose(np.diag(curvature), curves, rtol=1e-3)
