"""Factors made tile by tile, against numpy's; and a model that learns by them, against one that learns by LAPACK's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.gp import tiled, tiles
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
        got = np.tril(factor.lower(ROOM))
        np.testing.assert_allclose(got[:count, :count], lower, atol=1e-14)
        np.testing.assert_array_equal(got[count:], np.eye(ROOM)[count:])
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
    lower = _factor(kernel, points, np.int32(count), vector).lower(ROOM)
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
        lower = jnp.tril(posterior.matrix)  # of LAPACK's, what is above is zero
        return posterior.points, posterior.targets, posterior.scale, posterior.weights, lower, jnp.stack(told)

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


def test_room(by_tiles):
    """Few of them, the last one all there is; beyond those that are tiled, LAPACK's."""
    assert [_leading_sizes(capacity) for capacity in (48, 64, 128, 512)] == [(48,), (64,), (128,), (128, 512)]
    assert _leading_sizes(1024) == (512, 640, 768, 896, 1024)
    assert tiles.ROWS == 8
