"""Comparing pytrees of arrays."""

from typing import Any

import jax
import numpy as np


def assert_same_bits(got: Any, expected: Any) -> None:
    """Every leaf has the same type, shape and bytes: NaN equals NaN, and -0 is not 0."""
    for path, a, b in _pairs(got, expected):
        assert (a.dtype, a.shape) == (b.dtype, b.shape), path
        if a.tobytes() != b.tobytes():
            np.testing.assert_array_equal(a, b, err_msg=path)
            raise AssertionError(f"{path}: equal, but not to the bit")


def assert_close(got: Any, expected: Any, atol: float) -> None:
    """Every leaf has the same shape and is near: `atol` is absolute."""
    for path, a, b in _pairs(got, expected):
        np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=path)


def _pairs(got: Any, expected: Any) -> list[tuple[str, np.ndarray, np.ndarray]]:
    assert jax.tree.structure(got) == jax.tree.structure(expected)
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(got)]
    leaves = (map(np.asarray, jax.tree.leaves(tree)) for tree in (got, expected))
    return list(zip(paths, *leaves, strict=True))
