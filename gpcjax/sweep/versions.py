"""What rows are computed with, beside the machine: versions, and the source of this package. Loads no jax."""

import functools
import hashlib
import importlib.metadata
import platform
from pathlib import Path

import gpcjax

LIBRARIES = ("jax", "jaxlib", "equinox", "numpy", "scipy", "pandas", "pyarrow")
"""Whose versions every manifest has."""


def versions() -> dict[str, str]:
    """Of what rows are computed with."""
    libraries = {name: version(name) for name in LIBRARIES}
    return {"gpcjax": gpcjax.__version__, "python": platform.python_version(), **libraries}


@functools.cache
def version(library: str) -> str:
    """Of an installed library. What is installed is read once: that takes milliseconds for each."""
    return importlib.metadata.version(library)


@functools.cache
def source_digest() -> str:
    """Twelve hex digits that installations share whose source is the same, word by word."""
    root, source = Path(gpcjax.__file__).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        source.update(f"{path.relative_to(root).as_posix()}\n".encode() + path.read_bytes())
    return source.hexdigest()[:12]
