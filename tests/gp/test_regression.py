"""Regression on a dictionary of fixed capacity, with fixed weights (GPC) and normalised (GPC-NS)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from gpcjax.gp import factor
from gpcjax.gp.appending import Appending
from gpcjax.gp.kernels import SQUARED_EXPONENTIAL, Kernel
from gpcjax.gp.posterior import Posterior, small, take
from gpcjax.gp.process import PART, GaussianProcess, nearest
from gpcjax.gp.renormalised import Renormalised, normalising_scale
from gpcjax.gp.replacing import Replacing
from tests.trees import assert_close, assert_same_bits

CAPACITY = 16
NOISE = 1e-7
WEIGHTS = np.array([1.0, 1 / 6, 2.0])

each_scaling = pytest.mark.parametrize("normalise", [False, True], ids=["fixed", "normalised"])
fixed_first = pytest.mark.parametrize(
    "normalise", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["fixed", "normalised"]
)
"""For what both have from the code that they share."""

normalised_first = pytest.mark.parametrize(
    "normalise", [pytest.param(False, marks=pytest.mark.slow), True], ids=["fixed", "normalised"]
)
"""For what others say of fixed weights: their roots against dense ones, and the model that only appends."""


def kernel_of(smoothness: float = 1.5) -> Kernel:
    return Kernel(variance=jnp.asarray(0.02), length_scale=jnp.asarray(0.4), smoothness=smoothness)


def make(normalise: bool, smoothness: float | None = None, **options: bool) -> GaussianProcess:
    model, usual = (Renormalised, 1.5) if normalise else (Replacing, SQUARED_EXPONENTIAL)
    return model(kernel_of(usual if smoothness is None else smoothness), jnp.asarray(NOISE), **options)


def appending(smoothness: float = 1.5) -> Appending:
    return Appending(kernel_of(smoothness), jnp.asarray(NOISE))


def empty(process: GaussianProcess, capacity: int = CAPACITY) -> Posterior:
    return process.init(capacity, jnp.asarray(WEIGHTS))


@jax.jit
def _put(process, posteriors, where, point, target, index, given):
    covariances = process.covariances(posteriors, where, point)
    reading = process.read(posteriors, where, covariances, index)
    change = process.put(posteriors, where, reading, point, target, index, given)
    return change.write(posteriors, where)


def put(process, posteriors, point, target, index, given=True, where=()) -> Posterior:
    return _put(
        process, posteriors, where, *map(jnp.asarray, (point, target)), jnp.int32(index), jnp.asarray(given)
    )


@jax.jit
def _append(process, posteriors, where, point, target, given):
    """As a learner does, which knows only afterwards whether what it would learn is a number."""
    before = small(posteriors, where)
    reading = process.read(posteriors, where, process.covariances(posteriors, where, point))
    change = process.put(posteriors, where, reading, point, target, before.count, jnp.array(True))
    return reading.deviation, change.only(given).write(posteriors, where)


def append(process, posteriors, point, target, given=True, where=()) -> tuple[jax.Array, Posterior]:
    return _append(process, posteriors, where, *map(jnp.asarray, (point, target, given)))


uncertainty, taken = map(jax.jit, (GaussianProcess.uncertainty, take))
scaled = jax.jit(normalising_scale)


def written(posterior, posteriors, where) -> Posterior:
    """The posteriors with this one in one place."""
    return jax.tree.map(lambda leaf, value: leaf.at[where].set(value), posteriors, posterior)


@jax.jit
def _predict(process, posterior, point):
    mean = (process.covariances(posterior, (), point) * posterior.weights).sum()
    return mean, process.uncertainty(posterior, (), point)


def predict(process, posterior, probes):
    """Means and deviations (n,) at the rows of `probes`."""
    results = [_predict(process, posterior, jnp.asarray(probe)) for probe in probes]
    return tuple(map(np.asarray, zip(*results, strict=True)))


def filled(process: GaussianProcess, count: int, seed: int = 0, capacity: int = CAPACITY) -> Posterior:
    rng, posterior = np.random.default_rng(seed), empty(process, capacity)
    for index in range(count):
        posterior = put(process, posterior, rng.normal(size=3), rng.normal(), index)
    return posterior


def sklearn(process: GaussianProcess, points, targets) -> GaussianProcessRegressor:
    """Fitted to the dictionary; the scaling sits in its length-scales."""
    deviation = np.asarray(points).std(0)
    widths = np.where(deviation < 1e-6, 1.0, deviation) if process.normalise else 1 / WEIGHTS
    nu, lengths = process.kernel.smoothness, 0.4 * widths
    shape = RBF(lengths) if nu == SQUARED_EXPONENTIAL else Matern(lengths, nu=nu)
    kernel = ConstantKernel(0.02) * shape + WhiteKernel(NOISE)
    return GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None).fit(
        np.asarray(points), np.asarray(targets)
    )


steps = st.lists(
    st.tuples(
        st.tuples(*[st.integers(-2, 2)] * 3),
        st.sampled_from([0.0, 1e-3, -0.1]),
        st.floats(-1.2, 1.2),
        st.one_of(st.none(), st.integers(0, CAPACITY - 1)),
    ),
    min_size=1,
    max_size=CAPACITY,
)


@pytest.mark.parametrize(
    ("normalise", "smoothness"),
    [
        *((False, SQUARED_EXPONENTIAL), (True, 1.5)),
        *(pytest.param(False, nu, marks=pytest.mark.slow) for nu in (0.5, 1.5, 2.5)),
        *(pytest.param(True, nu, marks=pytest.mark.slow) for nu in (0.5, 2.5, SQUARED_EXPONENTIAL)),
    ],
)
@settings(max_examples=8)
@given(steps)
def test_against_scikit_learn(normalise, smoothness, steps):
    """Any sequence of appended and replaced points, repeats among them."""
    process = make(normalise, smoothness)
    posterior, points, targets = empty(process), [], []
    for node, shift, target, index in steps:
        point = np.array(node, float) + shift
        if index is None or index >= len(points):
            index = len(points)
            points.append(point)
            targets.append(target)
        else:
            points[index], targets[index] = point, target
        posterior = put(process, posterior, point, target, index)
    assert posterior.count == len(points)
    assert not np.asarray(posterior.points)[len(points) :].any()

    probes = np.vstack([points[-1], np.zeros(3), np.ones(3) * 0.5, np.full(3, 30.0)])
    mean, deviation = predict(process, posterior, probes)
    expected = sklearn(process, points, targets).predict(probes, return_std=True)
    np.testing.assert_allclose(mean, expected[0], atol=1e-8)
    np.testing.assert_allclose(deviation, np.maximum(expected[1], np.sqrt(NOISE)), atol=1e-8)


@each_scaling
def test_an_empty_dictionary_is_the_prior(normalise):
    process = make(normalise)
    mean, deviation = predict(process, empty(process), np.random.default_rng(1).normal(size=(3, 3)))
    np.testing.assert_array_equal(mean, 0.0)
    np.testing.assert_array_equal(deviation, np.sqrt(0.02 + NOISE))


@each_scaling
def test_rounding_cannot_take_the_variance_below_the_noise(normalise):
    process, point = make(normalise), np.array([0.1, 0.2, 0.3])
    posterior = empty(process)
    for index in range(CAPACITY):
        posterior = put(process, posterior, point, 0.5, index)
    mean, deviation = predict(process, posterior, [point])
    assert np.sqrt(NOISE) <= deviation <= np.sqrt(NOISE * (1 + 1.1 / CAPACITY))
    np.testing.assert_allclose(mean, 0.5, rtol=1e-6)


@fixed_first
def test_growing_keeps_what_was_learned(normalise):
    process = make(normalise)
    posterior, probes = filled(process, 11), np.random.default_rng(2).normal(size=(5, 3))
    grown = process.grow(posterior, 3 * CAPACITY)
    assert grown.capacity == 3 * CAPACITY and grown.count == 11
    before, after = predict(process, posterior, probes), predict(process, grown, probes)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)
    # It goes on as if there had been room from the start.
    roomy = filled(process, 11, capacity=3 * CAPACITY)
    for index, target in ((11, 0.3), (4, -0.4)):
        grown, roomy = (put(process, each, np.full(3, 0.1 * index), target, index) for each in (grown, roomy))
    assert_close(grown, roomy, 1e-9)


def test_growing_to_the_same_capacity_changes_nothing_and_below_it_is_refused():
    process = make(False)
    posterior = filled(process, 3)
    assert_same_bits(process.grow(posterior, CAPACITY), posterior)
    with pytest.raises(ValueError, match="capacity 15 is below the dictionary's 16"):
        process.grow(posterior, 15)


@each_scaling
def test_without_write_nothing_changes_to_the_bit(normalise):
    """Whatever the inputs and the dictionary's past: these weights come from no solve of this shape."""
    process = make(normalise)
    posterior = filled(process, 9)
    posterior = Posterior(**(vars(posterior) | {"weights": posterior.weights * (1 + 1e-9)}))
    for point in (np.zeros(3), np.full(3, np.nan), np.full(3, np.inf)):
        for index in (0, 9):
            assert_same_bits(put(process, posterior, point, np.nan, index, given=False), posterior)


@normalised_first
def test_a_model_without_weights_has_the_same_deviations(normalise):
    full, lean = make(normalise), make(normalise, keeps_weights=False)
    probes = np.random.default_rng(3).normal(size=(4, 3))
    posterior = filled(lean, 10)
    assert not posterior.weights.any()
    deviations = predict(lean, posterior, probes)[1]
    np.testing.assert_allclose(deviations, predict(full, filled(full, 10), probes)[1], atol=1e-12)


@pytest.mark.parametrize("capacity", [CAPACITY, pytest.param(70, marks=pytest.mark.slow)])
def test_a_model_that_only_appends_is_the_same_while_it_appends(capacity):
    """And tells beforehand how uncertain it was; a point that is not given leaves it as it is, be it full or not."""
    process = appending(SQUARED_EXPONENTIAL)
    full = make(False, SQUARED_EXPONENTIAL, keeps_weights=False)
    posterior, expected = empty(process, capacity), empty(full, capacity)
    rng = np.random.default_rng(7)
    for index in range(capacity):
        point, target = rng.normal(size=3), rng.normal()
        told = uncertainty(process, posterior, (), jnp.asarray(point))
        deviation, posterior = append(process, posterior, point, target)
        np.testing.assert_allclose(deviation, _predict(full, expected, jnp.asarray(point))[1], rtol=1e-9)
        np.testing.assert_allclose(deviation, told, rtol=1e-12)
        expected = put(full, expected, point, target, index)
        assert_same_bits(append(process, posterior, np.full(3, np.nan), 1.0, given=False)[1], posterior)
    matrix_of = jax.jit(factor.dense, static_argnums=(1, 2))
    roots = [
        np.asarray(matrix_of(each.matrix, capacity, is_lower))
        for each, is_lower in ((posterior, True), (expected, False))
    ]
    np.testing.assert_allclose(*roots, atol=1e-9 * np.abs(roots[1]).max())
    without = (dataclasses.replace(each, matrix=jnp.zeros(0)) for each in (posterior, expected))
    assert_close(*without, 1e-9)


@normalised_first
@pytest.mark.parametrize(
    "capacity", [33, *(pytest.param(size, marks=pytest.mark.slow) for size in (100, 300))]
)
def test_across_the_borders_of_blocks(normalise, capacity):
    """Scikit-learn again, with full dictionaries whose capacity is no multiple of what is read at once."""
    process, rng = make(normalise), np.random.default_rng(capacity)
    posterior, points, targets = empty(process, capacity), np.zeros((capacity, 3)), np.zeros(capacity)
    for step in range(capacity + 12):
        index = (
            step if step < capacity else (capacity - 1, 0, *rng.integers(capacity, size=10))[step - capacity]
        )
        points[index], targets[index] = rng.normal(size=3), rng.normal()
        posterior = put(process, posterior, points[index], targets[index], index)
        if step in (30, 31, 32, 33, 95, 96, 255, 256, 257, capacity - 1, capacity, capacity + 11):
            count = min(step + 1, capacity)
            probes = np.vstack([points[count - 1], points[0] + 0.1, np.zeros(3)])
            mean, deviation = predict(process, posterior, probes)
            fitted = sklearn(process, points[:count], targets[:count]).predict(probes, return_std=True)
            np.testing.assert_allclose(mean, fitted[0], atol=1e-8)
            np.testing.assert_allclose(deviation, np.maximum(fitted[1], np.sqrt(NOISE)), atol=1e-8)
            np.testing.assert_array_equal(posterior.points[:count], points[:count])


@pytest.mark.parametrize("capacity", [48, 2 * PART, 2 * PART + 1])
def test_covariances_are_those_of_the_points_in_use(capacity):
    """In whatever parts they are computed; unused rows may hold anything here."""
    process, rng = make(False), np.random.default_rng(capacity)
    points, point = rng.normal(size=(capacity, 3)), jnp.asarray(rng.normal(size=3))
    posterior = dataclasses.replace(empty(process, capacity), points=jnp.asarray(points))
    several = jax.tree.map(lambda leaf: jnp.stack([jnp.full_like(leaf, 7), leaf]), posterior)
    whole = np.asarray(jax.jit(Kernel.covariances)(process.kernel, points, point, posterior.scale))
    covariances = jax.jit(GaussianProcess.covariances)
    for count in {0, 1, PART - 1, PART, PART + 1, capacity} & set(range(capacity + 1)):
        counted = dataclasses.replace(several, count=jnp.array([3, count], jnp.int32))
        found = covariances(process, counted, (jnp.int32(1),), point)
        np.testing.assert_allclose(found[:count], whole[:count], rtol=1e-14, atol=0)
        assert not np.any(found[count:])


@pytest.mark.parametrize(
    ("values", "row"),
    [([0.1, 0.7, 0.2], 1), ([0.0, 0.0], 0), ([0.2, 0.9, 0.3, 0.9], 1), ([0.4], 0), ([0.4, np.nan, 0.5], 2)],
)
def test_the_nearest_point_is_the_first_of_largest_covariance(values, row):
    assert nearest(jnp.asarray(values)) == row


@fixed_first
@pytest.mark.parametrize("where", [pytest.param((1,), marks=pytest.mark.slow), (2, 0)])
def test_one_of_many_places_touches_no_other(normalise, where):
    """Put or appended; the others are not even numbers."""
    process, place = make(normalise), tuple(map(jnp.asarray, where))
    posterior, point = filled(process, 9), np.array([0.3, 0.1, -0.2])

    def many(leaf):
        blank = np.full((3, 2)[: len(where)] + leaf.shape, np.nan if leaf.dtype == float else 5, leaf.dtype)
        blank[where] = leaf
        return jnp.asarray(blank)

    posteriors = jax.tree.map(many, posterior)
    assert_same_bits(taken(posteriors, place), posterior)
    for index in (0, 8, 9):
        after = put(process, posteriors, point, 0.5, index, where=place)
        # The factors are badly conditioned, so their entries agree less well than what they predict.
        assert_close(taken(after, place), put(process, posterior, point, 0.5, index), 1e-6)
        assert after.count[where] == max(index + 1, 9)
        assert_same_bits(written(posterior, after, where), posteriors)
        assert_same_bits(put(process, posteriors, point, 0.5, index, given=False, where=place), posteriors)
    if not normalise:
        lean = appending(SQUARED_EXPONENTIAL)
        posterior = empty(lean)
        for index in range(9):
            posterior = append(lean, posterior, point * index, 0.5)[1]
        posteriors = jax.tree.map(many, posterior)
        deviation, after = append(lean, posteriors, point, 0.5, where=place)
        told = uncertainty(lean, posterior, (), jnp.asarray(point))
        np.testing.assert_allclose(deviation, told, rtol=1e-12)
        assert_close(taken(after, place), append(lean, posterior, point, 0.5)[1], 1e-9)
        assert_same_bits(written(posterior, after, where), posteriors)
        assert_same_bits(append(lean, posteriors, point, 0.5, given=False, where=place)[1], posteriors)


@each_scaling
@pytest.mark.slow
def test_a_batch_is_its_members(normalise):
    process = make(normalise)
    lanes = [filled(process, count, seed=count) for count in (0, 3, 8, 15)]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *lanes)
    rng = np.random.default_rng(4)
    points, targets = rng.normal(size=(4, 3)), rng.normal(size=4)
    index, given = np.array([0, 1, 8, 15], np.int32), np.array([True, True, False, True])
    put_all = jax.jit(jax.vmap(lambda posterior, *rest: _put(process, posterior, (), *rest)))
    together = jax.tree.map(np.asarray, put_all(stacked, points, targets, index, given))
    for i, lane in enumerate(lanes):
        alone = put(process, lane, points[i], targets[i], index[i], given[i])
        # The factors are badly conditioned, so their entries agree less well than what they predict.
        assert_close(jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], together), alone, 1e-6)
        member = jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], together)
        probes = rng.normal(size=(3, 3))
        np.testing.assert_allclose(
            predict(process, member, probes), predict(process, alone, probes), atol=1e-12
        )


class TestNormalisingScale:
    def scale(self, rows, count=None):
        width = np.shape(rows)[1]
        points = np.zeros((CAPACITY, 4))
        points[: len(rows), :width] = rows
        points[len(rows) :] = 1e9  # unused rows must not matter
        active = np.arange(CAPACITY) < (len(rows) if count is None else count)
        return np.asarray(scaled(points, active))[:width]

    def test_is_the_inverse_standard_deviation_over_the_points_in_use(self):
        rows = np.random.default_rng(5).normal(size=(9, 4)) * [1.0, 10.0, 1e-3, 1e5] + [0.0, 100.0, 1.0, -1e5]
        np.testing.assert_allclose(self.scale(rows), 1 / rows.std(0, ddof=0), rtol=1e-9)

    def test_is_one_for_fewer_than_two_points(self):
        np.testing.assert_array_equal(self.scale([[3.0, -2.0]]), 1.0)
        np.testing.assert_array_equal(self.scale([[3.0, -2.0]], count=0), 1.0)

    def test_is_one_for_a_constant_column(self):
        rows = np.column_stack([np.full(7, 0.1), np.arange(7.0)])
        got = self.scale(rows)
        assert got[0] == 1.0
        np.testing.assert_allclose(got[1], 1 / rows[:, 1].std())

    def test_the_smallest_deviation_that_counts(self):
        """Two points 2 sigma apart deviate by sigma."""
        below, above = 0.999e-6, 1.001e-6
        got = self.scale([[-below, -above], [below, above]])
        assert got[0] == 1.0
        np.testing.assert_allclose(got[1], 1 / above)


def test_normalised_predictions_ignore_units_and_offsets():
    """A dimension in other units, from another zero, makes no difference; one that is constant has no say."""
    process, rng = make(True), np.random.default_rng(6)
    rows, targets = rng.normal(size=(8, 3)), rng.normal(size=8)
    factors, offsets = np.array([1e3, 0.01, 1.0]), np.array([5.0, -1.0, 0.0])
    plain, moved = empty(process), empty(process)
    for index, (row, target) in enumerate(zip(rows, targets, strict=True)):
        plain = put(process, plain, row, target, index)
        moved = put(process, moved, row * factors + offsets, target, index)
    probes = rng.normal(size=(4, 3))
    np.testing.assert_allclose(
        predict(process, moved, probes * factors + offsets), predict(process, plain, probes), atol=1e-10
    )
