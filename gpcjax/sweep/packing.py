"""Arrays as bytes beside a card of JSON values: how the store keeps what was learned. Loads no jax."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np


def packed(card: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[str, bytes]:
    """A card and the bytes of its arrays, to the bit."""
    forms = {name: [value.dtype.str, list(value.shape)] for name, value in arrays.items()}
    content = b"".join(np.ascontiguousarray(value).tobytes() for value in arrays.values())
    return json.dumps({**card, "arrays": forms}), content


def unpacked(card: str, content: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What `packed` was given.

    Raises:
        ValueError, KeyError, TypeError: the bytes are not what the card says.
    """
    told = json.loads(card)
    arrays, first = {}, 0
    for name, (kind, shape) in told.pop("arrays").items():
        dtype = np.dtype(kind)
        if dtype.hasobject:
            raise ValueError(f"{name} holds no numbers")
        size = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(content, dtype, size, first).reshape(shape)
        first += size * dtype.itemsize
    if first != len(content):
        raise ValueError(f"{len(content) - first} bytes are left over")
    return told, arrays
