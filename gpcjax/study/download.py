"""A study's folder as a zip that is made while it is sent, and lies nowhere. Standard library only."""

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

from gpcjax.study.register import TOKEN
from gpcjax.sweep.atomic import target_of
from gpcjax.sweep.lock import LOCK

PIECE = 1 << 18
"""Bytes that are read at once."""


class _Outlet(io.RawIOBase):
    """Takes what a zip writes, until it is taken on."""

    def __init__(self) -> None:
        self._written: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        piece = bytes(data)  # pyright: ignore[reportArgumentType]
        self._written.append(piece)
        return len(piece)

    def taken(self) -> bytes:
        written, self._written = self._written, []
        return b"".join(written)


def zipped(out: Path) -> Iterator[bytes]:
    """The pieces of a zip of the folder, without the experimenter's token, locks, and what is being written.

    A file that grows meanwhile is there as far as it was when it was read; one that vanishes is left out.
    """
    outlet = _Outlet()
    with zipfile.ZipFile(outlet, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:  # pyright: ignore[reportArgumentType]
        for path in sorted(out.rglob("*")):
            inner = path.relative_to(out)
            if (
                inner.name in (TOKEN, LOCK)
                or target_of(inner.name)
                or inner.parts[0] == "."
                or _hidden(inner)
            ):
                continue
            try:
                if not path.is_file() or path.is_symlink():
                    continue
                source = open(path, "rb")  # noqa: SIM115 (closed below)
            except OSError:
                continue
            with source, archive.open(zipfile.ZipInfo.from_file(path, Path(out.name) / inner), "w") as target:
                while piece := source.read(PIECE):
                    target.write(piece)
                    yield outlet.taken()
            yield outlet.taken()
    yield outlet.taken()


def _hidden(inner: Path) -> bool:
    """Whether it lies in a folder that is being made or removed."""
    return any(part.startswith(".") for part in inner.parts)
