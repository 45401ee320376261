"""What can wait, in a thread of its own: a person's steps go on meanwhile."""

import threading
import time
from collections.abc import Callable


class Errands:
    """Does what it is asked, one thing after the other; of several of one name the newest.

    Args:
        failed: takes what an errand raised.
    """

    def __init__(self, failed: Callable[[Exception], None]):
        self._failed = failed
        self._waiting: dict[str, tuple[Callable[[], None], float]] = {}
        self._done: dict[str, float] = {}
        self._changed = threading.Condition()
        self._over = False
        self._thread = threading.Thread(target=self._run, daemon=True, name="errands")
        self._thread.start()

    def ask(self, name: str, do: Callable[[], None], apart: float = 0.0) -> None:
        """Does `do` soon, at least `apart` seconds after the last of this name ended; nothing once closed."""
        with self._changed:
            if self._over:  # an errand that asks for itself again would never end
                return
            self._waiting[name] = (do, apart)
            self._changed.notify()

    def close(self, drop: bool = False) -> None:
        """Does what is waiting, without any pause, and ends; with `drop`, ends after what is being done now."""
        with self._changed:
            self._over = True
            if drop:
                self._waiting.clear()
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                name, left = self._next()
                while name is None:
                    if self._over:
                        return
                    self._changed.wait(left)
                    name, left = self._next()
                do, _ = self._waiting.pop(name)
            try:
                do()
            except Exception as error:
                self._failed(error)
            self._done[name] = time.monotonic()

    def _next(self) -> tuple[str | None, float | None]:
        """The name of an errand that is due, or none and the seconds until one is."""
        now = time.monotonic()
        due = {
            name: 0.0 if self._over else self._done.get(name, -apart) + apart - now
            for name, (_, apart) in self._waiting.items()
        }
        if not due:
            return None, None
        name = min(due, key=lambda each: max(due[each], 0.0))
        return (name, None) if due[name] <= 0 else (None, due[name])
