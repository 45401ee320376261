"""What run folders are there, and how far each of them is. Loads no jax."""

import contextlib
import os
import shlex
import stat
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpcjax.allowed import shown
from gpcjax.describe import TaskSpec
from gpcjax.envs.registry import NOBODY
from gpcjax.errors import UserError
from gpcjax.registry import built_in, find
from gpcjax.sweep.growth import hashes, requests
from gpcjax.sweep.keeping import ENTRY, held_keeping
from gpcjax.sweep.layout import DAMAGED, EPISODES, MANIFEST, reason
from gpcjax.sweep.lock import holder
from gpcjax.sweep.manifest import DamagedManifest, read_manifest
from gpcjax.sweep.options import CONCERNING_SOME, OPTIONS, concerns
from gpcjax.sweep.parts import Found, names_in, whole_parts
from gpcjax.sweep.points import POINTS
from gpcjax.sweep.rows import IDENTITY, cells_of
from gpcjax.sweep.shards import held_shard
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import from_dict

DEPTH = 3
"""Folders below the given one in which runs are looked for: a reproduction has a folder for each of its sweeps."""

COMPLETE, GOING_ON, INTERRUPTED, STRANGE = "complete", "going on", "interrupted", "not readable"


@dataclass(frozen=True)
class RunFolder:
    """A run folder, as its manifest tells.

    | Field       | Meaning                                                                      |
    |-------------|------------------------------------------------------------------------------|
    | `path`      | of the folder                                                                |
    | `state`     | "complete", "going on", "interrupted" or "not readable"                      |
    | `note`      | who writes there, or what is wrong with the manifest                          |
    | `cells`     | runs that were asked for                                                     |
    | `finished`  | those of them that are stored; None if the manifest does not say             |
    | `changed`   | when the manifest was last written, in seconds since 1970                    |
    | `manifest`  | all of it; empty where it cannot be read                                     |
    """

    path: Path
    state: str
    note: str
    cells: int
    finished: int | None
    changed: float
    manifest: Mapping[str, Any]

    def as_json(self) -> dict[str, Any]:
        """For programs; a path as text."""
        specification = self.manifest.get("specification", {})
        return {
            "folder": str(self.path),
            "state": self.state,
            "note": self.note,
            "cells": self.cells,
            "finished": self.finished,
            "changed": self.changed,
            **{
                name: specification.get(name)
                for name in ("env", "algo", "oracle", "error", "seeds", "episodes")
            },
            "wall_time_s": self.manifest.get("wall_time_s"),
            **({ENTRY: self.manifest[ENTRY]} if ENTRY in self.manifest else {}),
        }


def run_folders(below: Path) -> Iterator[RunFolder]:
    """The run folders in a folder, at most `DEPTH` deep, in the order of their names.

    Raises:
        UserError: there is no such folder, or it cannot be read.
    """
    if not below.is_dir():
        raise UserError(f"{below}: no such folder, give one that holds run folders (without one: runs)")
    names_in(below)
    for path in _with_manifest(below, DEPTH):
        yield look(path)


def look(path: Path) -> RunFolder:
    """One run folder. Never raises for what is in its manifest.

    Raises:
        UserError: there is no manifest.
    """
    try:
        changed = (path / MANIFEST).stat().st_mtime
    except OSError as error:
        raise UserError(f"{path}: this is no run folder ({MANIFEST}: {reason(error)})") from None
    writer = holder(path)
    try:
        manifest = read_manifest(path)
    except UserError as error:
        what = error.what if isinstance(error, DamagedManifest) else str(error)
        return RunFolder(path, STRANGE, what, 0, None, changed, {})
    for specification in (manifest["specification"], *(each["specification"] for each in requests(manifest))):
        if odd := _oddity(specification):
            return RunFolder(path, STRANGE, odd, 0, None, changed, {})
    finished = manifest["cells"] if manifest["complete"] else manifest.get("finished")
    state = GOING_ON if writer is not None else COMPLETE if manifest["complete"] else INTERRUPTED
    if finished and not _has_parts(path):
        writer, finished = writer or "its episodes are gone", 0
        state = GOING_ON if state == GOING_ON else INTERRUPTED
    return RunFolder(path, state, writer or "", manifest["cells"], finished, changed, manifest)


def _oddity(specification: Mapping[str, Any]) -> str:
    """What of a specification is none that could be told of; nothing of a sound one."""
    try:
        from_dict(specification)
        for name, kind in {"env": str, "algo": str, "oracle": str, "error": int | float}.items():
            value = specification[name]
            values = [value] if name == "env" else value
            if not isinstance(values, list) or not values or not all(isinstance(one, kind) for one in values):
                raise ValueError(f"{name} {shown(value)}")
        if not isinstance(specification["episodes"], int):
            raise ValueError(f"episodes {shown(specification['episodes'])}")
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        return f"its specification is damaged ({reason(error)})"
    return ""


def _has_parts(path: Path) -> bool:
    """Whether there is any file of episodes, whatever is in it."""
    try:
        with os.scandir(path / EPISODES) as entries:
            return any(entry.name.endswith(".parquet") for entry in entries)
    except FileNotFoundError:
        return False
    except OSError:
        return True  # which cannot be known


@dataclass(frozen=True)
class Contents:
    """What lies in a run folder: `size` in bytes, and what was found to be not whole or not its own."""

    finished: int
    parts: int
    size: int
    damaged: tuple[str, ...]
    foreign: tuple[str, ...]
    set_aside: int
    """Files that an earlier sweep found to be damaged."""


def looked_into(path: Path) -> tuple[RunFolder, Contents]:
    """A run folder and what lies there, both by one manifest. As `look`."""
    folder = look(path)
    while True:
        held = contents(folder)
        if not held.foreign or not folder.manifest:
            return folder, held
        # Rows of what was asked for meanwhile, perhaps, with those of before beside them.
        now = look(path)
        if not now.manifest or [*hashes(now.manifest)] == [*hashes(folder.manifest)]:
            return folder, held
        folder = now


def contents(folder: RunFolder) -> Contents:
    """Reads all keys of a folder and checks all sums."""
    found, keys = Found(), [*IDENTITY, *folder.manifest.get("varying", ())]
    stored: set[tuple[Any, ...]] = set()
    parts = 0
    if folder.manifest:
        for part in whole_parts(folder.path, folder.manifest, found, {EPISODES: keys}):
            stored |= cells_of(part.tables[EPISODES], keys)
            parts += 1
    files = _files(folder.path)
    return Contents(
        finished=len(stored),
        parts=parts,
        size=sum(files.values()),
        damaged=tuple(f"{path}: {what}" for path, what in found.damaged.items()),
        foreign=tuple(found.foreign),
        set_aside=sum(path.parts[0].startswith(DAMAGED) for path in files),
    )


def _files(folder: Path) -> dict[Path, int]:
    """The files below a folder, by their path there, with their sizes; without those that go meanwhile."""
    found = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            with contextlib.suppress(OSError):
                about = path.stat()
                if stat.S_ISREG(about.st_mode):
                    found[path.relative_to(folder)] = about.st_size
    return found


def commands(manifest: Mapping[str, Any], out: Path) -> list[str]:
    """What was typed, or does the same: a line for each time that something was asked of the folder."""
    kept = held_keeping(manifest) if ENTRY in manifest else None
    running, note = [] if kept is None else kept.flags, ""
    shard = held_shard(manifest)
    if shard is not None:
        running += ["--shard", str(shard)]
        where = shard.folder(Path()).parts
        if out.parts[-len(where) :] == where:
            out = out.parents[len(where) - 1]
        else:
            note = f"where this folder is {'/'.join(where)} of that one"
    running += ["--out", str(out)]
    return [_command(each["specification"], running, note) for each in requests(manifest)]


def _command(specification: Mapping[str, Any], running: Sequence[str], note: str) -> str:
    words = ["gpcjax", "sweep"]
    for name, value in {**specification, **specification.get("hyperparameters", {})}.items():
        option = OPTIONS.get(name)
        if name in ("hyperparameters", POINTS) or value == [] or value is None:
            continue
        if (name == "oracle" and value == [NOBODY]) or not _may_concern(name, specification["algo"]):
            continue
        if option is None:
            words += ["--set", f"{name}={_written(value)}"]
        elif isinstance(value, bool):
            words += [] if value == option.default else [f"--{'' if value else 'no-'}{option.flag[2:]}"]
        elif name == "env" or _written(value) != _written(_usual(name, specification["env"])):
            words += [option.flag, _written(value)]
    joint = specification.get(POINTS)
    points = f"with its {len(joint)} [[points]] in a file of settings" if joint else ""
    notes = ", ".join(filter(None, (points, note)))
    return shlex.join([*words, *running]) + (f"  # {notes}" if notes else "")


def _may_concern(name: str, algo: Sequence[str]) -> bool:
    """Whether a setting that a specification has may be given, as far as it is known, likewise."""
    if name not in CONCERNING_SOME:
        return True
    learners = [find("learner", each) for each in algo if each in built_in("learner")]
    teacher = find("teacher", built_in("teacher")[0])  # no matter which
    return len(learners) < len(algo) or any(concerns(name, learner, teacher) for learner in learners)


def _usual(name: str, env: str) -> Any:
    """What holds if nobody gives a value, as far as it is known without a module of a person's own."""
    task = find("task", env) if env in built_in("task") else TaskSpec(env, env)
    if name in ("episodes", "max_capacity") and (env in built_in("task") or name == "max_capacity"):
        return getattr(task, name)
    return OPTIONS[name].default


def _written(value: Any) -> str:
    """As a flag has it."""
    if isinstance(value, Mapping):
        return Source(**value).folder
    if isinstance(value, list | tuple):
        return ",".join(map(_written, value))
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def _listed(folder: Path) -> list[str]:
    """What lies in a folder; nothing where it may not be read, which is no reason to list no other."""
    try:
        return names_in(folder)
    except UserError:
        return []


def _with_manifest(folder: Path, depth: int) -> Iterator[Path]:
    if os.path.isfile(folder / MANIFEST):
        yield folder
        return
    if depth:
        for name in _listed(folder):
            if not name.startswith(".") and os.path.isdir(folder / name):
                yield from _with_manifest(folder / name, depth - 1)
