"""Programs kept whole between processes: read as machine code, they are neither traced nor lowered nor compiled.

XLA's own cache saves compiling alone: to look a program up there, it has to be traced and lowered. Here it is known by
what goes into it (`gpcjax.engine.identity`), and for another source, which may come to the same, by its lowered text.

    KEY.key         the digest of what goes into a program: holds the digest of its text
    TEXT.program    a program, after the checksum of it
    KEY.json        numbers that come of what the digest tells, as they would again

What is read is executed, and jax keeps it pickled: so a folder is used only if nobody but its owner, who is this user,
can write there; and a file only if it is all that was written.

What one process compiles no other one compiles beside it: that one waits, and reads it.
"""

import contextlib
import fcntl
import functools
import hashlib
import json
import os
import re
import stat
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.experimental import serialize_executable
from jax.experimental.compilation_cache import compilation_cache

from gpcjax.sweep import stopping
from gpcjax.sweep.atomic import write_atomic

MOST_BYTES = 1 << 29
"""Of all kept programs; those that were not used for longest go."""

MOST_SECONDS, LOOK_SECONDS = 120.0, 0.02
"""For how long another process is waited for, and how often it is looked whether it is done."""

_IN_A_HURRY = "jax_disable_most_optimizations"
"""A setting of jax that somebody may have in this process; workers have none."""

Compiled = Callable[..., Any]
_TEXT = re.compile(r"[0-9a-f]{32}")


class Executables:
    """Compiled programs in a folder, by the digest of what they depend on.

    Args:
        folder: it is made where it is missing. Where it cannot be used nothing is kept, and nothing is said.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._usable = _private(folder)

    def find(self, key: str) -> Compiled | None:
        """The program of this digest, ready to be called; None if there is none that can be used here."""
        path = self._key(key)
        try:
            text = path.read_text() if self._is_used() and _ours(path) else ""
            if text:
                os.utime(path)
        except (OSError, ValueError):
            return None
        return self._read(text) if _TEXT.fullmatch(text) else None

    def compiled(self, key: str, lowered: Any, leaves: int, given: int, others: int) -> Compiled:
        """Compiles and keeps a program of lists of so many leaves and arguments; it gives lists of leaves and others.

        Another source may have lowered to the same text: then that program is found once more.
        """
        words = lowered.as_text() if self._is_used() else "callback"
        if "callback" in words:  # a function of this process has a part in it
            return lowered.compile()
        counts = leaves, given, others
        text = hashlib.sha256(f"{jax.__version__} {counts} {words}".encode()).hexdigest()[:32]
        found = self._read(text)
        if found is None:
            with self._first(text) as is_first:
                found = self._read(text) if is_first else None  # somebody may have been done just before
                if is_first and found is None:
                    found = self._anew(text, lowered, counts)
        if found is None:  # it was waited for another one, who keeps nothing where nothing can be kept
            found = self._read(text) or self._anew(text, lowered, counts)
        with contextlib.suppress(OSError):
            write_atomic(self._key(key), text)
            self._key(key).chmod(0o600)
        return found

    def numbers(self, key: str) -> dict[str, float] | None:
        """What was computed before of what this digest tells; None if that is not known."""
        path = self._folder / f"{key}.json"
        try:
            found = json.loads(path.read_text()) if self._is_used() and _ours(path) else None
        except (OSError, ValueError):
            return None
        is_whole = isinstance(found, dict) and all(isinstance(each, int | float) for each in found.values())
        return found if is_whole and found else None

    def keep_numbers(self, key: str, numbers: dict[str, float]) -> None:
        """Keeps what was computed; nothing is said where that cannot be."""
        path = self._folder / f"{key}.json"
        if self._is_used():
            with contextlib.suppress(OSError):
                write_atomic(path, json.dumps(numbers))
                path.chmod(0o600)

    def _anew(self, text: str, lowered: Any, counts: tuple[int, int, int]) -> Compiled:
        with _compiling_anew():
            found = lowered.compile()
        self._write(text, found, *counts)
        return found

    @contextmanager
    def _first(self, text: str) -> Iterator[bool]:
        """Whether nobody else is at this program: then nobody else is while the block runs.

        Otherwise the other one has been waited for, or holds its lock, which dies with its process, for too long. Where
        nothing can be locked everybody is the first.
        """
        path, is_first = self._folder / f"{text}.lock", False
        descriptor = _opened(path)
        try:
            is_first = descriptor is None or _locked(descriptor)
            if descriptor is not None and not is_first:
                _await(descriptor)
            yield is_first
        finally:
            if descriptor is not None:
                if is_first:
                    with contextlib.suppress(OSError):
                        path.unlink()  # who waits for it has it open; who comes later finds the program
                os.close(descriptor)

    def _is_used(self) -> bool:
        """Not in a process whose programs are compiled in a hurry: others would take these for their own."""
        return self._usable and not jax.config.values[_IN_A_HURRY]

    def _key(self, key: str) -> Path:
        return self._folder / f"{key}.key"

    def _program(self, text: str) -> Path:
        return self._folder / f"{text}.program"

    def _read(self, text: str) -> Compiled | None:
        path = self._program(text)
        if not _ours(path):
            return None
        try:
            data = path.read_bytes()
            checksum, content = data[:32], data[32:]
            if hashlib.sha256(content).digest() != checksum:
                return None
            program, leaves, given, others = _parted(zlib.decompress(content))
            if b"lapack" in program or b"blas" in program:  # it names what it calls
                _find_lapack()
            arguments = jax.tree.structure((([0] * leaves, [0] * given), {}))
            result = jax.tree.structure(([0] * leaves, [0] * others))
            found = serialize_executable.deserialize_and_load(program, arguments, result)
            os.utime(path)
            return found
        except Exception:  # whatever is wrong with it: it is compiled anew, and replaces this one
            return None

    def _write(self, text: str, compiled: Any, *counts: int) -> None:
        path = self._program(text)
        with contextlib.suppress(
            Exception
        ):  # of another jax, on a full disk: the next process compiles it again
            program, _, _ = serialize_executable.serialize(compiled)
            content = zlib.compress(_closed(program, *counts), 1)
            write_atomic(path, hashlib.sha256(content).digest() + content)
            path.chmod(0o600)
            self._prune()

    def _prune(self) -> None:
        kept = []
        for path in (each for kind in ("program", "key", "json") for each in self._folder.glob(f"*.{kind}")):
            with contextlib.suppress(OSError):  # another one prunes too
                kept.append((path.stat(), path))
        total = sum(told.st_size for told, _ in kept)
        for told, path in sorted(kept, key=lambda each: each[0].st_mtime):
            if total <= MOST_BYTES:
                return
            with contextlib.suppress(OSError):
                path.unlink()
            total -= told.st_size


@functools.cache
def _find_lapack() -> None:
    """Has jaxlib look for scipy's LAPACK, which it does when something is lowered that calls it.

    A program that is read is not lowered: without this its first factorisation would end the process. It takes a third
    of a second, so it is not done for a program that calls none.
    """
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.float64))


@contextmanager
def _compiling_anew() -> Iterator[None]:
    """Nothing comes from XLA's cache: a program from there can be run, but not be kept once more."""
    name = "jax_enable_compilation_cache"
    before = getattr(jax.config, name)
    jax.config.update(name, False)
    compilation_cache.reset_cache()  # it remembers whether it is used
    try:
        yield
    finally:
        jax.config.update(name, before)
        compilation_cache.reset_cache()


def _opened(path: Path) -> int | None:
    """A descriptor of this file, which is made where it is missing; None where none can be."""
    with contextlib.suppress(OSError):
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    return None


def _locked(descriptor: int) -> bool:
    """Locks a file; False if somebody else has."""
    with contextlib.suppress(OSError):  # a file system without locks
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def _await(descriptor: int) -> None:
    """Waits until nobody has locked a file, as long as that is worth it. Raises Stopped."""
    until = time.monotonic() + MOST_SECONDS
    while time.monotonic() < until and not _locked(descriptor):
        stopping.check()
        time.sleep(LOOK_SECONDS)
    with contextlib.suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # who else waits reads the program at the same time


def _closed(program: bytes, *counts: int) -> bytes:
    return b"".join(count.to_bytes(4, "little") for count in counts) + program


def _parted(content: bytes) -> tuple[bytes, int, int, int]:
    leaves, given, others = (int.from_bytes(content[place : place + 4], "little") for place in (0, 4, 8))
    return content[12:], leaves, given, others


def _private(folder: Path) -> bool:
    """Whether this folder is there, or could be made, and only this user can write in it."""
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return _ours(folder) and os.access(folder, os.W_OK)


def _ours(path: Path) -> bool:
    try:
        told = path.stat()
    except OSError:
        return False
    others = stat.S_IWGRP | stat.S_IWOTH
    return not hasattr(os, "getuid") or (told.st_uid == os.getuid() and not told.st_mode & others)
