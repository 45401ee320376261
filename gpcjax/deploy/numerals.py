"""Numbers as source code has them: each is the shortest text that is read as the same float64. No jax."""

import textwrap
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float


def numerals(values: Float[np.ndarray, "..."], indent: str, width: int = 100) -> str:
    """All finite numbers of an array in C's order, with commas, on lines of at most `width` letters.

    Python and C write such numbers alike: with a point or an exponent, so that none is an integer.
    """
    return wrapped(map(repr, np.asarray(values, np.float64).ravel().tolist()), indent, width)


def wrapped(texts: Iterable[str], indent: str, width: int = 100) -> str:
    """Texts without spaces, with commas, on lines of at most `width` letters."""
    lines = textwrap.wrap(
        ", ".join(texts), width - len(indent), break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(indent + line for line in lines)
