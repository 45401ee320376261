"""Reads a run folder as one moment has it, while a sweep may make it grow. Loads no jax."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from gpcjax.sweep.growth import hashes
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.parts import Found

T = TypeVar("T")

Manifest = Mapping[str, Any]


def steadily(
    out: Path, read: Callable[[Manifest, Found], T], manifest: Manifest | None = None
) -> tuple[T, dict[str, Any], Found]:
    """What `read` gives of the parts of a folder, with the manifest that it was read by, and what else lay there.

    Who asks for more writes the manifest, then parts, in which rows of before may lie beside new ones. To a reader with
    an earlier manifest such a part is another sweep's: then all is read again, by the manifest that is there now.

    Args:
        out: the run folder.
        read: reads the parts by a manifest, and fills what it is given.
        manifest: what was read of it already.

    Raises:
        UserError: `out` is no run folder, or its manifest is damaged; and what `read` raises.
    """
    known = dict(read_manifest(out) if manifest is None else manifest)
    while True:
        found = Found()
        result = read(known, found)
        if not (found.foreign or found.gone):
            return result, known, found
        now = read_manifest(out)
        if list(hashes(now)) == list(hashes(known)):
            return result, known, found
        known = now
