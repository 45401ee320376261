"""Writes policies and rows in a process of its own: that takes Python longer than the steps of all.

    python -m gpcjax.study.clerk

It reads from its standard input what is to be written, one thing after the other, and answers each.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from typing import IO, Any

from gpcjax.sweep.environment import computing_environment, python, worker_environment

SLOWER = 10
"""By how much its priority is lower: steps come first."""

TRIES = 2
"""A process that died is begun once more."""


class Clerk:
    """One such process. Its methods may be called from several threads; what they ask is done one after the other."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process = self._begun()

    def write(self, kept: Any) -> None:
        """Has `gpcjax.teach.taught.Kept.write` done there, and waits for it.

        Raises:
            Exception: what that raised.
            OSError: its process ends again and again.
        """
        told = pickle.dumps(kept)
        with self._lock:
            for _ in range(TRIES):
                with contextlib.suppress(EOFError, BrokenPipeError):
                    answer = self._asked(told)
                    break
                self.close()
                self._process = self._begun()
            else:
                raise OSError("the process that writes policies and rows ended")
        if answer is not None:
            raise answer

    def close(self) -> None:
        """Ends it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _asked(self, told: bytes) -> Exception | None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(told)
        self._process.stdin.flush()
        return pickle.load(self._process.stdout)

    @staticmethod
    def _begun() -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            python("gpcjax.study.clerk"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**worker_environment(), **computing_environment("cpu")},
        )


def main() -> None:
    """Writes what comes, until nothing more does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the hall, which ends this
    os.nice(SLOWER)
    asked, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            _answer(pickle.load(asked), answers)


def _answer(kept: Any, answers: IO[bytes]) -> None:
    failed = None
    try:
        kept.write()
    except Exception as error:
        failed = error
    answers.write(pickle.dumps(failed))
    answers.flush()


if __name__ == "__main__":
    main()
