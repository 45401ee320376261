"""The inverse root against dense factorisations, over generated sequences of append and replace."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gpcjax.gp import factor
from tests.trees import assert_same_bits

CAPACITY = 12
NOISE = 1e-7
LATTICE = 4
"""Points lie on a lattice of 4 x 4, or near one of its nodes: repeats are frequent."""


def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.exp(-np.sqrt(((a - b) ** 2).sum(-1)) / 2)


def gram(points: np.ndarray) -> np.ndarray:
    return covariance(points[:, None], points[None])


class Dense:
    """The points of a dictionary, and what its root must be."""

    def __init__(self, noise: float = NOISE):
        self.points, self.used, self.noise = np.zeros((CAPACITY, 2)), np.zeros(CAPACITY, bool), noise

    @property
    def matrix(self) -> np.ndarray:
        return gram(self.points[self.used]) + self.noise * np.eye(self.used.sum())

    def covariances(self, point: np.ndarray) -> np.ndarray:
        return np.where(self.used, covariance(self.points, point), 0.0)

    def learn(self, root: jax.Array, index: int, point: np.ndarray) -> jax.Array:
        """Puts `point` at `index`, be it free or in use; gives the new root."""
        replaced = bool(self.used[index])
        self.used[index] = False
        covariances = self.covariances(point)
        self.points[index], self.used[index] = point, True
        return put(root, index, replaced, jnp.asarray(covariances), self.noise, True)

    def check_inverse(self, root: jax.Array, tolerance: float) -> None:
        """S^T S (K + noise I) = I on the points in use, and zero rows and columns elsewhere."""
        root = np.asarray(root)
        assert not root[~self.used].any() and not root[:, ~self.used].any()
        kept = root[np.ix_(self.used, self.used)]
        np.testing.assert_allclose(kept.T @ kept @ self.matrix, np.eye(self.used.sum()), atol=tolerance)

    def check_deviations(self, root: jax.Array, tolerance: float) -> None:
        """What the root says of the uncertainty at every node of the lattice."""
        nodes = np.stack(np.meshgrid(*[np.arange(LATTICE)] * 2), -1).reshape(-1, 2)
        k = covariance(self.points[self.used][:, None], nodes[None])
        explained = (k * np.linalg.solve(self.matrix, k)).sum(0)
        whitened = np.asarray(root)[:, self.used] @ k
        got, expected = (
            np.sqrt(np.maximum(1 + self.noise - part, self.noise))
            for part in ((whitened**2).sum(0), explained)
        )
        np.testing.assert_allclose(got, expected, atol=tolerance)


@jax.jit
def put(root, index, replaced, covariances, noise, write):
    """What `GaussianProcess` does with a root: remove the old point, append the new one."""
    root, _ = factor.remove(root, index, replaced & write)
    whitened = factor.whiten(root, covariances)
    variance = jnp.maximum(1.0 + noise - (whitened * whitened).sum(), noise)
    return factor.append(root, index, whitened, variance, write)[0]


near_a_node = st.builds(
    lambda node, shift: np.array(node, float) + shift,
    st.tuples(*[st.integers(0, LATTICE - 1)] * 2),
    st.sampled_from([0.0, 0.1, -0.01, 1e-3, 1e-6]),
)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, CAPACITY - 1), near_a_node), min_size=1, max_size=40))
def test_generated_sequences_of_append_and_replace(steps):
    """A free index is appended wherever it is, one in use is replaced. Repeats make K singular up to the noise."""
    dense, root = Dense(), jnp.zeros((CAPACITY, CAPACITY))
    firm, firm_root = Dense(noise=1e-2), root
    for index, point in steps:
        root, firm_root = dense.learn(root, index, point), firm.learn(firm_root, index, point)
    dense.check_deviations(root, 1e-9)
    firm.check_inverse(firm_root, 1e-12)


def test_appending_in_order_gives_the_inverse_of_the_cholesky_factor():
    rng, dense, root = np.random.default_rng(1), Dense(), jnp.zeros((CAPACITY, CAPACITY))
    for index in range(CAPACITY):
        root = dense.learn(root, index, rng.normal(size=2))
    lower = np.linalg.cholesky(gram(dense.points) + NOISE * np.eye(CAPACITY))
    np.testing.assert_allclose(root @ lower, np.eye(CAPACITY), atol=1e-12)
    np.testing.assert_array_equal(np.triu(root, 1), 0.0)


def test_thousands_of_replacements_lose_no_digits():
    rng, dense, root = np.random.default_rng(2), Dense(), jnp.zeros((CAPACITY, CAPACITY))
    for step in range(5000):
        root = dense.learn(root, int(rng.integers(CAPACITY)), 3 * rng.normal(size=2))
        if step % 500 == 499:
            dense.check_inverse(root, 1e-9)
            dense.check_deviations(root, 1e-12)


def test_what_append_and_remove_hand_back_updates_weights():
    """The row w and the column p are those by which the precision matrix changes."""
    rng, dense, root = np.random.default_rng(3), Dense(), jnp.zeros((CAPACITY, CAPACITY))
    for index in range(8):
        root = dense.learn(root, index, rng.normal(size=2))
    precision = np.asarray(root.T @ root)
    smaller, column = factor.remove(root, jnp.asarray(5), jnp.asarray(True))
    np.testing.assert_allclose(column, precision[5], rtol=1e-12)
    outer = np.outer(precision[5], precision[5]) / precision[5, 5]
    np.testing.assert_allclose(smaller.T @ smaller, precision - outer, atol=1e-9 * precision.max())

    covariances = jnp.asarray(dense.covariances(np.array([0.3, 0.3])))
    whitened = factor.whiten(root, covariances)
    variance = 1.0 + NOISE - (whitened * whitened).sum()
    larger, row = factor.append(root, jnp.asarray(8), whitened, variance, jnp.asarray(True))
    np.testing.assert_allclose(larger.T @ larger, precision + np.outer(row, row), atol=1e-9 * precision.max())


def test_without_write_nothing_changes_to_the_bit():
    """Not even where the inputs are not finite: this is what an idle lane of a batch is given."""
    rng, dense, root = np.random.default_rng(4), Dense(), jnp.zeros((CAPACITY, CAPACITY))
    for index in range(8):
        root = dense.learn(root, index, rng.normal(size=2))
    no, nan = jnp.asarray(False), jnp.asarray(jnp.nan)
    for index in (0, 5, 9):
        removed, _ = factor.remove(root, jnp.asarray(index), no)
        assert_same_bits(removed, root)
        for value in (1.0, jnp.nan, jnp.inf):
            appended, row = factor.append(root, jnp.asarray(index), jnp.full(CAPACITY, value), nan, no)
            assert_same_bits(appended, root)
            np.testing.assert_array_equal(row, 0.0)


def test_a_batch_is_its_members():
    """Each lane replaces, appends or rests, at an index of its own."""
    rng = np.random.default_rng(5)
    lanes, arguments = [], []
    for lane in range(6):
        dense, root = Dense(), jnp.zeros((CAPACITY, CAPACITY))
        for index in range(3 + lane):
            root = dense.learn(root, index, rng.normal(size=2))
        index = lane if lane % 2 else 3 + lane
        replaced, write = bool(dense.used[index]), lane != 4
        dense.used[index] = False
        lanes.append(
            (root, index, replaced, jnp.asarray(dense.covariances(rng.normal(size=2))), NOISE, write)
        )
    arguments = [jnp.stack([jnp.asarray(value) for value in values]) for values in zip(*lanes, strict=True)]
    together = jax.vmap(put)(*arguments)
    for got, lane in zip(together, lanes, strict=True):
        np.testing.assert_allclose(got, put(*lane), atol=1e-9)


def test_masked_cholesky():
    """Of the points in use only; unused rows are the identity's, whatever the Gram matrix says there."""
    rng = np.random.default_rng(6)
    points, active = rng.normal(size=(CAPACITY, 2)), np.arange(CAPACITY) < 7
    full = gram(points)
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
    root = jnp.zeros((CAPACITY, CAPACITY))
    np.testing.assert_array_equal(factor.whiten(root, jnp.ones(CAPACITY)), 0.0)
    first = put(root, 0, False, jnp.zeros(CAPACITY), NOISE, True)
    assert first[0, 0] == 1 / np.sqrt(1 + NOISE)
    assert jnp.count_nonzero(first) == 1
    gone, _ = factor.remove(first, jnp.asarray(0), jnp.asarray(True))
    np.testing.assert_array_equal(gone, 0.0)
