"""Figures as bytes, in all formats of a report at once: by this process and copies of it, one for each further core."""

import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from gpcjax.report.figures import style
from gpcjax.sweep import stopping
from gpcjax.sweep.executors.served import die_with_parent

FILES = ("png", "pdf")
"""The formats in which a figure lies beside a page."""


class Painted(NamedTuple):
    """A figure in every format."""

    files: dict[str, bytes]
    """By the names of `FILES`."""
    svg: bytes
    """For the page."""


def painted(figures: Sequence[Figure]) -> list[Painted]:
    """Every figure in every format: the bytes that `style.image` gives, in the order of the figures.

    Where this is the only thread of a process of Linux, and there is no jax, copies of it (forks) paint their part
    beside it: they have all that painting needs, which takes longer to load than to use.
    """
    return spread(_paint, figures)


def _paint(figure: Figure) -> Painted:
    return Painted({kind: style.image(figure, kind) for kind in FILES}, style.image(figure, "svg"))


def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """`function` of each item, as `map` gives it, by as many copies of this process as there are cores for.

    What a copy does not bring back is done here: it may have been killed for want of memory.
    """
    copies = min(_cores(), len(items)) - 1
    if copies < 1:
        return [function(item) for item in items]
    results: dict[int, Any] = {}
    with _copies(function, items, copies) as readers:
        results |= {place: function(items[place]) for place in range(0, len(items), copies + 1)}
        for number, reader in enumerate(readers, 1):
            with suppress(EOFError, OSError, pickle.UnpicklingError):
                places = range(number, len(items), copies + 1)
                results |= dict(zip(places, pickle.load(reader), strict=True))
    return [results[place] if place in results else function(item) for place, item in enumerate(items)]


def _cores() -> int:
    """That can be used: one alone where copies would not be whole, as other threads hold locks that nobody opens.

    Those of jax are not counted.
    """
    if sys.platform != "linux" or threading.active_count() > 1 or "jax" in sys.modules:
        return 1
    return len(os.sched_getaffinity(0))


@contextmanager
def _copies(function: Callable[[Any], Any], items: Sequence[Any], number: int) -> Iterator[list[Any]]:
    """Copies of this process that do their part of the items; gives what their results can be read from.

    None outlives the block, however it ends.
    """
    children, readers, parent = [], [], os.getpid()
    try:
        for first in range(1, number + 1):
            readable, writable = os.pipe()
            with warnings.catch_warnings():
                # From Python 3.12 on it warns where libraries have threads of their own: none that is of use here.
                warnings.simplefilter("ignore", DeprecationWarning)
                child = os.fork()
            if not child:
                _do(function, items[first :: number + 1], writable, parent)
            children.append(child)
            os.close(writable)
            readers.append(os.fdopen(readable, "rb"))
        yield readers
    finally:
        for child in children:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        for reader in readers:
            reader.close()


def _do(function: Callable[[Any], Any], items: Sequence[Any], writable: int, parent: int) -> None:
    """What a copy does: it never returns, and says nothing but its results. Signals are its parent's."""
    try:
        die_with_parent(parent)
        for number in stopping.SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        with os.fdopen(writable, "wb") as stream:
            pickle.dump([function(item) for item in items], stream)
        os._exit(0)
    finally:
        os._exit(1)
