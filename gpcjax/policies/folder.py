"""A folder of arrays and a card that says what they are: written whole, and read only as it was written.

folder/card.json     JSON values
folder/arrays/       an orbax checkpoint of named arrays
folder/SHA256SUMS    of all these files, as `sha256sum -c` reads it; folders of format 1 may do without it

No file runs code when it is read, and none can make its reader take more memory than the files themselves ask for.
"""

import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.allowed import checked_path, is_no_data
from gpcjax.errors import UserError, unwritten
from gpcjax.policies.checkpoint import first_line, forget_place, save_arrays, stored_arrays

FORMAT = 2
FORMATS = (1, 2)
CARD, ARRAYS, SUMS = "card.json", "arrays", "SHA256SUMS"
LARGEST_CARD = 2**22
"""Bytes."""
LARGEST_ARRAY = 2**28
"""Numbers: two gigabytes."""


def write_folder(path: Any, card: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Writes a new folder, which is whole or absent. `card` may hold numpy's numbers and arrays.

    Raises:
        FileExistsError: there is something at `path`.
        ValueError: a value of the card is not finite, or too large, an array has no entries, or other than numbers and
            truth values; or nothing can be written at `path`.
        TypeError: a value of the card that JSON does not know.
    """
    path = checked_path("path", path)
    if os.path.lexists(path):
        raise FileExistsError(f"{path} exists: choose another path, or remove it first")
    _refuse_unkept(path, arrays)
    shapes = {name: list(value.shape) for name, value in arrays.items()}
    text = _json({"format": FORMAT, **card, "arrays": shapes})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
        try:
            save_arrays(scratch / ARRAYS, arrays)
            forget_place(scratch / ARRAYS)
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


def _refuse_unkept(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Refuses arrays that a checkpoint does not take. Raises UserError."""
    if not arrays:
        raise UserError(f"{path}: there is no array with an entry to save")
    for name, value in arrays.items():
        if not value.size:
            raise UserError(f"{path}: {name} has no entries (shape {value.shape}), which cannot be saved")
        # Numbers of other libraries (bfloat16) are of kind V to numpy, as records are, which have names.
        if value.dtype.kind not in "biufcV" or value.dtype.names is not None:
            raise UserError(
                f"{path}: {name} has entries of {value.dtype}, which cannot be saved: give numbers"
            )


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
    arrays, wrong = stored_arrays(folder, shapes)
    # Raised where no exception of tensorstore's is around, which says the same at length.
    if wrong:
        raise UserError(f"{folder}: the arrays of this {what} cannot be read ({wrong})")
    return arrays


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
