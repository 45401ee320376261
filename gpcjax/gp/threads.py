"""How many threads LAPACK factorises with.

jaxlib's Cholesky factors are scipy's, and a process of a person's own gives those all of its cores. A dictionary has a
few hundred points: its matrix is not worth a second thread, and where another program is busy on a core, both wait for
each other, 0.5 s instead of 10 ms. Workers of a sweep have one thread from the start (`gpcjax.sweep.environment`).
"""

import contextlib
import functools
import threading
from collections.abc import Iterator
from typing import Any


@functools.cache
def _blas() -> Any:
    import scipy.linalg.cython_lapack  # noqa: F401  (what jaxlib calls: it must be there to be found)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


class _Limit:
    """How many callers want one thread; the first sets it, and the last gives back what was there."""

    def __init__(self):
        self._lock, self._callers = threading.Lock(), 0
        self._limited: Any = None

    def enter(self) -> None:
        with self._lock:
            if self._callers == 0:
                self._limited = _blas().limit(limits=1)
            self._callers += 1

    def leave(self) -> None:
        with self._lock:
            self._callers -= 1
            if self._callers == 0:
                self._limited.restore_original_limits()


_limit = _Limit()


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """BLAS and LAPACK of numpy and scipy have one thread until it is over, in all of the process; it may be nested."""
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()
