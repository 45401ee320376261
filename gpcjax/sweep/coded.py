"""Columns of few values as numbers, the same in all parts of a run folder. Loads no jax."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Int


class Coded(NamedTuple):
    """A column of few values: `values[codes]`, and no value where the code is -1."""

    codes: Int[np.ndarray, "cells"]
    values: tuple[Any, ...]


def joint(columns: Sequence[Int[np.ndarray, "rows"]]) -> Int[np.ndarray, "rows"]:
    """One number for each combination of codes (from -1): equal where all of them are."""
    number, count = np.zeros(len(columns[0]), np.int64), 1
    for codes in columns:
        span = int(codes.max(initial=-1)) + 2
        if count * span >= 1 << 62:
            known, number = np.unique(number, return_inverse=True)
            count = len(known)
        number, count = number * span + (codes.astype(np.int64) + 1), count * span
    return number


class Values:
    """The values of each column in all parts, numbered as they come."""

    def __init__(self) -> None:
        self._numbers: dict[str, dict[Any, int]] = {}

    def coded(self, name: str, column: pa.ChunkedArray) -> Coded:
        """The column of a part, by the numbers that hold for all parts."""
        encoded = column.combine_chunks().dictionary_encode()
        numbers = self._numbers.setdefault(name, {})
        known = [numbers.setdefault(value, len(numbers)) for value in encoded.dictionary.to_pylist()]
        place = encoded.indices.fill_null(len(known)).to_numpy(zero_copy_only=False)
        return Coded(np.array([*known, -1], np.int32)[place], tuple(numbers))
