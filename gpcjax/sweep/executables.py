"""Programs kept whole between processes: read as machine code, they are neither traced nor lowered nor compiled.

XLA's own cache saves compiling alone: to look a program up there, it has to be traced and lowered. Here it is known by
what goes into it (`gpcjax.engine.identity`). What is read is executed, and jax keeps it pickled: so a folder is used
only if nobody but its owner, who is this user, can write there; and a file only if it is all that was written.
"""

import contextlib
import hashlib
import os
import stat
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax.experimental import serialize_executable

from gpcjax.sweep.atomic import write_atomic

SUFFIX = ".program"
MOST_BYTES = 1 << 29
"""Of all kept programs; those that were not used for longest go."""

Compiled = Callable[..., Any]


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
        path = self._path(key)
        if not self._usable or not _ours(path):
            return None
        try:
            data = path.read_bytes()
            sum_, content = data[:32], data[32:]
            if hashlib.sha256(content).digest() != sum_:
                return None
            program, leaves, given, others = _opened(zlib.decompress(content))
            arguments = jax.tree.structure(((([0] * leaves), [0] * given), {}))
            result = jax.tree.structure(([0] * leaves, [0] * others))
            found = serialize_executable.deserialize_and_load(program, arguments, result)
            os.utime(path)
            return found
        except Exception:  # whatever is wrong with it: it is compiled anew, and replaces this one
            return None

    def keep(self, key: str, compiled: Any, leaves: int, given: int, others: int) -> None:
        """Keeps a program of two lists, of so many leaves and arguments, that gives two, of the leaves and others."""
        if not self._usable:
            return
        with contextlib.suppress(
            Exception
        ):  # of another jax, on a full disk: the next process compiles it again
            program, _, _ = serialize_executable.serialize(compiled)
            content = zlib.compress(_closed(program, leaves, given, others), 1)
            write_atomic(self._path(key), hashlib.sha256(content).digest() + content)
            self._path(key).chmod(0o600)
            self._prune()

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}{SUFFIX}"

    def _prune(self) -> None:
        kept = [(entry.stat(), entry) for entry in os.scandir(self._folder) if entry.name.endswith(SUFFIX)]
        total = sum(told.st_size for told, _ in kept)
        for told, entry in sorted(kept, key=lambda each: each[0].st_mtime):
            if total <= MOST_BYTES:
                return
            os.unlink(entry.path)
            total -= told.st_size


def _closed(program: bytes, *counts: int) -> bytes:
    return b"".join(count.to_bytes(4, "little") for count in counts) + program


def _opened(content: bytes) -> tuple[bytes, int, int, int]:
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
