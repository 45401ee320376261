"""Factors made tile by tile, against numpy's; and a model that learns by them, against one that learns by LAPACK's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.gp import cholesky, tiled
from gpcjax.gp.kernels import SMOOTHNESSES, Kernel
from gpcjax.gp.leading import leading_sizes
from gpcjax.gp.renormalised import Renormalised
from tests.reference import dense
from tests.trees import assert_close

ROOM, NOISE = 24, 0.01
SCALE = np.array([0.5, 2.0, 1.0])
COUNTS = (0, 1, 7, 8, 9, 16, 23, 24)
COUNT = 23


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
    scaled = points[:count] * SCALE
    gram = dense.kernel(scaled, scaled, 0.8, 0.7, smoothness)
    return kernel, points, vector, gram + NOISE * np.eye(count)


@jax.jit
def factorised(kernel, points, scale, count, noise, vector):
    """The factor of so many points, U^-T v and (K + noise I)^-1 v."""
    factor = tiled.factor(kernel, points, scale, count, noise, vector)
    return tiled.lower(factor.matrix, count), factor.whitened, factor.solved()


def made(kernel, points, count, vector, noise=NOISE):
    """The same in numpy, with the inputs' own scale."""
    return map(np.asarray, factorised(kernel, points, SCALE, np.int32(count), np.float64(noise), vector))


@pytest.mark.parametrize(
    "smoothness", [nu if nu == 2.5 else pytest.param(nu, marks=pytest.mark.slow) for nu in SMOOTHNESSES]
)
def test_it_is_numpys(smoothness):
    for count in COUNTS if smoothness == 2.5 else (23,):
        kernel, points, vector, matrix = given(count, smoothness)
        got, got_whitened, got_solved = made(kernel, points, count, vector)
        lower = np.linalg.cholesky(matrix)
        np.testing.assert_allclose(got[:count, :count], lower, atol=1e-14)
        np.testing.assert_array_equal(got[count:], np.eye(ROOM)[count:])
        np.testing.assert_array_equal(got[:, count:], np.eye(ROOM)[:, count:])
        assert not np.triu(got, 1).any()
        whitened, solved = np.zeros(ROOM), np.zeros(ROOM)
        whitened[:count] = np.linalg.solve(lower, vector[:count])
        solved[:count] = np.linalg.solve(matrix, vector[:count])
        np.testing.assert_allclose(got_whitened, whitened, atol=1e-13)
        np.testing.assert_allclose(got_solved, solved, atol=1e-11)
        assert not got_solved[count:].any()


whiten = jax.jit(tiled.whiten)


@pytest.mark.parametrize("count", COUNTS)
def test_what_is_kept_whitens(count):
    """Where it is among others; what is above the diagonal means nothing."""
    kernel, points, vector, matrix = given(count)
    lower, _, _ = made(kernel, points, count, vector)
    others = np.stack([np.full_like(lower, np.nan), lower + np.triu(np.full_like(lower, 1e9), 1)])[:, None]
    got = whiten(others, (np.int32(1), np.int32(0)), np.int32(count), vector)
    expected = np.zeros(ROOM)
    expected[:count] = np.linalg.solve(np.linalg.cholesky(matrix), vector[:count])
    np.testing.assert_allclose(got, expected, atol=1e-13)


def test_what_is_no_number_is_none():
    kernel, points, vector, _ = given(9)
    points[3, 1] = np.nan
    _, _, solved = made(kernel, points, 9, vector)
    assert not np.isfinite(solved).all()
    kernel, points, vector, _ = given(9)
    _, whitened, _ = made(kernel, points, 9, vector, -0.9)
    assert np.isnan(whitened).any()  # not positive definite


@pytest.mark.parametrize("keeps_weights", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_model_that_learns_by_tiles(by_tiles, monkeypatch, keeps_weights):
    """Through more points than a tile has, some of them replaced."""

    def taught(capacity):
        process = Renormalised(
            Kernel(jnp.array(0.8), jnp.array(0.7), 2.5), jnp.array(NOISE), keeps_weights=keeps_weights
        )
        posterior, told = process.init(capacity, jnp.ones(3)), []

        @jax.jit
        def learned(posterior, point, target, index):
            reading = process.read(posterior, (), process.covariances(posterior, (), point))
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
    sizes = [leading_sizes(capacity, True) for capacity in (48, 64, 128, 512)]
    assert sizes == [(48,), (64,), (128,), (128, 512)]
    assert leading_sizes(256, True) == (256,)
    assert leading_sizes(1024, True) == (1024,)
    assert leading_sizes(2048, True) == (1024, 1280, 1536, 1792, 2048)
    assert leading_sizes(4096, False)[:3] == (768, 896, 1024)
    assert leading_sizes(64, False) == (16, 32, 48, 64)


@jax.jit
def by_lapack(gram, noise, vector):
    """(K + noise I)^-1 v."""
    lower = cholesky.factor(gram, jnp.ones(len(vector), bool), noise)
    return cholesky.solve(lower, cholesky.solve(lower, vector), transpose=True)


@pytest.mark.parametrize("noise", [1e-6, 1e-10])
def test_points_upon_each_other_are_as_exact_as_by_lapack(noise):
    """Little noise makes the matrix nearly singular: an inverse of its tiles alone would lose two digits."""
    rng = np.random.default_rng(0)
    points, vector = np.zeros((ROOM, 3)), np.zeros(ROOM)
    points[:COUNT] = rng.normal(size=(4, 3))[rng.integers(4, size=COUNT)]
    vector[:COUNT] = rng.normal(size=COUNT)
    kernel = Kernel(jnp.array(0.8), jnp.array(0.7), 2.5)
    gram = dense.kernel(points[:COUNT] * SCALE, points[:COUNT] * SCALE, 0.8, 0.7, 2.5)
    _, _, by_tiles = made(kernel, points, COUNT, vector, noise)
    # Points that agree share their targets' sum: so the mean there is known, and well determined.
    _, which = np.unique(points[:COUNT], axis=0, return_inverse=True)
    count, total = np.bincount(which.ravel()), np.bincount(which.ravel(), vector[:COUNT])
    _, first = np.unique(which.ravel(), return_index=True)
    distinct = gram[np.ix_(first, first)]
    exact = (distinct @ np.linalg.solve(distinct + np.diag(noise / count), total / count))[which.ravel()]
    error, usual = (
        np.abs(gram @ np.asarray(weights) - exact).max()
        for weights in (by_tiles[:COUNT], by_lapack(gram, np.float64(noise), vector[:COUNT]))
    )
    assert error < 4 * usual


def uncertainty(noise):
    """Of a model that has learned two points, and its weights."""
    rng = np.random.default_rng(0)
    process = Renormalised(Kernel(jnp.array(0.8), jnp.array(0.7), 2.5), noise)
    posterior = process.init(16, jnp.ones(3))

    def learned(posterior, given):
        index, point, target = given
        reading = process.read(posterior, (), process.covariances(posterior, (), point))
        change = process.put(posterior, (), reading, point, target, index, jnp.array(True))
        return change.write(posterior, ()), None

    given = (
        jnp.arange(2, dtype=jnp.int32),
        jnp.asarray(rng.normal(size=(2, 3))),
        jnp.asarray(rng.normal(size=2)),
    )
    posterior, _ = jax.lax.scan(learned, posterior, given)
    return process.uncertainty(posterior, (), jnp.zeros(3)) + posterior.weights.sum()


@pytest.fixture(scope="module")
def slope_by_lapack():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiled, "is_fast", lambda capacity: False)
        return np.asarray(jax.jit(jax.grad(lambda noise: uncertainty(noise)))(0.1))


@pytest.mark.parametrize("function", [jax.grad, pytest.param(jax.jacfwd, marks=pytest.mark.slow)])
def test_derivatives_are_those_by_lapack(slope_by_lapack, by_tiles, function):
    """Of either mode, the first by way of the second; loops of no known length could not be gone through backwards."""
    own = jax.jit(function(lambda noise: uncertainty(noise)))(0.1)
    np.testing.assert_allclose(own, slope_by_lapack, rtol=1e-9)
