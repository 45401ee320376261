"""Hyperparameters by maximum marginal likelihood, compared with scikit-learn's."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from gpcjax.gp.fit import BOUNDS, fit, log_marginal_likelihood
from gpcjax.gp.kernels import SMOOTHNESSES, SQUARED_EXPONENTIAL, Kernel

FEW = 8
"""Points, of which each fit is the same program."""


def data(n=24, d=1, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3, 3, (n, d))
    return points, np.sin(2 * points).sum(1) + noise * rng.normal(size=n)


def sklearn(smoothness, variance=1.0, length_scale=1.0, noise=0.1, **options):
    shape = (
        RBF(length_scale, BOUNDS[1])
        if smoothness == SQUARED_EXPONENTIAL
        else Matern(length_scale, BOUNDS[1], nu=smoothness)
    )
    kernel = ConstantKernel(variance, BOUNDS[0]) * shape + WhiteKernel(noise, BOUNDS[2])
    return GaussianProcessRegressor(kernel, alpha=0, **options)


@functools.partial(jax.jit, static_argnums=0)
def ours(smoothness, points, targets, values):
    variance, length_scale, noise = (jnp.asarray(value) for value in values)
    return log_marginal_likelihood(
        Kernel(variance, length_scale, smoothness), noise, jnp.asarray(points), jnp.asarray(targets)
    )


@pytest.mark.parametrize(
    "smoothness",
    [pytest.param(nu, marks=[pytest.mark.slow] if nu in (1.5, 2.5) else []) for nu in SMOOTHNESSES],
)
@pytest.mark.parametrize("d", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_the_likelihood_and_its_slope_are_those_of_scikit_learn(smoothness, d):
    points, targets = data(d=d)
    points[1] = points[0]  # a repeat, where a Matern kernel's root has no slope
    value_and_grad = jax.jit(
        jax.value_and_grad(lambda logs: ours(smoothness, points, targets, jnp.exp(logs)))
    )
    for values in ((1.0, 1.0, 0.1), (0.01, 0.2, 1e-3), (30.0, 4.0, 1e-2)):
        reference = sklearn(smoothness, *values, optimizer=None).fit(points, targets)
        expected, slope = reference.log_marginal_likelihood(reference.kernel_.theta, eval_gradient=True)
        value, gradient = value_and_grad(jnp.log(jnp.asarray(values)))
        np.testing.assert_allclose(value, expected, rtol=1e-8)
        np.testing.assert_allclose(gradient, slope, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("smoothness", "n"),
    [(SQUARED_EXPONENTIAL, FEW), *(pytest.param(nu, 24, marks=pytest.mark.slow) for nu in SMOOTHNESSES)],
)
def test_the_optimum_is_scikit_learns(smoothness, n):
    points, targets = data(n, seed=3, noise=0.3)
    reference = sklearn(smoothness, n_restarts_optimizer=2, random_state=0).fit(points, targets)
    found = fit(points, targets, smoothness)
    assert found.log_likelihood >= reference.log_marginal_likelihood_value_ - 1e-4
    assert found.kernel.smoothness == smoothness
    values = [float(each) for each in (found.kernel.variance, found.kernel.length_scale, found.noise)]
    np.testing.assert_allclose(ours(smoothness, points, targets, values), found.log_likelihood, rtol=1e-12)
    np.testing.assert_allclose(values, np.exp(reference.kernel_.theta), rtol=1e-2)


def test_of_two_maxima_the_higher_is_taken():
    """Few points have a smooth explanation with noise and a rough one without (R&W figure 5.5)."""
    points, targets = data(FEW, seed=1, noise=0.5)
    reference = sklearn(SQUARED_EXPONENTIAL, n_restarts_optimizer=5, random_state=0).fit(points, targets)
    ends = [
        float(fit(points, targets, SQUARED_EXPONENTIAL, starts=[start] * 6).log_likelihood)
        for start in ((1.0, 0.3, 1e-4), (1.0, 6.0, 0.5))
    ]
    assert abs(ends[0] - ends[1]) > 0.1
    best = fit(points, targets, SQUARED_EXPONENTIAL).log_likelihood
    assert best >= max(*ends, reference.log_marginal_likelihood_value_) - 1e-4


def test_bounds_hold():
    points, targets = data(FEW)
    bounds = ((1e-2, 0.1), (2.0, 3.0), (1e-5, 1e5))
    found = fit(points, targets, SQUARED_EXPONENTIAL, bounds)
    assert 1e-2 <= found.kernel.variance <= 0.1 and 2.0 <= found.kernel.length_scale <= 3.0
    assert found.log_likelihood < fit(points, targets, SQUARED_EXPONENTIAL).log_likelihood


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((3, 1)), np.zeros(2), 1.5), r"points \(3, 1\) and targets \(2,\)"),
        ((np.zeros((1, 1)), np.zeros(1), 1.5), "n at least 2"),
        ((np.array([[0.0], [np.nan]]), np.zeros(2), 1.5), "finite"),
        ((np.zeros((2, 1)), np.zeros(2), 1.0), "smoothness nu = 1.0"),
        ((np.zeros((2, 1)), np.zeros(2), 1.5, [(1.0, 0.5)] * 3), "bounds"),
        ((np.zeros((2, 1)), np.zeros(2), 1.5, BOUNDS, [(1.0, 0.0, 1.0)]), "starts"),
    ],
)
def test_what_cannot_be_fitted_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        fit(*arguments)
