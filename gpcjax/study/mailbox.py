"""What other threads have to say to the event loop, delivered together: a wake-up costs more than most messages."""

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from typing import Any


class Mailbox:
    """Of one event loop. Made in its thread."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._called = False

    def post(self, take: Callable[..., None], *given: Any) -> None:
        """Has `take` called in the loop, in the order of posting; from any thread. Nothing once the loop has ended."""
        self._waiting.append((take, given))
        if not self._called:
            self._called = True
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._deliver)

    def _deliver(self) -> None:
        # First: what is posted from now on, and not met below, calls again.
        self._called = False
        while self._waiting:
            take, given = self._waiting.popleft()
            try:
                take(*given)
            except Exception as error:  # those that wait behind it are others' affair
                self._loop.call_exception_handler(
                    {"message": "a message could not be taken", "exception": error}
                )
