"""Arrays as bytes beside a card of JSON values: how the store keeps what was learned. Loads no jax."""

import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

MOST_TEXT = 2**30
"""Bytes of JSON that are expanded from compressed ones."""


def compressed(value: Any) -> bytes:
    """A JSON value in few bytes, however much of it is said again and again."""
    return zlib.compress(json.dumps(value, separators=(",", ":")).encode())


def expanded(data: bytes) -> Any:
    """What `compressed` was given. Raises ValueError."""
    expander = zlib.decompressobj()
    try:
        text = expander.decompress(data, MOST_TEXT)
    except zlib.error as error:
        raise ValueError(f"bytes that are not compressed JSON ({error})") from None
    if not expander.eof:
        raise ValueError("compressed JSON that is cut, or too long")
    return json.loads(text)


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
