"""A small disk of one's own that becomes full or read-only, or loses a folder, at a wanted moment. Linux alone.

It is a tmpfs that no other process sees, in a mount namespace (`in_private`); where neither is allowed, its faults are
fewer (`Disk.faults`).
"""

import ctypes
import os
import shutil
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from tests.torture.telling import told

_PRIVATE = "GPCJAX_TORTURE_PRIVATE"
"""Set in a process that has a mount namespace of its own."""

_READ_ONLY, _REMOUNT, _BIND, _DETACH = 1, 32, 4096, 2
"""As <sys/mount.h> has them."""

FILLER = "filler"

_ABOVE_PERMISSIONS = 1 << 1 | 1 << 2
"""CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH, as <linux/capability.h> has them."""


def in_private(module: str) -> None:
    """Begins this process anew in a mount namespace of its own, where the system gives one."""
    if _PRIVATE in os.environ or shutil.which("unshare") is None:
        return
    for flags in (["--mount"], ["--map-root-user", "--mount"]):
        command = ["unshare", *flags]
        if os.spawnvp(os.P_WAIT, "sh", ["sh", "-c", f"{' '.join(command)} true 2>/dev/null"]) == 0:
            os.environ[_PRIVATE] = "1"
            os.execvp("unshare", [*command, sys.executable, "-m", module, *sys.argv[1:]])


def obey_permissions() -> None:
    """From now on permissions hold for this process, if it is root's too."""
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)
    data = (ctypes.c_uint32 * 6)()
    if _libc().capget(header, data) == 0:
        data[0] &= ~_ABOVE_PERMISSIONS
        _libc().capset(header, data)


class Disk:
    """A disk at `path`, an empty folder."""

    def __init__(self, path: Path, size: str = "8m"):
        self.path = path
        path.mkdir()
        self.mounted = _PRIVATE in os.environ and _mount("tmpfs", path, "tmpfs", 0, f"size={size},mode=777")

    @property
    def faults(self) -> dict[str, Callable[[Path, int], None]]:
        """What can happen to it, by name: takes the folder in use, and bytes that stay free."""
        disks = {"full": self._full, "read-only": self._read_only} if self.mounted else {}
        return {**disks, "locked": self._lock, "removed": self._remove}

    def mend(self, fault: str, folder: Path) -> None:
        """As it was, but for what was removed; also where the fault has not happened."""
        if fault == "full":
            (self.path / FILLER).unlink(missing_ok=True)
        if fault == "read-only" and os.statvfs(self.path).f_flag & os.ST_RDONLY:
            _libc().umount2(os.fsencode(self.path), _DETACH)
        if fault == "locked":
            folder.chmod(0o755)

    def close(self) -> None:
        """No disk any more."""
        if self.mounted:
            _libc().umount2(os.fsencode(self.path), _DETACH)

    def _full(self, folder: Path, left: int) -> None:
        stat = os.statvfs(self.path)
        with open(self.path / FILLER, "wb", buffering=0) as file:
            os.posix_fallocate(file.fileno(), 0, max(1, stat.f_bavail * stat.f_frsize - left))

    def _read_only(self, folder: Path, left: int) -> None:
        # A mount with a file that is open for writing stays writable, so this is a second one above it.
        assert _mount(self.path, self.path, None, _BIND)
        assert _mount(self.path, self.path, None, _BIND | _REMOUNT | _READ_ONLY)

    def _lock(self, folder: Path, left: int) -> None:
        """For who has to `obey_permissions`."""
        folder.chmod(0o555)

    def _remove(self, folder: Path, left: int) -> None:
        shutil.rmtree(folder, ignore_errors=True)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _mount(
    source: str | Path, target: Path, kind: str | None, flags: int, options: str | None = None
) -> bool:
    words = [None if each is None else os.fsencode(each) for each in (source, target, kind)]
    return _libc().mount(*words, ctypes.c_ulong(flags), options and options.encode()) == 0


def count(what: str, cases: Iterable[tuple[str, str | None, str]]) -> int:
    """Runs cases (name, what became of it, why not), prints those that were not right: how many, 99 at most."""
    return min(told(what, cases), 99)
