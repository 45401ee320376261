"""Files that are whole or absent: a temporary file beside the target, fsync, `os.replace`. Standard library only."""

import os
import re
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_TEMPORARY = re.compile(r"\.gpcjax-(?P<pid>[0-9]{1,10})-[0-9a-f]{12}\.(?P<target>.+)\.tmp")
"""What `atomic_path` calls its files until they are whole: other programs' are called otherwise, and stay."""

OLD_SECONDS = 3600.0
"""No file takes so long to write: one this old was left by a process that was killed."""


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A path to write to that becomes `path` when the block ends well, and vanishes when it does not.

    It lies in the same folder, is hidden and ends in `.tmp`, so that no search for `*.parquet` ever finds it.

    Raises:
        FileNotFoundError: the block wrote nothing there.
        OSError: the folder is missing or cannot be written.
    """
    temporary = path.with_name(f".gpcjax-{os.getpid()}-{uuid.uuid4().hex[:12]}.{path.name}.tmp")
    try:
        yield temporary
        _flush(temporary)
        os.replace(temporary, path)
        _flush(path.parent)
    finally:
        with suppress(OSError):  # what went wrong before says more
            temporary.unlink(missing_ok=True)


def write_atomic(path: Path, data: bytes | str) -> None:
    """Write `data` (text as UTF-8, as it is) to `path`, which holds either its old content or all of the new one.

    Raises:
        OSError: the folder is missing or cannot be written; it names `path`.
    """
    try:
        with atomic_path(path) as temporary:
            temporary.write_bytes(data.encode() if isinstance(data, str) else data)
    except OSError as error:
        # Python names none where a disk is full, and else the temporary file, which nobody knows.
        if error.errno is None:
            raise
        raise type(error)(error.errno, error.strerror, os.fspath(path)) from None


def target_of(name: str) -> str | None:
    """The name that a temporary file of ours would have got; None for any other file."""
    match = _TEMPORARY.fullmatch(name)
    return match["target"] if match else None


def clean(folder: Path, ours: Callable[[str], bool]) -> None:
    """Remove the temporary files that killed processes have left in `folder`; a folder that is missing has none.

    Those whose target is `ours` go at once: the caller is the one process that writes such files. Others may be in the
    making (a report needs no lock), and go when they are `OLD_SECONDS` old. What names another process that runs on
    this machine stays, and so does what cannot be removed.
    """
    try:
        names = os.listdir(folder)
    except OSError:
        return
    for name in names:
        match, path = _TEMPORARY.fullmatch(name), folder / name
        if match is None or _runs(int(match["pid"])):
            continue
        try:
            if ours(match["target"]) or time.time() - path.lstat().st_mtime > OLD_SECONDS:
                path.unlink(missing_ok=True)
        except OSError:
            continue


def _runs(pid: int) -> bool:
    """Whether there is another process of this number here."""
    if pid == os.getpid():  # in a container every run may have the same
        return False
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # somebody else's
        return True
    return True


def _flush(path: Path) -> None:
    if path.is_dir() and os.name != "posix":
        return  # elsewhere a folder cannot be opened
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
