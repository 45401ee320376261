"""A folder in which something begins: where it ends by a mistake before anything came of it, nothing is left."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gpcjax.errors import UserError
from gpcjax.sweep.layout import MANIFEST
from gpcjax.sweep.lock import LOCK, held
from gpcjax.sweep.runfolder import make_writable


@contextmanager
def begun(out: Path, telling: Iterable[str] = (MANIFEST,)) -> Iterator[None]:
    """Makes a folder for the block, and removes what was made of it where the block ends by a `UserError`.

    Not where it holds more by then than files of the names `telling`, which say no more than what was asked for.
    Nor where there was something in it before.

    Raises:
        UserError: nothing can be written there; or the block's.
    """
    made = [folder for folder in (out, *out.parents) if not os.path.lexists(folder)]
    new = bool(made) or (out.is_dir() and not any(out.iterdir()))
    make_writable(out)
    try:
        yield
    except UserError:
        with suppress(UserError, OSError):  # somebody else has begun there; or it cannot be read
            if new:
                _remove(out, made, {LOCK, *telling})
        raise


def _remove(out: Path, made: Iterable[Path], telling: set[str]) -> None:
    """What is in it, if that is nothing but these files; and the folders that were made for it."""
    with held(out):
        paths = sorted(out.rglob("*"), reverse=True)  # what is in a folder comes before it
        files = [path for path in paths if path.is_symlink() or not path.is_dir()]
        if any(path.name not in telling for path in files):
            return
        for path in files:
            if path != out / LOCK:
                path.unlink(missing_ok=True)
        for path in paths:
            if path not in files:
                path.rmdir()
    for folder in made:
        folder.rmdir()
