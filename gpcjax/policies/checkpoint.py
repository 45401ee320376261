"""Named arrays in a checkpoint of orbax's, which tensorstore reads; silently, and wrong in one way only."""

import contextlib
import errno
import os
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

Shapes = Mapping[str, tuple[int, ...]]

_OS_ERROR = re.compile(r"\[os_error_code='(\d{1,4})'\]")
"""How tensorstore says why the system refused something, at the end of a very long line."""

_ZARR = {".zarray": "zarr", "zarr.json": "zarr3"}
"""The file with which an array says what it is, and the driver that reads one of its kind."""

_ONE_AT_A_TIME = threading.Lock()
"""Orbax's savers share what they wait for, and what is silenced meanwhile is of the whole process: two that saved at
once waited for each other for ever, or left it silent. Nothing is shared by those that read."""


def save_arrays(folder: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Raises OSError, also where orbax and tensorstore say by exceptions of other kinds that a disk is full.

    What else they raise is let through. Threads that save at the same time do so one after the other.
    """
    why = None
    with _ONE_AT_A_TIME, _quietly():
        try:
            with _checkpointer() as checkpointer:
                checkpointer.save(folder.absolute(), dict(arrays))
        except Exception as error:
            why = _of_the_system(error) or error
            _settle(folder)
    if why is not None:
        _drop_late_words()
        raise why


def _of_the_system(error: BaseException) -> OSError | None:
    """What the system refused, as far as an exception, or one behind it, tells; None if it is of another kind."""
    left, seen = [error], list[BaseException]()
    while left:
        each = left.pop()
        if each in seen:
            continue
        seen.append(each)
        found = _OS_ERROR.search(str(each))
        number = int(found[1]) if found else getattr(each, "errno", None) or 0
        if found or isinstance(each, OSError):
            return OSError(number, os.strerror(number) if number else first_line(each))
        if isinstance(each, MemoryError):
            return OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
        behind = [each.__cause__, each.__context__, *getattr(each, "exceptions", ())]
        left += [one for one in behind if isinstance(one, BaseException)]
    return None


def _settle(folder: Path) -> None:
    """Removes what was not written whole: threads that wrote other arrays go on for a moment, and make it anew."""
    gone = 0
    for _ in range(100):
        there = os.path.lexists(folder.parent)
        gone = 0 if there else gone + 1
        if gone > 5:
            return
        shutil.rmtree(folder.parent, ignore_errors=True)
        time.sleep(0.01)


class _Without:
    """Hears what Python cannot raise, as the hook before it does, but for the late words of such threads."""

    def __init__(self, before: Callable[[Any], Any]):
        self._before = before

    def __call__(self, ignored: Any) -> None:
        if str(ignored.exc_value) != "Event loop is closed":
            self._before(ignored)


def _drop_late_words() -> None:
    """Those threads want to tell of their ends, where nobody hears them any more: Python would print it for each."""
    if not isinstance(sys.unraisablehook, _Without):
        sys.unraisablehook = _Without(sys.unraisablehook)


def forget_place(arrays: Path) -> None:
    """Takes out of a checkpoint where it was written: that is nobody's business who gets it, and no longer true."""
    marker = arrays / "commit_success.txt"
    if marker.exists():
        marker.write_text("Checkpoint commit was successful", encoding="ascii")


def stored_arrays(folder: Path, shapes: Shapes) -> tuple[dict[str, np.ndarray], str]:
    """The arrays of a checkpoint, and what is wrong with them.

    Read by tensorstore, which orbax writes them with: orbax itself loads jax, and takes half a second to do it.
    """
    import tensorstore  # only where a folder is read

    try:
        place = {"driver": "ocdbt", "base": {"driver": "file", "path": f"{folder.absolute()}/"}}
        keys = [key.decode() for key in tensorstore.KvStore.open(place).result().list().result()]
        formats = {
            name: _ZARR[file] for name, _, file in (key.rpartition("/") for key in keys) if file in _ZARR
        }
        asked = {
            name: tensorstore.open(
                {"driver": driver, "kvstore": {**place, "path": f"{name}/"}}, open=True, read=True
            )
            for name, driver in formats.items()
        }
        arrays = {name: each.result() for name, each in asked.items()}
        # What the arrays say of themselves comes first: nothing is made in a size that the card alone names.
        found = {name: tuple(array.shape) for name, array in arrays.items()}
        if found != dict(shapes):
            return {}, f"the card names arrays of shapes {dict(shapes)}, these have {found}"[:200]
        read = {name: array.read() for name, array in arrays.items()}
        return {name: np.asarray(read[name].result()) for name in shapes}, ""
    except Exception as error:  # tensorstore and the file system each have their own
        return {}, first_line(error)


def first_line(error: BaseException) -> str:
    """What an exception says, short."""
    line = next(iter(str(error).splitlines()), "")
    return (line or type(error).__name__)[:200]


_SPEAKERS = frozenset(("absl", "asyncio", "concurrent", "etils", "jax", "orbax", "tensorstore"))
"""Whose loggers have something to say of a checkpoint."""


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Without a word of orbax, absl, asyncio or a thread of theirs: what is wrong is said by an exception of ours.

    What other threads log meanwhile is heard: it may be a robot's.
    """
    import logging
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import orbax.checkpoint  # noqa: F401  (makes its loggers)

        loggers = [
            logger
            for name, logger in tuple(logging.root.manager.loggerDict.items())
            if name.partition(".")[0] in _SPEAKERS
            and isinstance(logger, logging.Logger)
            and not logger.disabled
        ]
        hook, sys.unraisablehook = sys.unraisablehook, lambda ignored: None
        try:
            for logger in loggers:
                logger.disabled = True
            yield
        finally:
            for logger in loggers:
                logger.disabled = False
            sys.unraisablehook = hook


def _checkpointer() -> Any:
    import orbax.checkpoint  # costs more than everything else here: only where a folder is written

    return orbax.checkpoint.StandardCheckpointer()
