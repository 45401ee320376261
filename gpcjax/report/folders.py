"""What `gpcjax runs` and `gpcjax show` print."""

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from gpcjax.report.document import Sheet
from gpcjax.report.words import algorithm
from gpcjax.sweep.growth import requests
from gpcjax.sweep.keeping import ENTRY, held_keeping, words_of
from gpcjax.sweep.listing import STRANGE, Contents, RunFolder, commands
from gpcjax.sweep.points import given
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.shards import held_shard
from gpcjax.sweep.source import Source
from gpcjax.sweep.telling import clock_time


def sheet(folders: Iterable[RunFolder], below: Path) -> Sheet:
    """A row for each folder, the one that was last written to comes last."""
    ordered = sorted(folders, key=lambda folder: folder.changed)
    return Sheet(
        title="",
        columns=("folder", "task", "learners", "error", "seeds", "cells", "state", "took", "last written"),
        rows=tuple(_row(folder, below) for folder in ordered),
        kinds=dict.fromkeys(("folder", "task", "learners", "error", "seeds", "state"), "word"),
    )


def facts(folder: RunFolder, held: Contents) -> dict[str, str]:
    """What there is to say of one folder, by name."""
    manifest = folder.manifest
    said = {"state": folder.state + (f": {folder.note}" if folder.note else "")}
    if not manifest:
        return said | {"files": _size(held.size)}
    asked = requests(manifest)
    specification = manifest["specification"]
    machines = [manifest["machine"], *manifest.get("further_machines", [])]
    shard = held_shard(manifest)
    said |= {
        **({"shard": f"{shard}, for gpcjax merge"} if shard is not None else {}),
        "task": specification["env"],
        "learners": ", ".join(map(algorithm, specification["algo"])),
        "teacher": specification.get("teacher", "oracle"),
        "oracle": ", ".join(specification["oracle"]),
        **({"start": Source(**specification["start"]).label} if specification.get("start") else {}),
        "error": _listed(specification["error"]),
        "seeds": str(specification["seeds"]),
        "episodes": str(specification["episodes"]),
        **{name: _listed(values) for name, values in given(specification).items()},
        "cells": f"{held.finished:,} of {manifest['cells']:,}",
        **({"keeps": words_of(held_keeping(manifest))} if ENTRY in manifest else {}),
        "asked": "once" if len(asked) == 1 else f"{len(asked)} times",
        "parts": f"{held.parts:,}, {_size(held.size)} in all",
        "took": f"{clock_time(manifest['wall_time_s'])}, {manifest['env_steps']:,} steps",
        "versions": ", ".join(f"{name} {version}" for name, version in manifest["versions"].items()),
        "machine": ", ".join(str(machine.get("processor", "unknown")) for machine in machines)
        + (f" ({len(machines)} kinds mixed: last bits may differ)" if len(machines) > 1 else ""),
        "last written": _date(folder.changed),
    }
    if held.damaged:
        more = f" and {len(held.damaged) - 3} more" if len(held.damaged) > 3 else ""
        said["damaged"] = "; ".join(held.damaged[:3]) + more
    if held.foreign:
        said["not its own"] = f"{len(held.foreign)} files, {held.foreign[0]} for one"
    if held.set_aside:
        said["set aside"] = f"{held.set_aside} damaged files"
    return said | _typed(folder)


def _typed(folder: RunFolder) -> dict[str, str]:
    if folder.manifest["specification"].get("teacher") == "person":
        return {"goes on with": f"gpcjax teach --out {folder.path}"}
    lines = commands(folder.manifest, folder.path)
    return {"made by" if folder.manifest["complete"] else "goes on with": "\n".join(lines)}


def _row(folder: RunFolder, below: Path) -> tuple[str, ...]:
    name = str(folder.path.relative_to(below)) if folder.path != below else str(folder.path)
    if folder.state == STRANGE:
        return (name, "", "", "", "", "", STRANGE, "", _date(folder.changed))
    specification: dict[str, Any] = folder.manifest["specification"]
    done = "" if folder.finished is None or folder.finished == folder.cells else f"{folder.finished:,}/"
    seeds = Seeds.of(specification["seeds"])
    return (
        name,
        specification["env"],
        ", ".join(map(algorithm, specification["algo"])),
        _listed(specification["error"]),
        "" if seeds is None else str(seeds),
        f"{done}{folder.cells:,}",
        folder.state,
        clock_time(folder.manifest["wall_time_s"]),
        _date(folder.changed),
    )


def _listed(values: Sequence[Any]) -> str:
    texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
    return ", ".join(texts if len(texts) <= 4 else [*texts[:2], "...", texts[-1]])


def _date(seconds: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(seconds))


def _size(count: float) -> str:
    for unit in ("bytes", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.0f} {unit}"
        count /= 1024
    return f"{count:.1f} GiB"
