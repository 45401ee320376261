"""The files of a report, a comparison or a page, on their way into its folder."""

from collections.abc import Mapping
from pathlib import Path

from gpcjax.errors import unwritten
from gpcjax.sweep.atomic import clean, write_atomic


def write_files(folder: Path, files: Mapping[str, bytes | str], mend: str) -> tuple[Path, ...]:
    """Writes files into a folder, each as a whole and in their order; gives their paths.

    What others have left half written there goes, once it is old: nobody else comes by who would remove it.

    Raises:
        UserError: one cannot be written; the message ends in how to `mend` that.
    """
    clean(folder, lambda target: False)
    for name, written in files.items():
        try:
            write_atomic(folder / name, written)
        except OSError as error:
            line = f"{folder / name}: cannot be written ({error.strerror}), {mend}"
            raise unwritten(error, line) from None
    return tuple(folder / name for name in files)
