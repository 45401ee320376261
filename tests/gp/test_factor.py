"""The inverse root against dense factorisations, over generated sequences of append and replace."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpcjax.gp import factor
from tests.trees import assert_same_bits

CAPACITY = 12
NOISE = 1e-7
LATTICE = 4
"""Points lie on a lattice of 4 x 4, or near one of its nodes: repeats are frequent."""

SIZES = (5, 33, 100, 300, 520)
"""No multiples of the rows and columns that are read at once."""


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
        if rng is not None:
            root = np.linalg.qr(rng.normal(size=root.shape))[0] @ root
        return jnp.asarray(np.pad(root, (0, self.capacity - self.count)))

    def covariances(self, point: np.ndarray) -> jax.Array:
        return jnp.asarray(np.pad(covariance(self.points, point), (0, self.capacity - self.count)))

    def learn(self, roots, index: int, point: np.ndarray, where=(), given: bool = True):
        """Puts `point` at `index`: the first that is free, or one in use. Gives new roots, edit and old column."""
        change = roots, where, self.count, index, self.covariances(point), self.noise, given
        if given and index < self.count:
            self.points = np.where(np.arange(self.count)[:, None] == index, point, self.points)
        elif given:
            self.points = np.vstack([self.points, point])
        return put(*change)

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
        whitened = [whiten(root, (), self.count, self.covariances(node)) for node in nodes]
        got, expected = (
            np.sqrt(np.maximum(1 + self.noise - part, self.noise))
            for part in ((np.stack(whitened) ** 2).sum(1), explained)
        )
        np.testing.assert_allclose(got, expected, atol=tolerance)


whiten, write, append = jax.jit(factor.whiten), jax.jit(factor.write), jax.jit(factor.append)
empty = jnp.zeros((CAPACITY, CAPACITY))


@jax.jit
def put(roots, where, count, index, covariances, noise, given):
    """What `GaussianProcess` does with a root."""
    whitened = factor.whiten(roots, where, count, covariances)
    edit, column = factor.edit(roots, where, count, index, whitened, 1.0 + noise, noise)
    return factor.write(roots, where, count, edit, given), edit, column


near_a_node = st.builds(
    lambda node, shift: np.array(node, float) + shift,
    st.tuples(*[st.integers(0, LATTICE - 1)] * 2),
    st.sampled_from([0.0, 0.1, -0.01, 1e-3, 1e-6]),
)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, CAPACITY - 1), near_a_node), min_size=1, max_size=40))
def test_generated_sequences_of_append_and_replace(steps):
    """An index in use is replaced, any other means the first free one. Repeats make K singular up to the noise."""
    dense, root = Dense(), empty
    firm, firm_root = Dense(noise=1e-2), empty
    for index, point in steps:
        index = min(index, dense.count)
        root, firm_root = dense.learn(root, index, point)[0], firm.learn(firm_root, index, point)[0]
    dense.check_deviations(root, 5e-9)
    firm.check_inverse(firm_root, 1e-12)


def test_appending_gives_the_inverse_of_the_cholesky_factor():
    rng, dense, root = np.random.default_rng(1), Dense(), empty
    for index in range(CAPACITY):
        root = dense.learn(root, index, rng.normal(size=2))[0]
    np.testing.assert_allclose(root @ np.linalg.cholesky(dense.matrix), np.eye(CAPACITY), atol=1e-12)
    np.testing.assert_array_equal(np.triu(root, 1), 0.0)


def test_thousands_of_replacements_lose_no_digits():
    """In a dictionary that was filled first, and of which a block of rows is left over."""
    rng, dense = np.random.default_rng(2), Dense(capacity=40)
    root = jnp.zeros((40, 40))
    for step in range(5000):
        index = int(rng.integers(40)) if step >= 40 else step
        root = dense.learn(root, index, 6 * rng.normal(size=2))[0]
        if step % 500 == 499:
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
        precision = np.asarray(root.T @ root)
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


@pytest.mark.parametrize("capacity", SIZES)
def test_on_both_sides_of_the_borders_of_blocks(capacity):
    """A root that replacements have filled: whitened, one point appended, one replaced in several rows."""
    rng = np.random.default_rng(capacity)
    borders = [each for size in (factor.ROWS, factor.COLUMNS) for each in range(size, capacity, size)]
    borders = {*borders[:2], *borders[-2:], 1, capacity - capacity % factor.ROWS, capacity}
    for count in sorted({border + side for border in borders for side in (-1, 0, 1)}):
        if not 1 <= count <= capacity:
            continue
        points, point = rng.uniform(-9, 9, (count, 2)), rng.uniform(-9, 9, 2)
        dense = Dense(1e-2, capacity, points)
        root, k = dense.root(rng), dense.covariances(point)
        np.testing.assert_allclose(whiten(root, (), count, k), root @ k, atol=1e-12)
        indices = {0, count - 1, min(count, capacity - 1), (count - 1) // factor.ROWS * factor.ROWS}
        for index in indices:
            after = Dense(1e-2, capacity, points)
            new, _, _ = after.learn(root, index, point)
            after.check_inverse(new, 1e-11)
            if index == count:
                assert_same_bits(new.at[count].set(0.0), root)


@pytest.mark.parametrize("capacity", [*SIZES, 700])
def test_append_against_a_dense_solve(capacity):
    """One pass, on every side of the borders of blocks; up to 600 points."""
    rng, last = np.random.default_rng(capacity), min(capacity, 600)
    points = rng.uniform(-5, 5, (last, 2))
    points[1::7] = points[::7][: len(points[1::7])] + 1e-3
    lower = np.linalg.cholesky(gram(points, NOISE))
    inverse = np.linalg.inv(lower)
    borders = {0, 1, 2, last - 1}.union(
        *({border - 1, border, border + 1} for border in range(0, last, factor.ROWS))
    )
    for count in sorted(count for count in borders if 0 <= count < last):
        root = jnp.asarray(np.pad(inverse[:count, :count], (0, capacity - count)))
        dense = Dense(NOISE, capacity, points[:count])
        deviation, row = map(
            np.asarray, append(root, (), count, dense.covariances(points[count]), 1 + NOISE, NOISE)
        )
        np.testing.assert_allclose(deviation, lower[count, count], rtol=1e-8)
        expected = inverse[count, : count + 1]
        np.testing.assert_allclose(row[: count + 1], expected, atol=1e-8 * np.abs(row).max())
        assert not row[count + 1 :].any()


def test_appended_one_by_one_as_put():
    """Rows of `append` and roots of `write`: the same, along a whole sequence."""
    rng, capacity = np.random.default_rng(8), 70
    dense, root = Dense(1e-4, capacity), jnp.zeros((capacity, capacity))
    appended = root
    for count in range(capacity):
        point = 3 * rng.normal(size=2)
        k = dense.covariances(point)
        deviation, row = append(appended, (), count, k, 1.0 + 1e-4, 1e-4)
        appended = appended.at[count].set(row)
        root, _, _ = dense.learn(root, count, point)
        np.testing.assert_allclose(deviation, 1 / row[count], rtol=1e-12)
    np.testing.assert_allclose(appended, root, atol=1e-9)
    dense.check_inverse(appended, 1e-9)


@pytest.mark.parametrize("where", [(2,), (1, 2)])
def test_one_of_many_places_touches_no_other(where):
    """The others are not even numbers."""
    rng, capacity, count = np.random.default_rng(9), 50, 40
    dense = Dense(1e-2, capacity, rng.normal(size=(count, 2)))
    root, point = dense.root(), np.array([0.1, 0.2])
    roots = jnp.full((4, 3)[-len(where) :] + root.shape, jnp.nan).at[where].set(root)
    place = tuple(map(jnp.asarray, where))
    k = dense.covariances(point)
    np.testing.assert_allclose(whiten(roots, place, count, k), whiten(root, (), count, k), atol=1e-13)
    for got, alone in zip(
        append(roots, place, count, k, 1.01, 1e-2), append(root, (), count, k, 1.01, 1e-2), strict=True
    ):
        np.testing.assert_allclose(got, alone, atol=1e-13)
    for index in (0, 33, count):
        after = Dense(1e-2, capacity, dense.points)
        new, _, _ = after.learn(roots, index, point, place)
        after.check_inverse(new[where], 1e-11)
        assert_same_bits(new.at[where].set(root), roots)


def test_not_given_nothing_changes_to_the_bit():
    """Not even where the inputs are not finite: this is what an idle lane of a batch is given."""
    rng = np.random.default_rng(4)
    dense = Dense(points=rng.normal(size=(8, 2)))
    root = dense.root(rng)
    for index in (0, 5, 8):
        for value in (1.0, jnp.nan, jnp.inf):
            same, _, _ = put(root, (), 8, index, jnp.full(CAPACITY, value), NOISE, False)
            assert_same_bits(same, root)
            other, _, _ = put(root, (), 8, index, jnp.full(CAPACITY, value), NOISE, True)
            assert not np.array_equal(other, root)


def test_rounding_cannot_take_the_variance_below_the_noise():
    """Of a point that repeats another, where the noise is lost beside the prior variance."""
    noise, k = 1e-20, jnp.asarray(np.eye(CAPACITY)[0])
    root = put(empty, (), 0, 0, jnp.zeros(CAPACITY), noise, True)[0]
    deviation, row = append(root, (), 1, k, 1.0 + noise, noise)
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
    arguments = [jnp.stack([jnp.asarray(value) for value in values]) for values in zip(*lanes, strict=True)]
    together = jax.vmap(lambda root, *rest: put(root, (), *rest)[0])(*arguments)
    for got, (root, *rest) in zip(together, lanes, strict=True):
        np.testing.assert_allclose(got, put(root, (), *rest)[0], atol=1e-9)


@pytest.mark.parametrize("index", [7, 90])
def test_donated_roots_are_written_in_place(index):
    """The same numbers, in the memory of the old roots, and no copy of them in between."""
    rng, capacity, where = np.random.default_rng(10), 100, (jnp.asarray(1), jnp.asarray(0))
    dense = Dense(1e-2, capacity, 5 * rng.normal(size=(90, 2)))
    roots = jnp.zeros((3, 2, capacity, capacity)).at[where].set(dense.root(rng))
    arguments = where, 90, index, dense.covariances(np.zeros(2)), 1e-2, True
    expected = put(roots, *arguments)[0]
    compiled = jax.jit(lambda *each: put(*each)[0], donate_argnums=0).lower(roots, *arguments).compile()
    text = compiled.as_text()
    assert "f64[3,2,100,100]" in text
    assert not re.search(r"= f64\[3,2,100,100\]\S* copy\(", text)
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
    lower = factor.cholesky(jnp.asarray(full), jnp.asarray(active), jnp.asarray(NOISE))
    expected = np.eye(CAPACITY)
    expected[:7, :7] = np.linalg.cholesky(full[:7, :7] + NOISE * np.eye(7))
    np.testing.assert_allclose(np.tril(lower), expected, atol=1e-12)

    vector = rng.normal(size=CAPACITY)
    np.testing.assert_allclose(expected @ factor.solve(lower, jnp.asarray(vector)), vector, atol=1e-9)
    transposed = factor.solve(lower, jnp.asarray(vector), transpose=True)
    np.testing.assert_allclose(expected.T @ transposed, vector, atol=1e-9)


def test_an_empty_dictionary():
    """And one that holds a single point, which another one replaces."""
    np.testing.assert_array_equal(whiten(empty, (), 0, jnp.ones(CAPACITY)), 0.0)
    dense = Dense()
    deviation, row = append(empty, (), 0, jnp.zeros(CAPACITY), 1 + NOISE, NOISE)
    assert deviation == np.sqrt(1 + NOISE) and row[0] == 1 / deviation and not row[1:].any()
    first, _, _ = dense.learn(empty, 0, np.zeros(2))
    assert first[0, 0] == 1 / np.sqrt(1 + NOISE)
    assert jnp.count_nonzero(first) == 1
    second, _, _ = dense.learn(first, 0, np.ones(2))
    assert_same_bits(second, first)
