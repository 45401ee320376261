"""What points around an input explain, against numpy with all of them; and a model that asks so, against LAPACK's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.gp import nearby, tiled
from gpcjax.gp.kernels import SQUARED_EXPONENTIAL, Kernel
from gpcjax.gp.renormalised import Renormalised
from tests.reference import dense
from tests.trees import assert_close

ROOM, NOISE, VARIANCE = 100, 1e-5, 0.8
SCALE = np.array([0.5, 2.0, 1.0])


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Small numbers, as loops are slow outside of workers."""
    monkeypatch.setattr(nearby, "FEWEST", 16)
    monkeypatch.setattr(nearby, "MOST", 48)
    monkeypatch.setattr(nearby, "ROWS", 16)


def told(count, length_scale, seed=0, noise=NOISE, covariance=None):
    """What `nearby` tells of an input, and what all points explain of it; or of one with this covariance to all."""
    rng = np.random.default_rng(seed)
    points, point = rng.normal(size=(ROOM, 3)), rng.normal(size=3)
    points[count:] = 0.0
    kernel = Kernel(jnp.array(VARIANCE), jnp.array(length_scale), SQUARED_EXPONENTIAL)
    scaled, hyperparameters = points[:count] * SCALE, (VARIANCE, length_scale, SQUARED_EXPONENTIAL)
    covariances = np.zeros(ROOM)
    covariances[:count] = dense.kernel(scaled, (point * SCALE)[None], *hyperparameters)[:, 0]
    if covariance is not None:
        covariances[:count] = covariance
    gram = dense.kernel(scaled, scaled, *hyperparameters) + noise * np.eye(count)
    expected = covariances[:count] @ np.linalg.solve(gram, covariances[:count])
    explained, found = jax.jit(nearby.explained)(
        kernel, points, SCALE, np.int32(count), np.float64(noise), covariances
    )
    return explained, bool(found), expected


@pytest.mark.parametrize("seed", range(3))
def test_those_around_are_enough_where_covariances_fall_off(seed):
    explained, found, expected = told(97, 0.1, seed)
    assert found
    np.testing.assert_allclose(explained, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 16, 32])
def test_all_of_few_are_taken(count):
    explained, found, expected = told(count, 2.0)
    assert found
    np.testing.assert_allclose(explained, expected, rtol=0, atol=1e-9)


def test_it_is_known_when_they_are_not_enough():
    """As with a long length-scale; and where there is so little noise that a deviation would notice the others."""
    assert not told(97, 2.0)[1]
    assert told(97, 0.15)[1] and not told(97, 0.15, noise=1e-12)[1]


@pytest.mark.parametrize("count", [1, 16, 33, 97])
@pytest.mark.parametrize("nothing", [np.nan, -np.nan])
def test_what_is_no_number_is_explained_by_no_few(count, nothing):
    """Of either sign: what 0 / 0 gives has the other one, and would be sorted behind the unused rows."""
    assert not told(count, 0.1, covariance=nothing)[1]


@pytest.mark.parametrize("length_scale", [0.1, 2.0])
def test_a_model_that_asks_those_around(monkeypatch, length_scale):
    """Through more points than are taken at once, with and without going on to all of them."""
    process = Renormalised(
        Kernel(jnp.array(VARIANCE), jnp.array(length_scale), SQUARED_EXPONENTIAL),
        jnp.array(1e-3),
        keeps_weights=False,
    )

    def learned(room):
        def one(posterior, given):
            reading = process.read(posterior, (), process.covariances(posterior, (), given))
            zero, yes = jnp.zeros(()), jnp.array(True)
            change = process.put(posterior, (), reading, given, zero, posterior.count, yes)
            return change.write(posterior, ()), reading.deviation

        points = np.random.default_rng(1).normal(size=(80, 3))
        return jax.jit(lambda points: jax.lax.scan(one, process.init(room, jnp.ones(3)), points))(points)

    monkeypatch.setattr(tiled, "is_fast", lambda capacity: capacity % tiled.SIDE == 0)
    own = learned(96)
    monkeypatch.setattr(tiled, "is_fast", lambda capacity: False)
    assert_close(own, learned(96), 1e-9)
