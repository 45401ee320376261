"""The manifest of a run folder: what the sweep is; where, with what and how far it ran. Loads no jax."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.sweep import points
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.keeping import ENTRY, held_keeping
from gpcjax.sweep.layout import FORMAT, GIVE, GROWN, MANIFEST, UNSEALED, reason, sha256
from gpcjax.sweep.plan import hash_of

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

_LARGEST_NUMBER = 1e18
"""Bound on all its numbers: none is negative, infinite or no number."""

_LONG = 20_000
"""Letters of an entry that is no longer indented."""


class DamagedManifest(UserError):
    """There is a manifest, but it is not what a sweep has written: `what` says how it differs."""

    def __init__(self, path: Path, what: str):
        super().__init__(f"{path}: {what}, {GIVE} (the same sweep may make a damaged one anew)")
        self.path, self.what = path, what

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.what)


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of the run folder `out`, with the sum of its content.

    Raises:
        OSError: the folder is missing or cannot be written.
    """
    sealed = {**manifest, "sha256": _sum_of(manifest)}
    write_atomic(out / MANIFEST, _laid_out(sealed))


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
        raise UserError(f"{path}: cannot be read ({reason(error)}), {GIVE}") from None
    except (ValueError, RecursionError) as error:
        raise DamagedManifest(path, f"cannot be read ({reason(error)})") from None
    match manifest:
        case {"format": int(version), "hash": str(), "specification": dict()}:
            if version not in (UNSEALED, FORMAT, GROWN) or isinstance(version, bool):
                known = f"this version reads the formats {UNSEALED} to {GROWN}"
                raise UserError(f"{path}: format {version!r} is not known, {known}")
        case _:
            raise DamagedManifest(path, "this is no manifest of a sweep")
    if not isinstance(manifest["specification"].get("hyperparameters", {}), dict):
        raise DamagedManifest(path, "its specification is damaged")
    try:
        # In format 2 a manifest is checked by its sum too once this version has written to it.
        if (version != UNSEALED or "sha256" in manifest) and manifest.get("sha256") != _sum_of(manifest):
            raise DamagedManifest(path, "it is not as it was written")
        if manifest["hash"] != hash_of(manifest["specification"]):
            raise DamagedManifest(path, "its hash is not that of its specification")
    except RecursionError:
        raise DamagedManifest(path, "it is too deep") from None
    for name, kind in _FIELDS.items():
        value = manifest.get(name)
        if not isinstance(value, kind) or not (kind in (str, dict, list, bool) or _is_number(value)):
            what = f"its {name} is damaged" if name in manifest else f"it has no {name}"
            raise DamagedManifest(path, what)
    for name, is_sound in _LATER.items():
        if name in manifest and not is_sound(manifest[name]):
            raise DamagedManifest(path, f"its {name} is damaged")
    if (version == GROWN) != isinstance(manifest.get("asked"), list):
        raise DamagedManifest(path, "what it was asked for is damaged")
    try:
        varying = _varying(manifest["specification"])
    except (TypeError, ValueError, AttributeError, KeyError):
        raise DamagedManifest(path, "its points are damaged") from None
    if sorted(map(str, manifest["varying"])) != varying:
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


def _laid_out(manifest: Mapping[str, Any]) -> str:
    """As text for people. What is long has a line for each entry: to indent it takes ten times as long."""
    entries = []
    for name, value in manifest.items():
        text = json.dumps(value)
        if len(text) < _LONG:
            text = json.dumps(value, indent=2).replace("\n", "\n  ")
        elif isinstance(value, list):
            text = "[\n    " + ",\n    ".join(map(json.dumps, value)) + "\n  ]"
        entries.append(f"  {json.dumps(name)}: {text}")
    return "{\n" + ",\n".join(entries) + "\n}\n"


def are_digests(value: object) -> bool:
    """Whether this is what `gpcjax.sweep.digests` notes: texts by part, by name."""
    return isinstance(value, dict) and all(
        isinstance(parts, dict) and all(isinstance(told, str) for told in parts.values())
        for parts in value.values()
    )


def _sum_of(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of the content, however its text is laid out."""
    content = {name: value for name, value in manifest.items() if name != "sha256"}
    return sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode())


def _varying(specification: Mapping[str, Any]) -> list[str]:
    """As `gpcjax.sweep.plan.varying`, sorted, of a specification as JSON has it."""
    axes = {name: specification.get(name) for name in ("delta", "rate")}
    axes |= points.given(specification)
    return sorted(name for name, values in axes.items() if isinstance(values, list) and len(values) > 1)


def _is_number(value: object) -> bool:
    """Whether it is a number as a sweep writes them."""
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < _LARGEST_NUMBER


def _are_requests(value: object) -> bool:
    """Whether this is what a folder was asked for, as `gpcjax.sweep.growth.requests` gives it."""
    return isinstance(value, list) and all(map(_is_request, value))


def _is_request(value: object) -> bool:
    match value:
        case {"hash": str(), "specification": dict(), "filled": dict(filled)}:
            return all(isinstance(by_learner, dict) for by_learner in filled.values())
    return False


def _is_keeping(value: object) -> bool:
    try:
        held_keeping({ENTRY: value})
    except ValueError:
        return False
    return True


_LATER: dict[str, Callable[[object], bool]] = {
    "finished": _is_number,
    "further_machines": lambda value: isinstance(value, list) and all(isinstance(one, dict) for one in value),
    "asked": _are_requests,
    ENTRY: _is_keeping,
    "digests": are_digests,
}
"""What a manifest may have, and how it must be then."""


def _is_baseline(numbers: object) -> bool:
    match numbers:
        case None | {"mean": float() | int(), "std": float() | int(), "n": int()}:
            return True
    return False
