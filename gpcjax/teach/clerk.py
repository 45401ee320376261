"""Writes policies and rows in a process of its own: that takes Python longer than many steps.

    python -m gpcjax.teach.clerk

It reads from its standard input what is to be written, one thing after the other, and answers each.
"""

import contextlib
import os
import pickle
import signal
import struct
import subprocess
import threading
from collections.abc import Iterator, Sequence
from io import BufferedReader
from typing import IO, Any

from gpcjax.sweep.environment import computing_environment, python, worker_environment

SLOWER = 10
"""By how much its priority is lower: steps come first."""

TRIES = 2
"""A process that died is begun once more."""

LONGEST, CLOSING = 60.0, 10.0
"""Seconds that it has for one thing, and for its end: one that hangs is killed, so that a lesson can end."""

_NUMBER = struct.Struct("<Q")
"""What is asked goes as parts, their count first and before each its bytes: so what cannot be read does not hide where
the next thing begins, and arrays, which are parts of their own, are not copied while Python waits. So does the answer,
a part of which is none.
"""


class Clerk:
    """One such process. Its methods may be called from several threads; what they ask is done one after the other."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process = self._begun()

    def write(self, kept: Any) -> None:
        """Has `gpcjax.teach.kept.Kept.write` done there, and waits for it; what cannot go there is written here.

        Raises:
            Exception: what that raised.
            OSError: its process ends again and again, or hangs.
        """
        arrays: list[pickle.PickleBuffer] = []
        try:
            head = pickle.dumps(kept, protocol=5, buffer_callback=arrays.append)
            told = [memoryview(head), *(each.raw() for each in arrays)]
        except Exception:  # a learner of one's own may hold anything
            with self._lock:
                kept.write()
            return
        with self._lock:
            for _ in range(TRIES):
                with _killed_when_late(self._process) as late, contextlib.suppress(EOFError, BrokenPipeError):
                    answer = self._asked(told)
                    break
                self.close()
                self._process = self._begun()
                if late.is_set():
                    raise OSError(f"the process that writes policies and rows took over {LONGEST:g} s")
            else:
                raise OSError("the process that writes policies and rows ended")
            read, failed = answer
            if not read:  # its class is one that only this process finds
                kept.write()
            elif failed is not None:
                raise failed

    def close(self) -> None:
        """Ends it, by force if it does not end by itself."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(CLOSING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def _asked(self, told: Sequence[memoryview]) -> tuple[bool, Exception | None]:
        """Whether it could be read, and what writing it raised."""
        assert self._process.stdin is not None and isinstance(self._process.stdout, BufferedReader)
        self._process.stdin.write(_NUMBER.pack(len(told)))
        for part in told:
            self._process.stdin.write(_NUMBER.pack(part.nbytes))
            self._process.stdin.write(part)
        self._process.stdin.flush()
        return pickle.loads(_read(self._process.stdout, _number(self._process.stdout)))

    @staticmethod
    def _begun() -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            python("gpcjax.teach.clerk"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**worker_environment(), **computing_environment("cpu")},
        )


@contextlib.contextmanager
def _killed_when_late(process: subprocess.Popen[bytes]) -> Iterator[threading.Event]:
    """Kills a process that has not done something in time, and says so."""
    late = threading.Event()

    def kill() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(LONGEST, kill)
    timer.daemon = True
    timer.start()
    try:
        yield late
    finally:
        timer.cancel()


def main() -> None:
    """Writes what comes, until nothing more does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends who asks, which ends this
    os.nice(SLOWER)
    asked, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    import gpcjax.teach.kept  # noqa: F401  (before the first thing comes: it takes a second or two)

    with contextlib.suppress(BrokenPipeError, EOFError):
        while True:
            _answer([_read(asked, _number(asked)) for _ in range(_number(asked))], answers)


def _number(asked: BufferedReader) -> int:
    (number,) = _NUMBER.unpack(_read(asked, _NUMBER.size))
    return number


def _read(asked: BufferedReader, size: int) -> bytearray:
    """So many bytes, which may be written to, as arrays are. Raises EOFError: nothing more comes."""
    part = bytearray(size)
    if asked.readinto(part) < size:
        raise EOFError
    return part


def _answer(told: Sequence[bytearray], answers: IO[bytes]) -> None:
    read, failed = True, None
    try:
        kept = pickle.loads(told[0], buffers=told[1:])
    except Exception:
        read = False
    else:
        failed = _failure(kept)
    answer = pickle.dumps((read, failed))
    answers.write(_NUMBER.pack(len(answer)) + answer)
    answers.flush()


def _failure(kept: Any) -> Exception | None:
    """What writing it raises, as something that can be sent."""
    try:
        kept.write()
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return OSError(repr(error))
        return error
    return None


if __name__ == "__main__":
    main()
