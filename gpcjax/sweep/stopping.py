"""Signals that ask a run to stop: Ctrl-C, SIGTERM and SIGHUP are one thing. Standard library only.

A sweep hears them where it can stop, between two messages of its workers (`deferred`, `check`); everything else where
it stands. A second one changes nothing while the first is being answered, which takes a moment; only if that hangs,
on a dead network disk for one, does another end the process at once. What the caller of a shell has ignored (`nohup`)
stays ignored.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

PATIENCE = 5.0
"""Seconds from the first signal on in which others change nothing."""


class Stopped(KeyboardInterrupt):
    """A signal has asked the run to stop."""

    def __init__(self, number: int):
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.status = 128 + number
        """The exit status that says so, as in shells."""


class _Heard:
    """The signals that came in so far, and a descriptor that can be read from when there is one."""

    def __init__(self) -> None:
        self.first: int | None = None
        self.deferred = False
        self.wakeup: int | None = None
        self._since = 0.0
        self._writer: int | None = None

    def note(self, number: int, frame: FrameType | None) -> None:
        """The handler."""
        if self.first is None:
            self.first, self._since = number, time.monotonic()
            if self._writer is not None:
                os.write(self._writer, b"!")
            if not self.deferred:
                raise Stopped(number)
        elif time.monotonic() - self._since > PATIENCE:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    def open(self) -> None:
        self.deferred = True
        self.wakeup, self._writer = os.pipe()

    def close(self) -> None:
        descriptors = self.wakeup, self._writer
        self.wakeup = self._writer = (
            None  # first: a signal that comes in meanwhile writes into nobody else's file
        )
        for descriptor in descriptors:
            if descriptor is not None:
                os.close(descriptor)
        self.deferred = False


_heard = _Heard()
"""Handlers of signals belong to the whole process."""


def listen() -> None:
    """From now on SIGTERM and SIGHUP raise `Stopped` as Ctrl-C does: for a process that is this program alone."""
    for number in SIGNALS:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _heard.note)


def deaf() -> None:
    """Nothing is left to be kept: a signal ends the process without a word, and one that is ending by itself never."""
    for number in SIGNALS:
        if signal.getsignal(number) == _heard.note:
            signal.signal(number, signal.SIG_DFL if _heard.first is None else signal.SIG_IGN)


def status() -> int | None:
    """The exit status of the signal that has come in, if one has."""
    return None if _heard.first is None else 128 + _heard.first


def check() -> None:
    """Raise `Stopped` if a signal has come in."""
    if _heard.first is not None:
        raise Stopped(_heard.first)


def wakeup() -> int | None:
    """Within `deferred`, a descriptor that becomes readable with the first signal."""
    return _heard.wakeup


@contextmanager
def deferred() -> Iterator[None]:
    """A block in which a signal is only noted, to be raised by `check` or behind the block.

    There the handlers are those of before, and hear of it: a program that has none for SIGTERM ends as if it had come
    in just then. In another thread than the main one signals are nobody's, and nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread() or _heard.deferred:
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    before = {number: old for number, old in before.items() if old not in (signal.SIG_IGN, None)}
    _heard.open()
    ended: BaseException | None = None
    try:
        for number in before:
            signal.signal(number, _heard.note)
        yield
    except BaseException as error:
        ended = error
        raise
    finally:
        for number, old in before.items():
            signal.signal(number, old)
        _heard.close()
        heard = _heard.first
        if heard is not None and before.get(heard) != _heard.note:
            _heard.first = None
            if ended is None or isinstance(ended, Stopped):
                signal.raise_signal(heard)
    check()
