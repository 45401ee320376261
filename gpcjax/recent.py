"""What is kept of things that are made when they are first asked for: those asked for last. Loads no jax."""

import contextlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def recent(kept: "OrderedDict[Any, T]", key: Any, make: Callable[[], T], most: int) -> T:
    """What is kept under a key, made if it is not there; only the last `most` stay. Threads may use one table."""
    found = kept.get(key)
    if found is None:
        found = kept[key] = make()
        while len(kept) > most:
            with contextlib.suppress(KeyError):  # another thread was quicker
                kept.popitem(last=False)
    else:
        with contextlib.suppress(KeyError):  # another thread has dropped it since
            kept.move_to_end(key)
    return found
