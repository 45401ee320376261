"""A folder of arrays and a card that says what they are: written whole, and read only as it was written.

folder/card.json     JSON values
folder/arrays/       an orbax checkpoint of named arrays
folder/SHA256SUMS    of all these files, as `sha256sum -c` reads it; folders of format 1 may do without it

No file runs code when it is read, and none can make its reader take more memory than the files themselves ask for.
"""

import contextlib
import hashlib
import json
import math
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.allowed import checked_path, is_no_data
from gpcjax.errors import UserError, unwritten

FORMAT = 2
FORMATS = (1, 2)
CARD, ARRAYS, SUMS = "card.json", "arrays", "SHA256SUMS"
LARGEST_CARD = 2**22
"""Bytes."""
LARGEST_ARRAY = 2**28
"""Numbers: two gigabytes."""

_OS_ERROR = re.compile(r"\[os_error_code='(\d{1,4})'\]")
"""How tensorstore says why the system refused something, at the end of a very long line."""

_ZARR = {".zarray": "zarr", "zarr.json": "zarr3"}
"""The file with which an array says what it is, and the driver that reads one of its kind."""

Shapes = Mapping[str, tuple[int, ...]]


def write_folder(path: Any, card: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Writes a new folder, which is whole or absent. `card` may hold numpy's numbers and arrays.

    Raises:
        FileExistsError: there is something at `path`.
        ValueError: a value of the card is not finite, or too large, or nothing can be written at `path`.
        TypeError: a value of the card that JSON does not know.
    """
    path = checked_path("path", path)
    if os.path.lexists(path):
        raise FileExistsError(f"{path} exists: choose another path, or remove it first")
    shapes = {name: list(value.shape) for name, value in arrays.items()}
    text = _json({"format": FORMAT, **card, "arrays": shapes})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
        try:
            _save_arrays(scratch / ARRAYS, arrays)
            _forget_place(scratch / ARRAYS)
            (scratch / CARD).write_bytes(text)
            sums = "".join(f"{_sum(scratch / name)}  {name}\n" for name in _names(scratch))
            (scratch / SUMS).write_text(sums, encoding="ascii")
            scratch.chmod(0o755)
            _to_disk(scratch)
            os.replace(scratch, path)
        except BaseException:
            shutil.rmtree(scratch, ignore_errors=True)
            raise
    except OSError as error:
        told = error.strerror or first_line(error)
        raise unwritten(error, f"{path}: it cannot be written there ({told}), give another path") from None


def _save_arrays(folder: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Raises OSError, also where orbax and tensorstore say by exceptions of other kinds that a disk is full."""
    why = None
    with _quietly():
        try:
            with _checkpointer() as checkpointer:
                checkpointer.save(folder.absolute(), dict(arrays))
        except Exception as error:
            found = _OS_ERROR.search(str(error))
            number = int(found[1]) if found else getattr(error, "errno", None) or 0
            why = OSError(number, os.strerror(number) if number else first_line(error))
            _settle(folder)
    if why is not None:
        _drop_late_words()
        raise why


def _settle(folder: Path) -> None:
    """Removes what was not written whole: threads that wrote other arrays go on for a moment, and make it anew."""
    gone = 0
    for _ in range(100):
        there = os.path.lexists(folder.parent)
        gone = 0 if there else gone + 1
        if gone > 5:
            return
        shutil.rmtree(folder.parent, ignore_errors=True)
        time.sleep(0.01)


class _Without:
    """Hears what Python cannot raise, as the hook before it does, but for the late words of such threads."""

    def __init__(self, before: Callable[[Any], Any]):
        self._before = before

    def __call__(self, ignored: Any) -> None:
        if str(ignored.exc_value) != "Event loop is closed":
            self._before(ignored)


def _drop_late_words() -> None:
    """Those threads want to tell of their ends, where nobody hears them any more: Python would print it for each."""
    if not isinstance(sys.unraisablehook, _Without):
        sys.unraisablehook = _Without(sys.unraisablehook)


def _forget_place(arrays: Path) -> None:
    """Takes out of a checkpoint where it was written: that is nobody's business who gets it, and no longer true."""
    marker = arrays / "commit_success.txt"
    if marker.exists():
        marker.write_text("Checkpoint commit was successful", encoding="ascii")


def read_card(path: Any, what: str) -> dict[str, Any]:
    """The card of a folder whose files are those that were written.

    Args:
        path: the folder.
        what: the noun of the messages, such as "policy".

    Raises:
        ValueError: there is no such folder, it has another format, or its files are not those that were written.
    """
    path = checked_path("path", path)
    file = path / CARD
    try:
        if not file.exists():
            raise UserError(f"{path}: no {what} here ({CARD} is missing)")
        if not file.is_file() or file.stat().st_size > LARGEST_CARD:
            raise UserError(
                f"{file}: this is not a {what}'s card (no file of {LARGEST_CARD:,} bytes at most)"
            )
        card = json.loads(file.read_bytes().decode(), object_pairs_hook=_unique)
        version = card["format"]
    except UserError:
        raise
    except KeyError:
        raise UserError(f"{file}: this is not a {what}'s card (it has no format)") from None
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise UserError(f"{file}: this is not a {what}'s card ({first_line(error)})") from None
    if type(version) is not int or version not in FORMATS:
        known = " and ".join(map(str, FORMATS))
        raise UserError(f"{file}: format {str(version)[:20]} is not known, this version reads {known}")
    _check_sums(path, version, what)
    _shapes(card, file, what)
    return card


def read_arrays(path: Any, card: Mapping[str, Any], what: str) -> dict[str, np.ndarray]:
    """The arrays of a folder, whose card was read and checked: of the shapes that it names.

    Raises:
        ValueError: they cannot be read, or have other names or shapes.
    """
    folder = checked_path("path", path) / ARRAYS
    shapes = _shapes(card, folder.parent / CARD, what)
    arrays, wrong = _stored(folder, shapes)
    # Raised where no exception of tensorstore's is around, which says the same at length.
    if wrong:
        raise UserError(f"{folder}: the arrays of this {what} cannot be read ({wrong})")
    return arrays


def _stored(folder: Path, shapes: Shapes) -> tuple[dict[str, np.ndarray], str]:
    """The arrays of a checkpoint, and what is wrong with them.

    Read by tensorstore, which orbax writes them with: orbax itself loads jax, and takes half a second to do it.
    """
    import tensorstore  # only where a folder is read

    try:
        place = {"driver": "ocdbt", "base": {"driver": "file", "path": f"{folder.absolute()}/"}}
        keys = [key.decode() for key in tensorstore.KvStore.open(place).result().list().result()]
        formats = {
            name: _ZARR[file] for name, _, file in (key.rpartition("/") for key in keys) if file in _ZARR
        }
        asked = {
            name: tensorstore.open(
                {"driver": driver, "kvstore": {**place, "path": f"{name}/"}}, open=True, read=True
            )
            for name, driver in formats.items()
        }
        arrays = {name: each.result() for name, each in asked.items()}
        # What the arrays say of themselves comes first: nothing is made in a size that the card alone names.
        found = {name: tuple(array.shape) for name, array in arrays.items()}
        if found != dict(shapes):
            return {}, f"the card names arrays of shapes {dict(shapes)}, these have {found}"[:200]
        read = {name: array.read() for name, array in arrays.items()}
        return {name: np.asarray(read[name].result()) for name in shapes}, ""
    except Exception as error:  # tensorstore and the file system each have their own
        return {}, first_line(error)


def first_line(error: BaseException) -> str:
    """What an exception says, short."""
    line = next(iter(str(error).splitlines()), "")
    return (line or type(error).__name__)[:200]


def _shapes(card: Mapping[str, Any], file: Path, what: str) -> dict[str, tuple[int, ...]]:
    shapes = card.get("arrays")
    if not isinstance(shapes, dict):
        raise UserError(f"{file}: this is not a {what}'s card (it names no arrays)")
    valid = all(
        isinstance(shape, list)
        and len(shape) <= 16
        and all(type(size) is int and 0 <= size <= LARGEST_ARRAY for size in shape)
        and math.prod(shape) <= LARGEST_ARRAY
        for shape in shapes.values()
    )
    if not valid:
        raise UserError(
            f"{file}: this is not a {what}'s card (arrays: the shape of each, {LARGEST_ARRAY:,} numbers at most)"
        )
    return {name: tuple(shape) for name, shape in shapes.items()}


def _check_sums(path: Path, version: int, what: str) -> None:
    """Whether the files are those that were written, as far as `SHA256SUMS` tells."""
    file = path / SUMS
    if not file.exists():
        if version == 1:
            return
        raise UserError(f"{path}: this {what} is damaged ({SUMS} is missing)")
    try:
        lines = [line.partition("  ") for line in file.read_bytes().decode("ascii").splitlines()]
        written = {name: digest for digest, _, name in lines}
        names = _names(path)
        odd = sorted(written.keys() ^ set(names)) or [
            name for name in names if _sum(path / name) != written[name]
        ]
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: this {what} is damaged ({first_line(error)})") from None
    if odd:
        raise UserError(
            f"{path / odd[0][:100]}: this {what} is damaged (the file is not the one that was saved)"
        )


def _names(path: Path) -> list[str]:
    """The files that belong to a folder; what else lies in it is not ours."""
    inner = (file for file in (path / ARRAYS).rglob("*") if not file.is_dir())
    return sorted(file.relative_to(path).as_posix() for file in (path / CARD, *inner))


def sum_of_folder(path: Path) -> str:
    """Twelve hex digits of what a folder holds, by its sums; of its files where it has none.

    Raises:
        UserError: it cannot be read.
    """
    try:
        if (path / SUMS).is_file():
            return _sum(path / SUMS)[:12]
        lines = "".join(f"{_sum(path / name)}  {name}\n" for name in _names(path))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({first_line(error)})") from None
    return hashlib.sha256(lines.encode()).hexdigest()[:12]


def _sum(file: Path) -> str:
    if not file.is_file():
        raise OSError(f"{file.name} is no file")
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        raise ValueError("a key is written twice")
    return table


def _json(card: Mapping[str, Any]) -> bytes:
    def plain(value: Any) -> Any:
        is_array = isinstance(value, np.generic) or (hasattr(value, "tolist") and hasattr(value, "dtype"))
        if is_array and not is_no_data(value):
            return value.tolist()
        raise TypeError(
            f"{type(value).__name__} is no JSON value: give text, numbers, lists or tables of them"
        )

    try:
        text = json.dumps(card, indent=2, default=plain, allow_nan=False).encode() + b"\n"
        json.loads(text, object_pairs_hook=_unique)  # 1 and "1" are one key there: nobody could read it again
    except RecursionError:
        raise UserError("the card is nested too deep: give plainer values") from None
    except ValueError as error:
        raise UserError(
            f"a value of the card is no JSON value ({first_line(error)}): give finite numbers, and texts as keys"
        ) from None
    if len(text) > LARGEST_CARD:
        raise UserError(f"the card has {len(text):,} bytes: give less, {LARGEST_CARD:,} are allowed")
    return text


def _to_disk(folder: Path) -> None:
    """All files and folders of a folder are on the disk before it gets its name."""
    for place in (*folder.rglob("*"), folder):
        descriptor = os.open(place, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Without a word of orbax, absl, asyncio or a thread of theirs: what is wrong is said by an exception of ours."""
    import logging
    import warnings

    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    hook, sys.unraisablehook = sys.unraisablehook, lambda ignored: None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook = hook
        logging.disable(before)


def _checkpointer() -> Any:
    import orbax.checkpoint  # costs more than everything else here: only where a folder is written

    return orbax.checkpoint.StandardCheckpointer()
