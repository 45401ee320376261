"""One writer for a run folder: a lock that dies with its process. Standard library only."""

import errno
import fcntl
import json
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gpcjax.errors import UserError, unwritten

LOCK = ".gpcjax.lock"
"""The locked file in a run folder. What it says is for people; what counts is the lock on it."""

TRIES, LOOK_SECONDS = 10, 0.01
"""Somebody who only looks whether a folder is held (`holder`) has its lock for much less, and may look again."""

_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)

_held: dict[Path, tuple[int, int | None]] = {}
"""By folder: the thread of this process that holds it, and the descriptor of its lock."""


@contextmanager
def held(out: Path) -> Iterator[None]:
    """While the block runs nobody else writes to the run folder `out`, which exists. Readers need no lock.

    The lock is the kernel's (flock) on a file in the folder: it ends with the process however that ends, and no worker
    inherits it. A thread that holds a folder may take it again; any other is refused.

    On NFS the lock reaches other machines where the server keeps locks (Linux from 2.6.12, without `local_lock`). On a
    file system without any lock the block is protected from the other threads of this process alone.

    Raises:
        UserError: another process or thread holds it, or no file can be made there.
    """
    folder = Path(os.path.realpath(out))
    holder = _held.get(folder)
    if holder is not None and holder[0] == threading.get_ident():
        yield
        return
    try:
        mine = threading.get_ident(), _patiently_locked(folder / LOCK)
        if _held.setdefault(folder, mine) is not mine:
            # There is no lock here, or its file was removed: nothing but this process knows of it.
            _release(folder / LOCK, mine[1])
            raise BlockingIOError
    except BlockingIOError:
        raise UserError(
            f"{out}: another sweep writes there{_holder(folder / LOCK)}: "
            "wait until it ends, or give a new folder (--out)"
        ) from None
    except OSError as error:
        line = f"{out}: nothing can be written there ({error.strerror}), give a new folder"
        raise unwritten(error, line) from None
    try:
        yield
    finally:
        del _held[folder]
        _release(folder / LOCK, mine[1])


def _patiently_locked(path: Path) -> int | None:
    """As `_locked`, which another may have held for a moment."""
    for _ in range(TRIES - 1):
        try:
            return _locked(path)
        except BlockingIOError:
            time.sleep(LOOK_SECONDS)
    return _locked(path)


def holder(out: Path) -> str | None:
    """Who writes to a run folder now, as far as it can be told; None if nobody does. Writes nothing."""
    path = out / LOCK
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        # A shared lock, so that two who look do not see each other.
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _holder(path).strip(" ()") or "another process"
    except OSError:
        return None
    finally:
        os.close(descriptor)
    return None


def _locked(path: Path) -> int | None:
    """An open descriptor that has the lock; None where the file system has no locks.

    Raises:
        BlockingIOError: another has it.
    """
    while True:
        descriptor, is_new = _opened(path)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
                os.close(descriptor)
                if is_new:  # another one may be locked, where there are locks at other moments (NFS)
                    path.unlink(missing_ok=True)
                return None
            if _is(path, descriptor):
                text = {"host": socket.gethostname(), "pid": os.getpid(), "since": _now()}
                with suppress(OSError):  # a full disk: the lock is the same
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, json.dumps(text).encode() + b"\n", 0)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # its holder has just removed this file: lock the one that is there now


def _opened(path: Path) -> tuple[int, bool]:
    """An open descriptor of the lock file, and whether it was made for it."""
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
    try:
        return os.open(path, flags | os.O_EXCL, 0o666), True
    except FileExistsError:
        return os.open(path, flags, 0o666), False


def _is(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _release(path: Path, descriptor: int | None) -> None:
    """Remove the file while it is still locked, so that nobody locks a file that goes away unseen; then let go."""
    if descriptor is None:
        return
    try:
        if _is(path, descriptor):
            path.unlink(missing_ok=True)
    except OSError:
        pass  # the folder became read-only or is gone; the lock ends all the same
    finally:
        os.close(descriptor)


def _holder(path: Path) -> str:
    """Who says to hold the lock, in parentheses; nothing where that cannot be read."""
    try:
        text = json.loads(path.read_bytes())
        return f" (process {int(text['pid'])} on {str(text['host'])[:80]} since {str(text['since'])[:40]})"
    except (OSError, ValueError, OverflowError, TypeError, KeyError, RecursionError):
        return ""


def _now() -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S %z")


def _forget() -> None:
    """In a forked child, as soon as it runs: a copy of a descriptor would keep its parent's lock beyond its end."""
    for _, descriptor in _held.values():
        if descriptor is not None:
            os.close(descriptor)
    _held.clear()


os.register_at_fork(after_in_child=_forget)
