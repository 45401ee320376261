"""A report that is kept fresh while its sweep runs: drawn in a process of its own, again and again.

It reads what is whole in the store, as any report does. The sweep itself pays for a part of the time of one core.
"""

import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from gpcjax.sweep.environment import python, worker_environment
from gpcjax.sweep.executors.served import die_with_parent
from gpcjax.sweep.layout import EPISODES

FIRST_SECONDS = 0.5
"""Between two looks whether there are any rows."""

LEAST_SECONDS = 5.0
"""From the end of a drawing to the next one; a browser loads the page anew as often."""

SHARE = 4.0
"""As many times as long as it took to draw, the next drawing waits: figures of large sweeps take their time."""


class Live:
    """Draws the report in `out` again and again, from `run`, which another thread calls, to `stop`."""

    def __init__(self, out: Path):
        self._out = out
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._drawing: subprocess.Popen | None = None

    def run(self) -> None:
        """Returns when it is stopped."""
        pause = FIRST_SECONDS
        while not self._over.wait(pause):
            if not any((self._out / EPISODES).glob("*.parquet")):
                continue
            began = time.monotonic()
            with self._lock:
                if self._over.is_set():
                    return
                self._drawing = subprocess.Popen(
                    python("gpcjax.report.live", str(self._out.absolute()), str(os.getpid())),
                    env=worker_environment(),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            self._drawing.wait()
            pause = max(LEAST_SECONDS, SHARE * (time.monotonic() - began))

    def stop(self) -> None:
        """Nothing is drawn any more when this returns."""
        with self._lock:
            self._over.set()
            if self._drawing is not None:
                self._drawing.kill()
                self._drawing.wait()


def main() -> None:
    """Draws once: the first argument is the run folder, the second one the process that it belongs to."""
    die_with_parent(int(sys.argv[2]))
    from gpcjax.errors import UserError
    from gpcjax.report.run import draw

    os.nice(5)
    with suppress(UserError):  # of what is just being written; the sweep's own report says what is wrong
        draw(Path(sys.argv[1]), refresh=round(LEAST_SECONDS))


if __name__ == "__main__":
    main()
