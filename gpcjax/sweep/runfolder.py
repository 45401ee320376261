"""A run folder before anything runs: is it one, is it this sweep's, can it be written? Loads no jax."""

import itertools
import os
import shutil
import tempfile
from collections.abc import Container, Iterable
from pathlib import Path

from gpcjax.errors import UserError, unwritten
from gpcjax.sweep import growth
from gpcjax.sweep.atomic import clean, target_of
from gpcjax.sweep.layout import (
    BESIDE,
    CHECKPOINTS,
    DAMAGED,
    EPISODES,
    GIVE,
    GIVE_NEW,
    MANIFEST,
    SHARDS,
    is_checkpoint,
    is_unfinished_checkpoint,
    parse_part,
    reason,
)
from gpcjax.sweep.lock import LOCK
from gpcjax.sweep.manifest import DamagedManifest, read_manifest
from gpcjax.sweep.plan import canonical, specification_hash
from gpcjax.sweep.spec import SweepSpec, as_dict


def check_report(out: Path) -> None:
    """Refuse a folder that holds nothing to report.

    Raises:
        UserError: `out` is no run folder, or has no episodes yet.
    """
    if not _exists(out) or not out.is_dir():
        raise UserError(f"{out}: no such folder, {GIVE}")
    read_manifest(out)
    if not any((out / EPISODES).glob("*.parquet")):
        raise UserError(f"{out}: it holds no episodes yet, {GIVE}")


def check_sweep(out: Path, spec: SweepSpec, grows: bool = True, copied: Iterable[str] = ()) -> None:
    """Refuse a folder that is something else, or another sweep's. Writes nothing.

    Where it `grows`, it may hold a sweep that this one can be added to.

    Without a manifest, or with a damaged one, a folder is this sweep's if it holds a part that says so; what is found
    there beside our own parts is nobody's business then. Otherwise it must be empty, but for what an interrupted merge
    has left: files of parts of this sweep, and of the specifications with the hashes `copied`.

    Raises:
        UserError: `out` is a file, another specification's, or holds what no sweep has put there.
    """
    if not _exists(out):
        return
    if not out.is_dir():
        raise UserError(f"{out}: this is no folder, {GIVE_NEW}")
    try:
        names = {path.name for path in out.iterdir()}
        for name in (EPISODES, *BESIDE):
            if name in names and not (out / name).is_dir():
                raise UserError(f"{out / name}: this is no folder, {GIVE_NEW}")
        hash_ = specification_hash(spec)
        if MANIFEST in names:
            _check_manifest(out, spec, hash_, grows)
        elif not (any_parts(out, spec) if grows else own_parts(out, hash_)):
            _check_empty(out, names, {hash_, *copied})
    except OSError as error:
        raise UserError(f"{out}: cannot be read ({reason(error)}), {GIVE_NEW}") from None


def _check_manifest(out: Path, spec: SweepSpec, hash_: str, grows: bool) -> None:
    try:
        manifest = read_manifest(out)
    except DamagedManifest as error:
        if any_parts(out, spec) if grows else own_parts(out, hash_):
            return  # they say what they are: a manifest can be made anew
        none = "no part beside it says to be of this sweep"
        raise UserError(f"{out / MANIFEST}: {error.what}, and {none}: restore it, or {GIVE_NEW}") from None
    if manifest["hash"] == hash_:
        return
    if not grows:
        old, new = manifest["specification"], as_dict(spec)
        names = [name for name in new if canonical(old.get(name)) != canonical(new[name])]
        raise UserError(f"{out}: it holds another specification ({', '.join(names)}), {GIVE_NEW}")
    growth.check(out, manifest, spec)


def _check_empty(out: Path, names: Iterable[str], copied: Container[str]) -> None:
    """Nothing but what a sweep leaves that was killed before it wrote its manifest, and shards, which are not in it."""
    for name in sorted(names):
        if name in (LOCK, SHARDS) or target_of(name) == MANIFEST:
            continue
        if name == CHECKPOINTS and _holds_checkpoints(out / name):
            continue  # of runs that nobody can go on with but the same sweep
        parts = name in (EPISODES, *BESIDE)
        inside = sorted(path.name for path in (out / name).iterdir()) if parts else [""]
        inside = [each for each in inside if (part := parse_part(each)) is None or part.hash not in copied]
        if any(map(parse_part, inside)):
            raise UserError(f"{out}: it holds rows of another sweep and no manifest, {GIVE_NEW}")
        for each in inside:
            if parse_part(target_of(each) or "") is None:
                raise UserError(f"{out}: it holds {str(Path(name, each))!r} and no run, {GIVE_NEW}")


def _holds_checkpoints(folder: Path) -> bool:
    """And nothing else."""
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else [""]
    return all(is_checkpoint(name) or is_unfinished_checkpoint(name) for name in names)


def own_parts(out: Path, hash_: str) -> list[str]:
    """Names of parts that say to be of the specification with this hash. Raises OSError."""
    folder = out / EPISODES
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return sorted(name for name in names if (part := parse_part(name)) and part.hash == hash_)


def any_parts(out: Path, spec: SweepSpec) -> bool:
    """Whether there are parts that say to be of a specification, or of others that it can be added to.

    Raises:
        OSError, UserError: they cannot be read.
    """
    if own_parts(out, specification_hash(spec)):
        return True
    from gpcjax.sweep.parts import origins_of  # which loads pyarrow: only where a manifest is lost

    asked = (one for each in origins_of(out) for one in each.asked)
    return any(not growth.contradictions(one, as_dict(spec)) for one in asked)


def clean_parts(out: Path) -> None:
    """Remove temporary files that a kill has left: nobody but the writer of this folder makes them."""
    clean(out, lambda target: target == MANIFEST)
    for folder in (EPISODES, *BESIDE):
        clean(out / folder, lambda target: parse_part(target) is not None)


def make_writable(out: Path) -> None:
    """Make the folder, and a file in it for a moment: permissions alone do not tell whether that works.

    Raises:
        UserError: it does not.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritten(error, f"{out}: nothing can be written there ({reason(error)}), {GIVE_NEW}") from None
    check_writable(out, GIVE_NEW)


def check_writable(out: Path, instead: str = "report on a copy of it") -> None:
    """Make a file in the folder for a moment.

    Raises:
        UserError: it cannot be made; the message ends in what to do `instead`.
    """
    try:
        with tempfile.TemporaryFile(dir=out) as file:
            file.write(b"x" * 4096)  # an empty file fits on a full disk
    except OSError as error:
        raise unwritten(error, f"{out}: nothing can be written there ({reason(error)}), {instead}") from None


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


def _exists(out: Path) -> bool:
    """Whether there is something at `out`, where that can be known."""
    try:
        out.lstat()
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:
        raise UserError(f"{out}: no folder can be there ({reason(error)}), {GIVE_NEW}") from None
    return True
