"""Factors made tile by tile, against numpy's; and a model that learns by them, against one that learns by LAPACK's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.gp import cholesky, tiled
from gpcjax.gp.kernels import SMOOTHNESSES, Kernel
from gpcjax.gp.renormalised import Renormalised, _leading_sizes
from tests.trees import assert_close

ROOM, NOISE = 24, 0.01
SCALE = jnp.array([0.5, 2.0, 1.0])
COUNTS = (0, 1, 7, 8, 9, 16, 23, 24)


@pytest.fixture
def by_tiles(monkeypatch):
    """As in a worker."""
    monkeypatch.setattr(tiled, "is_fast", lambda capacity: capacity % tiled.SIDE == 0)


def given(count, smoothness=2.5, seed=0):
    """A kernel, a dictionary of so many points, a vector, and their dense matrix."""
    rng = np.random.default_rng(seed)
    kernel = Kernel(jnp.array(0.8), jnp.array(0.7), smoothness)
    points, vector = rng.normal(size=(ROOM, 3)), rng.normal(size=ROOM)
    points[count:], vector[count:] = 0.0, 0.0
    gram = np.asarray(kernel.gram(jnp.asarray(points[:count]), SCALE))
    return kernel, points, vector, gram + NOISE * np.eye(count)


_factor = jax.jit(
    lambda kernel, points, count, vector: tiled.factor(kernel, points, SCALE, count, jnp.array(NOISE), vector)
)


@pytest.mark.parametrize("smoothness", SMOOTHNESSES)
def test_it_is_numpys(smoothness):
    for count in COUNTS if smoothness == 2.5 else (23,):
        kernel, points, vector, matrix = given(count, smoothness)
        factor = _factor(kernel, points, np.int32(count), vector)
        lower = np.linalg.cholesky(matrix)
        got = np.asarray(factor.lower())
        np.testing.assert_allclose(got[:count, :count], lower, atol=1e-14)
        np.testing.assert_array_equal(got[count:], np.eye(ROOM)[count:])
        np.testing.assert_array_equal(got[:, count:], np.eye(ROOM)[:, count:])
        assert not np.triu(got, 1).any()
        whitened, solved = np.zeros(ROOM), np.zeros(ROOM)
        whitened[:count] = np.linalg.solve(lower, vector[:count])
        solved[:count] = np.linalg.solve(matrix, vector[:count])
        np.testing.assert_allclose(factor.whitened, whitened, atol=1e-13)
        np.testing.assert_allclose(factor.solved(), solved, atol=1e-11)
        assert not np.asarray(factor.solved())[count:].any()


@pytest.mark.parametrize("count", COUNTS)
def test_what_is_kept_whitens(count):
    """Where it is among others; what is above the diagonal means nothing."""
    kernel, points, vector, matrix = given(count)
    lower = _factor(kernel, points, np.int32(count), vector).lower()
    others = jnp.stack([jnp.full_like(lower, jnp.nan), lower + jnp.triu(jnp.full_like(lower, 1e9), 1)])[
        :, None
    ]
    got = jax.jit(tiled.whiten)(others, (jnp.int32(1), jnp.int32(0)), np.int32(count), vector)
    expected = np.zeros(ROOM)
    expected[:count] = np.linalg.solve(np.linalg.cholesky(matrix), vector[:count])
    np.testing.assert_allclose(got, expected, atol=1e-13)


def test_what_is_no_number_is_none():
    kernel, points, vector, _ = given(9)
    points[3, 1] = np.nan
    assert not np.isfinite(_factor(kernel, points, np.int32(9), vector).solved()).all()
    kernel, points, vector, _ = given(9)
    worse = jax.jit(tiled.factor)(kernel, points, SCALE, jnp.int32(9), jnp.array(-0.9), vector)
    assert np.isnan(worse.whitened).any()  # not positive definite


@pytest.mark.parametrize("keeps_weights", [True, False])
def test_a_model_that_learns_by_tiles(by_tiles, monkeypatch, keeps_weights):
    """Through more points than a tile has, some of them replaced."""

    def taught(capacity):
        process = Renormalised(
            Kernel(jnp.array(0.8), jnp.array(0.7), 2.5), jnp.array(NOISE), keeps_weights=keeps_weights
        )
        posterior, told = process.init(capacity, jnp.ones(3)), []

        @jax.jit
        def learned(posterior, point, target, index):
            reading = process.read(posterior, (), process.covariances(posterior, point))
            change = process.put(posterior, (), reading, point, target, index, jnp.array(True))
            return change.write(posterior, ()), reading.deviation

        rng = np.random.default_rng(1)
        for step in range(24):
            index = step if step < 20 else step - 15
            posterior, deviation = learned(posterior, rng.normal(size=3), rng.normal(), np.int32(index))
            told.append(deviation)
        return posterior, jnp.stack(told)

    own = taught(ROOM)
    monkeypatch.setattr(tiled, "is_fast", lambda capacity: False)
    assert_close(own, taught(ROOM), 1e-11)


def test_it_is_for_processes_that_compile_loops_whole(monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    assert not tiled.is_fast(64)
    monkeypatch.setenv(
        "XLA_FLAGS", "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=67108864"
    )
    assert tiled.is_fast(64) and not tiled.is_fast(100)
    monkeypatch.setattr(tiled, "together", lambda: True)
    assert not tiled.is_fast(64)


def test_room():
    """Few of them, the last one all there is; beyond those that are tiled, LAPACK's."""
    sizes = [_leading_sizes(capacity, True) for capacity in (48, 64, 128, 512)]
    assert sizes == [(48,), (64,), (128,), (128, 512)]
    assert _leading_sizes(256, True) == (256,)
    assert _leading_sizes(1024, True) == (512, 640, 768, 896, 1024)
    assert _leading_sizes(4096, True)[:2] == _leading_sizes(4096, False)[:2] == (768, 896)
    assert _leading_sizes(64, False) == (16, 32, 48, 64)


@pytest.mark.parametrize("noise", [1e-6, 1e-10])
def test_points_upon_each_other_are_as_exact_as_by_lapack(noise):
    """Little noise makes the matrix nearly singular: an inverse of its tiles alone would lose two digits."""
    rng = np.random.default_rng(0)
    points = np.zeros((40, 2))
    points[:37] = rng.normal(size=(6, 2))[rng.integers(6, size=37)]
    vector = np.zeros(40)
    vector[:37] = rng.normal(size=37)
    kernel, scale = Kernel(jnp.array(0.8), jnp.array(0.7), np.inf), jnp.ones(2)
    gram = np.asarray(kernel.gram(jnp.asarray(points[:37]), scale))
    factor = jax.jit(tiled.factor)(kernel, points, scale, np.int32(37), jnp.array(noise), vector)
    lower = cholesky.factor(jnp.asarray(gram), jnp.ones(37, bool), jnp.array(noise))
    by_lapack = cholesky.solve(lower, cholesky.solve(lower, jnp.asarray(vector[:37])), transpose=True)
    # Points that agree share their targets' sum: so the mean there is known, and well determined.
    _, which = np.unique(points[:37], axis=0, return_inverse=True)
    count, total = np.bincount(which.ravel()), np.bincount(which.ravel(), vector[:37])
    _, first = np.unique(which.ravel(), return_index=True)
    distinct = gram[np.ix_(first, first)]
    exact = (distinct @ np.linalg.solve(distinct + np.diag(noise / count), total / count))[which.ravel()]
    error, usual = (
        np.abs(gram @ np.asarray(weights) - exact).max() for weights in (factor.solved()[:37], by_lapack)
    )
    assert error < 4 * usual


@pytest.mark.parametrize("function", [jax.grad, jax.jacfwd])
def test_derivatives_are_those_by_lapack(by_tiles, monkeypatch, function):
    """Of either mode; loops whose length is not known could not be gone through backwards."""
    rng = np.random.default_rng(0)

    def uncertainty(noise):
        process = Renormalised(Kernel(jnp.array(0.8), jnp.array(0.7), 2.5), noise)
        posterior = process.init(16, jnp.ones(3))
        for index, (point, target) in enumerate(zip(*given_points, strict=True)):
            reading = process.read(posterior, (), process.covariances(posterior, point))
            change = process.put(posterior, (), reading, point, target, jnp.int32(index), jnp.array(True))
            posterior = change.write(posterior, ())
        return process.uncertainty(posterior, jnp.zeros(3)) + posterior.weights.sum()

    given_points = jnp.asarray(rng.normal(size=(3, 3))), jnp.asarray(rng.normal(size=3))
    own = jax.jit(function(uncertainty))(0.1)
    monkeypatch.setattr(tiled, "is_fast", lambda capacity: False)
    np.testing.assert_allclose(own, jax.jit(function(lambda noise: uncertainty(noise)))(0.1), rtol=1e-9)
