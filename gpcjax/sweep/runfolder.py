"""A run folder before anything runs: is it one, is it this sweep's, can it be written? Loads no jax.

    OUT/manifest.json                              what the sweep is; where, with what and how far it ran
    OUT/episodes/part-NUMBER-HASH-DIGEST.parquet   rows of finished cells
    OUT/corrections/part-...                       the corrections of the part of the same name
    OUT/damaged/...                                what was no longer whole: set aside, never deleted
    OUT/.gpcjax.lock                               while a sweep writes here

Format 3: HASH is the specification's, DIGEST the first half of the file's SHA-256. Inside, the key-value metadata of
the Parquet file says again which specification its rows belong to, and with which versions they were made; that of the
episodes has the SHA-256 of the corrections. The manifest carries the SHA-256 of its own content. So a file tells by
itself whose it is and whether it is whole, wherever it lies and whatever became of the rest.

Format 2 had parts named `part-NUMBER-RANDOM.parquet` that say nothing of themselves, and no sums: such a folder is
read, checked as far as that goes, and continued with parts of format 3.
"""

import hashlib
import itertools
import json
import os
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.errors import UserError
from gpcjax.sweep.atomic import target_of, write_atomic
from gpcjax.sweep.lock import LOCK
from gpcjax.sweep.plan import canonical, hash_of, specification_hash
from gpcjax.sweep.spec import SweepSpec, as_dict

FORMAT = 3
"""Version of the run folder's layout, kept in the manifest and in each part."""

UNSEALED = 2
"""The format whose files carry no sums."""

MANIFEST = "manifest.json"
EPISODES = "episodes"
CORRECTIONS = "corrections"
DAMAGED = "damaged"

Say = Callable[[str], None]
"""Takes a line for the person."""

_PART = re.compile(r"part-(?P<number>\d{5,})-(?P<hash>[0-9a-f]{12})-(?P<digest>[0-9a-f]{32})\.parquet")
_UNSEALED_PART = re.compile(r"part-(?P<number>\d{5,})-[0-9a-f]{12}\.parquet")

_FIELDS: dict[str, type | tuple[type, ...]] = {
    "hash": str,
    "specification": dict,
    "varying": list,
    "cells": int,
    "baselines": dict,
    "versions": dict,
    "machine": dict,
    "jobs": int,
    "wall_time_s": (int, float),
    "compile_time_s": (int, float),
    "env_steps": int,
    "env_steps_per_s": (int, float),
    "complete": bool,
}
"""What every manifest has beside its format."""

_GIVE = "give a folder that a sweep has made"
_GIVE_NEW = "give a new folder, or the one of the same sweep (--out)"


class DamagedManifest(UserError):
    """There is a manifest, but it is not what a sweep has written: `what` says how it differs."""

    def __init__(self, path: Path, what: str):
        super().__init__(f"{path}: {what}, {_GIVE} (the same sweep may make a damaged one anew)")
        self.path, self.what = path, what

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.what)


class PartName(NamedTuple):
    """What the name of a part says; `hash` and `digest` are empty in format 2."""

    number: int
    hash: str
    digest: str


def tell(line: str) -> None:
    """A line for the person at the terminal, on stderr."""
    print(f"gpcjax: {line}", file=sys.stderr, flush=True)


def warn(line: str) -> None:
    """The same for the reader of a Python call, who may turn warnings into errors."""
    warnings.warn(line, UserWarning, stacklevel=6)  # of whoever called `gpcjax.load`


def sha256(data: bytes) -> str:
    """In 64 hex digits."""
    return hashlib.sha256(data).hexdigest()


def part_name(number: int, specification: str, content: bytes) -> str:
    """The name of a part of the sweep with this hash, whose episodes are `content`."""
    return f"part-{number:05d}-{specification}-{sha256(content)[:32]}.parquet"


def parse_part(name: str) -> PartName | None:
    """What the name of a part says, None for any other file's."""
    if match := _PART.fullmatch(name):
        return PartName(int(match["number"]), match["hash"], match["digest"])
    if match := _UNSEALED_PART.fullmatch(name):
        return PartName(int(match["number"]), "", "")
    return None


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of the run folder `out`, with the sum of its content.

    Raises:
        OSError: the folder is missing or cannot be written.
    """
    sealed = {**manifest, "sha256": _sum_of(manifest)}
    write_atomic(out / MANIFEST, json.dumps(sealed, indent=2) + "\n")


def read_manifest(out: Path) -> dict[str, Any]:
    """The manifest of the run folder `out`.

    Raises:
        DamagedManifest: it is none of ours, or no longer what we wrote.
        UserError: there is none, it cannot be read, or it is of a format that this version does not know.
    """
    path = out / MANIFEST
    try:
        manifest = json.loads(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({_reason(error)}), {_GIVE}") from None
    except (ValueError, RecursionError) as error:
        raise DamagedManifest(path, f"cannot be read ({_reason(error)})") from None
    match manifest:
        case {"format": int(version), "hash": str(), "specification": dict()}:
            if version not in (FORMAT, UNSEALED) or isinstance(version, bool):
                known = f"this version reads the formats {UNSEALED} and {FORMAT}"
                raise UserError(f"{path}: format {version!r} is not known, {known}")
        case _:
            raise DamagedManifest(path, "this is no manifest of a sweep")
    if not isinstance(manifest["specification"].get("hyperparameters", {}), dict):
        raise DamagedManifest(path, "its specification is damaged")
    try:
        # In format 2 a manifest is checked by its sum too once this version has written to it.
        if (version == FORMAT or "sha256" in manifest) and manifest.get("sha256") != _sum_of(manifest):
            raise DamagedManifest(path, "it is not as it was written")
        if manifest["hash"] != hash_of(manifest["specification"]):
            raise DamagedManifest(path, "its hash is not that of its specification")
    except RecursionError:
        raise DamagedManifest(path, "it is too deep") from None
    for name, kind in _FIELDS.items():
        if not isinstance(manifest.get(name), kind):
            what = f"its {name} is damaged" if name in manifest else f"it has no {name}"
            raise DamagedManifest(path, what)
    if sorted(map(str, manifest["varying"])) != _varying(manifest["specification"]):
        raise DamagedManifest(path, "its varying settings are not those of its specification")
    baselines = manifest["baselines"]
    if not (
        "idle" in baselines
        and isinstance(baselines.get("oracles"), dict)
        and all(map(_is_baseline, (baselines["idle"], *baselines["oracles"].values())))
    ):
        raise DamagedManifest(path, "its baselines are damaged")
    return manifest


def is_complete(out: Path) -> bool:
    """Whether a sweep has come to its end there, by a manifest that is whole."""
    try:
        return bool(read_manifest(out)["complete"])
    except UserError:
        return False


def check_report(out: Path) -> None:
    """Refuse a folder that holds nothing to report.

    Raises:
        UserError: `out` is no run folder, or has no episodes yet.
    """
    if not _exists(out) or not out.is_dir():
        raise UserError(f"{out}: no such folder, {_GIVE}")
    read_manifest(out)
    if not any((out / EPISODES).glob("*.parquet")):
        raise UserError(f"{out}: it holds no episodes yet, {_GIVE}")


def check_sweep(out: Path, spec: SweepSpec) -> None:
    """Refuse a folder that is something else, or another sweep's. Writes nothing.

    Without a manifest, or with a damaged one, a folder is this sweep's if it holds a part that says so; what is found
    there beside our own parts is nobody's business then. Otherwise it must be empty.

    Raises:
        UserError: `out` is a file, another specification's, or holds what no sweep has put there.
    """
    if not _exists(out):
        return
    if not out.is_dir():
        raise UserError(f"{out}: this is no folder, {_GIVE_NEW}")
    try:
        names = {path.name for path in out.iterdir()}
        for name in (EPISODES, CORRECTIONS):
            if name in names and not (out / name).is_dir():
                raise UserError(f"{out / name}: this is no folder, {_GIVE_NEW}")
        hash_ = specification_hash(spec)
        if MANIFEST in names:
            _check_manifest(out, spec, hash_)
        elif not own_parts(out, hash_):
            _check_empty(out, names)
    except OSError as error:
        raise UserError(f"{out}: cannot be read ({_reason(error)}), {_GIVE_NEW}") from None


def _check_manifest(out: Path, spec: SweepSpec, hash_: str) -> None:
    try:
        manifest = read_manifest(out)
    except DamagedManifest as error:
        if own_parts(out, hash_):
            return  # they say what they are: a manifest can be made anew
        none = "no part beside it says to be of this sweep"
        raise UserError(f"{out / MANIFEST}: {error.what}, and {none}: restore it, or {_GIVE_NEW}") from None
    if manifest["hash"] != hash_:
        old, new = manifest["specification"], as_dict(spec)
        names = [name for name in new if canonical(old.get(name)) != canonical(new[name])]
        raise UserError(f"{out}: it holds another specification ({', '.join(names)}), {_GIVE_NEW}")


def _check_empty(out: Path, names: Iterable[str]) -> None:
    """Nothing but what a sweep leaves that was killed before it wrote its manifest."""
    for name in sorted(names):
        if name == LOCK or target_of(name) == MANIFEST:
            continue
        inside = (
            sorted(path.name for path in (out / name).iterdir()) if name in (EPISODES, CORRECTIONS) else [""]
        )
        if any(map(parse_part, inside)):
            raise UserError(f"{out}: it holds rows of another sweep and no manifest, {_GIVE_NEW}")
        for each in inside:
            if parse_part(target_of(each) or "") is None:
                raise UserError(f"{out}: it holds {str(Path(name, each))!r} and no run, {_GIVE_NEW}")


def own_parts(out: Path, hash_: str) -> list[str]:
    """Names of parts that say to be of the specification with this hash. Raises OSError."""
    folder = out / EPISODES
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return sorted(name for name in names if (part := parse_part(name)) and part.hash == hash_)


def make_writable(out: Path) -> None:
    """Make the folder, and a file in it for a moment: permissions alone do not tell whether that works.

    Raises:
        UserError: it does not.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: nothing can be written there ({_reason(error)}), {_GIVE_NEW}") from None
    check_writable(out, _GIVE_NEW)


def check_writable(out: Path, instead: str = "report on a copy of it") -> None:
    """Make a file in the folder for a moment.

    Raises:
        UserError: it cannot be made; the message ends in what to do `instead`.
    """
    try:
        with tempfile.TemporaryFile(dir=out) as file:
            file.write(b"x" * 4096)  # an empty file fits on a full disk
    except OSError as error:
        raise UserError(f"{out}: nothing can be written there ({_reason(error)}), {instead}") from None


def set_aside(out: Path, *paths: Path) -> None:
    """Move what is damaged to the same place below `OUT/damaged`, beside what lies there already.

    A file that is gone meanwhile is no error.

    Raises:
        OSError: it cannot be moved.
    """
    for path in paths:
        target = _damaged_folder(out, path.parent.relative_to(out)) / path.name
        free = target
        for number in range(1, 1_000_000):
            if not os.path.lexists(free):
                break
            free = target.with_name(f"{target.name}.{number}")
        try:
            shutil.move(path, free)
        except FileNotFoundError:
            continue


def _damaged_folder(out: Path, below: Path) -> Path:
    """Where damaged files of a folder go: below `OUT/damaged`, or beside it where that is a person's own file."""
    for number in itertools.count():
        folder = out / (f"{DAMAGED}.{number}" if number else DAMAGED) / below
        try:
            folder.mkdir(parents=True, exist_ok=True)
            return folder
        except (FileExistsError, NotADirectoryError):
            continue
    raise AssertionError("there is always a next number")


def _sum_of(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of the content, however its text is laid out."""
    content = {name: value for name, value in manifest.items() if name != "sha256"}
    return sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode())


def _varying(specification: Mapping[str, Any]) -> list[str]:
    """As `gpcjax.sweep.plan.varying`, sorted, of a specification as JSON has it."""
    axes = {name: specification.get(name) for name in ("delta", "rate")}
    axes |= specification.get("hyperparameters") or {}
    return sorted(name for name, values in axes.items() if isinstance(values, list) and len(values) > 1)


def _is_baseline(numbers: object) -> bool:
    match numbers:
        case None | {"mean": float() | int(), "std": float() | int(), "n": int()}:
            return True
    return False


def _exists(out: Path) -> bool:
    """Whether there is something at `out`, where that can be known."""
    try:
        out.lstat()
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:
        raise UserError(f"{out}: no folder can be there ({_reason(error)}), {_GIVE_NEW}") from None
    return True


def _reason(error: BaseException) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
