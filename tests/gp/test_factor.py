"""The inverse root against dense factorisations, over generated sequences of append and replace."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpcjax.gp import cholesky, factor, tiles
from tests.trees import assert_same_bits

CAPACITY = 12
NOISE = 1e-7
LATTICE = 4
"""Points lie on a lattice of 4 x 4, or near one of its nodes: repeats are frequent."""

SIZES = (5, 100, 300, 520)
"""No multiples of a tile."""

each_size = pytest.mark.parametrize(
    "capacity", [300, *(pytest.param(size, marks=pytest.mark.slow) for size in (5, 100, 520))]
)

LONGEST = 40
"""Steps of a generated sequence."""


def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.exp(-np.sqrt(((a - b) ** 2).sum(-1)) / 2)


def gram(points: np.ndarray, noise: float) -> np.ndarray:
    return covariance(points[:, None], points[None]) + noise * np.eye(len(points))


class Dense:
    """The points of a dictionary, and what its root must be."""

    def __init__(self, noise: float = NOISE, capacity: int = CAPACITY, points=()):
        self.points, self.noise, self.capacity = np.reshape(points, (-1, 2)), noise, capacity

    @property
    def count(self) -> int:
        return len(self.points)

    @property
    def matrix(self) -> np.ndarray:
        return gram(self.points, self.noise)

    def root(self, rng: np.random.Generator | None = None) -> jax.Array:
        """The lower triangular one; with `rng` another that has the same Gram matrix, as after replacements."""
        root = np.linalg.inv(np.linalg.cholesky(self.matrix))
        for mirror in () if rng is None else rng.normal(size=(3, len(root))):
            root -= np.outer(2 * mirror / (mirror @ mirror), mirror @ root)
        return square(root, self.capacity)

    def covariances(self, point: np.ndarray) -> np.ndarray:
        return np.pad(covariance(self.points, point), (0, self.capacity - self.count))

    def learn(self, roots, index: int, point: np.ndarray, where=(), given: bool = True):
        """Puts `point` at `index`: the first that is free, or one in use. Gives new roots, edit and old column."""
        change = roots, where, self.count, index, self.covariances(point), self.noise, given
        if given:
            self._keep(index, point)
        return put(*change)

    def learn_all(self, root: jax.Array, steps, length: int) -> jax.Array:
        """The root after (index, point) of each step, in one program for sequences of up to `length`."""
        counts, indices = np.zeros((2, length), np.int32)
        covariances, given = np.zeros((length, self.capacity)), np.arange(length) < len(steps)
        for step, (index, point) in enumerate(steps):
            counts[step], indices[step] = self.count, min(index, self.count)
            covariances[step] = self.covariances(point)
            self._keep(indices[step], point)
        return put_all(root, counts, indices, covariances, self.noise, given)

    def _keep(self, index: int, point: np.ndarray) -> None:
        if index < self.count:
            self.points = np.where(np.arange(self.count)[:, None] == index, point, self.points)
        else:
            self.points = np.vstack([self.points, point])

    def check_inverse(self, root: jax.Array, tolerance: float) -> None:
        """S^T S (K + noise I) = I on the points in use, and zero rows and columns elsewhere."""
        root, n = np.asarray(root), self.count
        assert not root[n:].any() and not root[:, n:].any()
        kept = root[:n, :n]
        np.testing.assert_allclose(kept.T @ kept @ self.matrix, np.eye(n), atol=tolerance)

    def check_deviations(self, root: jax.Array, tolerance: float) -> None:
        """What the root says of the uncertainty at every node of the lattice."""
        nodes = np.stack(np.meshgrid(*[np.arange(LATTICE)] * 2), -1).reshape(-1, 2)
        k = covariance(self.points[:, None], nodes[None])
        explained = (k * np.linalg.solve(self.matrix, k)).sum(0)
        parts = explain_each(root, (), self.count, np.stack([self.covariances(node) for node in nodes]))
        got, expected = (
            np.sqrt(np.maximum(1 + self.noise - part, self.noise)) for part in (parts, explained)
        )
        np.testing.assert_allclose(got, expected, atol=tolerance)


def in_numpy(function, **options):
    """`function` compiled, whose results are taken to pieces and compared without programs of their own."""
    compiled = jax.jit(function, **options)
    return lambda *arguments: jax.tree.map(np.asarray, compiled(*arguments))


explain, read, new_row = in_numpy(factor.explained), in_numpy(factor.read), in_numpy(factor.new_row)
explain_each = in_numpy(jax.vmap(factor.explained, (None, None, None, 0)))
explain_lower, read_lower = (
    in_numpy(lambda *each, function=function: function(*each, lower=True))
    for function in (factor.explained, factor.read)
)
append = in_numpy(factor.append)
matrix_of = in_numpy(factor.dense, static_argnums=(1, 2))
empty = np.asarray(factor.empty(CAPACITY))


def square(root: np.ndarray, capacity: int) -> np.ndarray:
    """As roots are kept that are not lower ones."""
    size = jax.eval_shape(lambda: factor.empty(capacity)).shape[0]
    return np.pad(root, (0, size - len(root)))


@in_numpy
def append_all(rows, count):
    """A lower root with the first `count` rows, one after the other."""
    start = factor.empty(len(rows), lower=True)
    return jax.lax.fori_loop(0, count, lambda i, kept: factor.append(kept, (), i, rows[i]), start)


def lower(root: np.ndarray, capacity: int) -> np.ndarray:
    """As roots are kept to which points were only appended."""
    return append_all(np.pad(root, (0, capacity - len(root))), len(root))


def put_back(roots, where, root) -> np.ndarray:
    """The roots with another at `where`."""
    roots = np.array(roots)
    roots[where] = root
    return roots


@jax.jit
def put(roots, where, count, index, covariances, noise, given):
    """What `Replacing` does with a root."""
    reading = factor.read(roots, where, count, covariances, index)
    edit = factor.edit(roots, where, count, index, reading, 1.0 + noise, noise)
    return factor.write(roots, where, count, edit, given), edit, reading.column


@jax.jit
def put_all(root, counts, indices, covariances, noise, given):
    """`put` for each row, one after the other."""
    rows = (counts, indices, covariances, given)
    step = lambda root, row: (put(root, (), *row[:3], noise, row[3])[0], None)  # noqa: E731
    return jax.lax.scan(step, root, rows)[0]


near_a_node = st.builds(
    lambda node, shift: np.array(node, float) + shift,
    st.tuples(*[st.integers(0, LATTICE - 1)] * 2),
    st.sampled_from([0.0, 0.1, -0.01, 1e-3, 1e-6]),
)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, CAPACITY - 1), near_a_node), min_size=1, max_size=LONGEST))
def test_generated_sequences_of_append_and_replace(steps):
    """An index in use is replaced, any other means the first free one. Repeats make K singular up to the noise."""
    dense, firm = Dense(), Dense(noise=1e-2)
    dense.check_deviations(dense.learn_all(empty, steps, LONGEST), 5e-9)
    firm.check_inverse(firm.learn_all(empty, steps, LONGEST), 1e-12)


def test_appending_gives_the_inverse_of_the_cholesky_factor():
    rng, dense, root = np.random.default_rng(1), Dense(), empty
    for index in range(CAPACITY):
        root = dense.learn(root, index, rng.normal(size=2))[0]
    root = matrix_of(root, CAPACITY)
    np.testing.assert_allclose(root @ np.linalg.cholesky(dense.matrix), np.eye(CAPACITY), atol=1e-12)
    np.testing.assert_array_equal(np.triu(root, 1), 0.0)


def test_thousands_of_replacements_lose_no_digits():
    """In a dictionary that was filled first."""
    rng, dense = np.random.default_rng(2), Dense(capacity=40)
    root = factor.empty(40)
    indices = np.append(np.arange(40), rng.integers(40, size=2460))
    for part in np.split(indices, 5):
        root = dense.learn_all(root, [(index, 6 * rng.normal(size=2)) for index in part], len(part))
        dense.check_inverse(root, 1e-9)
        dense.check_deviations(root, 1e-12)


def test_what_edit_hands_back_updates_weights():
    """By the column p and the row w the precision matrix changes, and with it the weights."""
    rng = np.random.default_rng(3)
    dense, targets = Dense(points=rng.normal(size=(8, 2))), rng.normal(size=9)
    root = dense.root(rng)
    for index in (5, 8):
        before, after = (Dense(points=dense.points) for _ in range(2))
        new, edit, column = after.learn(root, index, np.array([0.3, 0.3]))
        root_before, new = matrix_of(root, CAPACITY), matrix_of(new, CAPACITY)
        precision = root_before.T @ root_before
        weights = precision[:8, :8] @ targets[:8]
        if index < 8:
            np.testing.assert_allclose(column, precision[index], rtol=1e-9, atol=1e-9)
            precision = precision - np.outer(column, column) / column[index]
            weights = weights - column[:8] * (weights[index] / column[index])
        expected = precision + np.outer(edit.row, edit.row)
        np.testing.assert_allclose(new.T @ new, expected, atol=1e-9 * expected.max())
        n = after.count
        weights = np.pad(weights, (0, n - 8)) * (np.arange(n) != index)
        weights = weights + np.asarray(edit.row)[:n] * (np.asarray(edit.row)[:n] @ targets[:n])
        np.testing.assert_allclose(weights, np.linalg.solve(after.matrix, targets[:n]), rtol=1e-9)
        assert before.count == 8


def borders(capacity: int) -> set[int]:
    """Where tiles end, and on both sides of it."""
    ends = [*range(0, min(capacity, 3 * tiles.ROWS) + 1, tiles.ROWS)]
    ends += [*range(0, capacity + 1, tiles.COLUMNS), capacity - capacity % tiles.ROWS, capacity]
    return {end + side for end in ends for side in (-1, 0, 1) if 1 <= end + side <= capacity}


def counts(capacity: int) -> list[int]:
    """Points of roots with that room: of the borders those that no smaller of the `SIZES` has as well, and a few."""
    smaller = [size for size in SIZES if tiles.COLUMNS < size < capacity]
    met = set().union(*map(borders, smaller)) - {1, tiles.ROWS + 1, tiles.COLUMNS, tiles.COLUMNS + 1}
    return sorted(borders(capacity) - met)


@each_size
def test_on_both_sides_of_the_borders_of_tiles(capacity):
    """A root that replacements have filled: read, one point appended, one replaced in several rows."""
    rng = np.random.default_rng(capacity)
    for count in counts(capacity):
        points, point = rng.uniform(-9, 9, (count, 2)), rng.uniform(-9, 9, 2)
        dense = Dense(1e-2, capacity, points)
        root, k = dense.root(rng), dense.covariances(point)
        whole = matrix_of(root, capacity)
        reading = read(root, (), count, k, count - 1)
        np.testing.assert_allclose(reading.explained, ((whole @ k) ** 2).sum(), atol=1e-12)
        assert explain(root, (), count, k) == reading.explained
        np.testing.assert_allclose(reading.solved, whole.T @ (whole @ k), atol=1e-11)
        np.testing.assert_allclose(reading.column, whole.T @ whole[:, count - 1], atol=1e-10)
        assert not read(root, (), count, k).column.any()
        for index in {0, count - 1, min(count, capacity - 1), (count - 1) // tiles.ROWS * tiles.ROWS}:
            after = Dense(1e-2, capacity, points)
            new, _, _ = after.learn(root, index, point)
            after.check_inverse(new, 1e-11)
            if index == count:
                assert_same_bits(put_back(new, count, 0.0), root)


@pytest.mark.parametrize(
    "capacity", [300, *(pytest.param(size, marks=pytest.mark.slow) for size in (5, 100, 520, 700))]
)
def test_appending_against_a_dense_solve(capacity):
    """To a lower root, on both sides of the borders of tiles; up to 600 points."""
    rng, last = np.random.default_rng(capacity), min(capacity, 600)
    points = rng.uniform(-5, 5, (last, 2))
    points[1::7] = points[::7][: len(points[1::7])] + 1e-3
    lower_factor = np.linalg.cholesky(gram(points, NOISE))
    inverse = np.linalg.inv(lower_factor)
    for count in (count for count in (0, *counts(capacity)) if count < last):
        kept = lower(inverse[:count, :count], capacity)
        matrix = matrix_of(kept, capacity, True)
        np.testing.assert_array_equal(matrix[:count, :count], np.tril(inverse[:count, :count]))
        assert not matrix[count:].any() and not matrix[:, count:].any()
        k = Dense(NOISE, capacity, points[:count]).covariances(points[count])
        reading = read_lower(kept, (), count, k)
        assert explain_lower(kept, (), count, k) == reading.explained
        deviation, row = new_row(reading.solved, reading.explained, count, 1 + NOISE, NOISE)
        np.testing.assert_allclose(deviation, lower_factor[count, count], rtol=1e-8)
        np.testing.assert_allclose(
            row[: count + 1], inverse[count, : count + 1], atol=1e-8 * np.abs(row).max()
        )
        assert not row[count + 1 :].any()


def test_appended_one_by_one_as_put():
    """A lower root and one of which points could go: the same, along a whole sequence."""
    rng, capacity = np.random.default_rng(8), 60
    dense, root = Dense(1e-4, capacity), factor.empty(capacity)
    appended = factor.empty(capacity, lower=True)
    for count in range(capacity):
        point = 3 * rng.normal(size=2)
        reading = read_lower(appended, (), count, dense.covariances(point))
        deviation, row = new_row(reading.solved, reading.explained, count, 1.0 + 1e-4, 1e-4)
        appended = append(appended, (), count, row)
        root, _, _ = dense.learn(root, count, point)
        np.testing.assert_allclose(deviation, 1 / row[count], rtol=1e-12)
    appended = matrix_of(appended, capacity, True)
    np.testing.assert_allclose(appended, matrix_of(root, capacity), atol=1e-9)
    dense.check_inverse(appended, 1e-9)


@pytest.mark.parametrize(
    ("small", "large"),
    [
        (5, 48),
        (130, 256),
        *(pytest.param(*pair, marks=pytest.mark.slow) for pair in ((48, 64), (64, 300), (300, 512))),
    ],
)
@pytest.mark.parametrize("is_lower", [pytest.param(False, marks=pytest.mark.slow), True])
def test_grown_roots_are_the_same(small, large, is_lower):
    """And take in further points."""
    rng = np.random.default_rng(small)
    dense = Dense(1e-2, small, rng.uniform(-5, 5, (small, 2)))
    root = np.linalg.inv(np.linalg.cholesky(dense.matrix))
    grown = factor.grow(jnp.asarray((lower if is_lower else square)(root, small)), large, is_lower)
    assert grown.shape == factor.empty(large, is_lower).shape
    expected = np.pad(np.tril(root) if is_lower else root, (0, large - small))
    np.testing.assert_array_equal(matrix_of(grown, large, is_lower), expected)
    dense.capacity = large
    k = dense.covariances(np.array([0.1, -0.2]))
    got = (read_lower if is_lower else read)(grown, (), small, k)
    np.testing.assert_allclose(got.solved, expected.T @ (expected @ k), atol=1e-11)


def test_a_lower_root_takes_half_of_the_room():
    assert factor.empty(2048, lower=True).size < 0.55 * factor.empty(2048).size


@pytest.mark.parametrize("where", [pytest.param((2,), marks=pytest.mark.slow), (1, 2)])
def test_one_of_many_places_touches_no_other(where):
    """The others are not even numbers."""
    rng, capacity, count = np.random.default_rng(9), 50, 40
    dense = Dense(1e-2, capacity, rng.normal(size=(count, 2)))
    root, point = dense.root(), np.array([0.1, 0.2])
    shape = (4, 3)[-len(where) :]
    roots = put_back(np.full(shape + root.shape, np.nan), where, root)
    place = tuple(map(jnp.asarray, where))
    k = dense.covariances(point)
    kept = lower(root[:count, :count], capacity)
    others = put_back(np.full(shape + kept.shape, np.nan), where, kept)
    for function, many, one in ((read, roots, root), (read_lower, others, kept)):
        got, alone = function(many, place, count, k), function(one, (), count, k)
        np.testing.assert_allclose(got.explained, alone.explained, rtol=1e-13)
        np.testing.assert_allclose(got.solved, alone.solved, atol=1e-13)
    for index in (0, 33, count):
        after = Dense(1e-2, capacity, dense.points)
        new, _, _ = after.learn(roots, index, point, place)
        after.check_inverse(np.asarray(new)[where], 1e-11)
        assert_same_bits(put_back(new, where, root), roots)
    row = np.arange(1.0, capacity + 1) * (np.arange(capacity) <= count)
    new = append(others, place, count, row)
    np.testing.assert_array_equal(matrix_of(new[where], capacity, True)[count], row)
    assert_same_bits(put_back(new, where, kept), others)
    assert_same_bits(append(others, place, capacity, row), others)


def test_not_given_nothing_changes_to_the_bit():
    """Not even where the inputs are not finite: this is what an idle lane of a batch is given."""
    rng = np.random.default_rng(4)
    dense = Dense(points=rng.normal(size=(8, 2)))
    root = dense.root(rng)
    for index in (0, 5, 8):
        for value in (1.0, np.nan, np.inf):
            same, _, _ = put(root, (), 8, index, np.full(CAPACITY, value), NOISE, False)
            assert_same_bits(same, root)
            other, _, _ = put(root, (), 8, index, np.full(CAPACITY, value), NOISE, True)
            assert not np.array_equal(other, root)


def test_rounding_cannot_take_the_variance_below_the_noise():
    """Of a point that repeats another, where the noise is lost beside the prior variance."""
    noise, k = 1e-20, np.eye(CAPACITY)[0]
    root = put(empty, (), 0, 0, np.zeros(CAPACITY), noise, True)[0]
    reading = read(root, (), 1, k)
    deviation, row = new_row(reading.solved, reading.explained, 1, 1.0 + noise, noise)
    assert deviation == np.sqrt(noise) and row[1] == 1 / deviation
    _, edit, _ = put(root, (), 1, 1, k, noise, True)
    np.testing.assert_allclose(edit.row, row, rtol=1e-12)


def test_a_batch_is_its_members():
    """Each lane replaces, appends or rests, at an index of its own."""
    rng, lanes = np.random.default_rng(5), []
    for lane in range(6):
        dense = Dense(points=rng.normal(size=(3 + lane, 2)))
        index = lane if lane % 2 else 3 + lane
        k = dense.covariances(rng.normal(size=2))
        lanes.append((dense.root(rng), dense.count, index, k, NOISE, lane != 4))
    arguments = [np.stack(values) for values in zip(*lanes, strict=True)]
    together = jax.jit(jax.vmap(lambda root, *rest: put(root, (), *rest)[0]))(*arguments)
    for got, (root, *rest) in zip(np.asarray(together), lanes, strict=True):
        np.testing.assert_allclose(got, put(root, (), *rest)[0], atol=1e-9)


@pytest.mark.parametrize("index", [7, 90])
def test_donated_roots_are_written_in_place(index):
    """The same numbers, in the memory of the old roots, and no copy of them in between."""
    rng, capacity, where = np.random.default_rng(10), 100, (jnp.asarray(1), jnp.asarray(0))
    dense = Dense(1e-2, capacity, 5 * rng.normal(size=(90, 2)))
    root = dense.root(rng)
    roots = jnp.asarray(put_back(np.zeros((3, 2, *root.shape)), (1, 0), root))
    arguments = where, 90, index, dense.covariances(np.zeros(2)), 1e-2, True
    expected = put(roots, *arguments)[0]
    compiled = jax.jit(lambda *each: put(*each)[0], donate_argnums=0).lower(roots, *arguments).compile()
    text = compiled.as_text()
    assert "f64[3,2,104,104]" in text
    assert not re.search(r"= f64\[3,2,104,104\]\S* copy\(", text)
    memory = roots.unsafe_buffer_pointer()
    got = compiled(roots, *arguments)
    assert roots.is_deleted() and got.unsafe_buffer_pointer() == memory
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_masked_cholesky():
    """Of the points in use only; unused rows are the identity's, whatever the Gram matrix says there."""
    rng = np.random.default_rng(6)
    points, active = rng.normal(size=(CAPACITY, 2)), np.arange(CAPACITY) < 7
    full = gram(points, 0.0)
    full[:, 7:] = np.nan
    full[7:] = np.nan
    lower = in_numpy(cholesky.factor)(full, active, NOISE)
    expected = np.eye(CAPACITY)
    expected[:7, :7] = np.linalg.cholesky(full[:7, :7] + NOISE * np.eye(7))
    np.testing.assert_allclose(np.tril(lower), expected, atol=1e-12)

    vector = rng.normal(size=CAPACITY)
    solve = in_numpy(cholesky.solve, static_argnums=2)
    np.testing.assert_allclose(expected @ solve(lower, vector), vector, atol=1e-9)
    transposed = solve(lower, vector, True)
    np.testing.assert_allclose(expected.T @ transposed, vector, atol=1e-9)


def test_an_empty_dictionary():
    """And one that holds a single point, which another one replaces."""
    assert explain(empty, (), 0, np.ones(CAPACITY)) == 0.0
    dense = Dense()
    deviation, row = new_row(np.zeros(CAPACITY), 0.0, 0, 1 + NOISE, NOISE)
    assert deviation == np.sqrt(1 + NOISE) and row[0] == 1 / deviation and not row[1:].any()
    first, _, _ = dense.learn(empty, 0, np.zeros(2))
    first = np.asarray(first)
    # A processor may take the reciprocal root of another rounding.
    np.testing.assert_allclose(first[0, 0], 1 / np.sqrt(1 + NOISE), rtol=4e-16)
    assert np.count_nonzero(first) == 1
    second, _, _ = dense.learn(first, 0, np.ones(2))
    assert_same_bits(second, first)
