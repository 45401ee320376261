"""The manifest with which a sweep begins: of what its folder holds, made anew where that was lost. Loads no jax."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gpcjax.sweep import machine
from gpcjax.sweep.growth import contradictions, covering, grown
from gpcjax.sweep.keeping import ENTRY, Keeping, as_json
from gpcjax.sweep.labels import labels_of
from gpcjax.sweep.layout import DAMAGED, FORMAT, MANIFEST, tell
from gpcjax.sweep.manifest import DamagedManifest, read_manifest
from gpcjax.sweep.parts import origins_of, refuse_measured
from gpcjax.sweep.plan import count, hash_of, specification_hash, varying
from gpcjax.sweep.runfolder import any_parts, set_aside
from gpcjax.sweep.sealing import Origin
from gpcjax.sweep.shards import Shard, share_of
from gpcjax.sweep.siblings import asked_with
from gpcjax.sweep.spec import SweepSpec, as_dict, from_dict
from gpcjax.sweep.store import SEALED
from gpcjax.sweep.versions import versions

UNKNOWN = "unknown, the manifest that said it was lost"
"""The machine of rows that this one has not computed: they tell of which kind it was, not which."""

ACCUMULATED = ("wall_time_s", "compile_time_s", "env_steps")
"""Numbers of the manifest that grow when an interrupted sweep goes on. Compile time is the sum over processes."""


def new_manifest(spec: SweepSpec, names: list[str], cells: int) -> dict[str, Any]:
    """The manifest of a sweep that has not run yet; `names` are its varying settings."""
    return {
        "format": FORMAT,
        "hash": specification_hash(spec),
        "specification": as_dict(spec),
        **labels_of(spec),
        "varying": names,
        "cells": cells,
        "baselines": {"idle": None, "oracles": {}},
        "versions": versions(),
        "machine": machine.describe(),
        "jobs": 0,
        **dict.fromkeys(ACCUMULATED, 0),
        "env_steps_per_s": 0,
        "complete": False,
    }


def begin(spec: SweepSpec, out: Path, keeping: Keeping | None, shard: Shard | None) -> dict[str, Any]:
    """The manifest of `out`; a new one where there is none, or none that is whole."""
    manifest, what = _held(out)
    if manifest is not None:
        return manifest
    if any_parts(out, spec):
        manifest = _from_parts(spec, out)
        tell(f"{out / MANIFEST} {what}: made anew from the parts, its times count from now on")
        return manifest
    specs = [spec] if shard is None else asked_with(out, shard, spec)
    if specs != [spec]:
        tell(f"{out}: the other shards were asked for other things before: it has its share of these, too")
    return _asked_for(specs) | {ENTRY: as_json(keeping)}


def asked(
    manifest: dict[str, Any], spec: SweepSpec, out: Path, shard: Shard | None, say: Callable[[str], None]
) -> tuple[dict[str, Any], str]:
    """The manifest of a folder that is asked for `spec`, perhaps beside what it was asked before; and the hash of that.

    Nothing is written yet.
    """
    request = covering(manifest, spec)
    if request is not None:
        return manifest, request
    larger = grown(manifest, spec)
    refuse_measured(out, manifest, {*larger["varying"]} - {*manifest["varying"]})
    if shard is not None:
        larger["cells"] = len(share_of(larger, shard))
    new = larger["cells"] - manifest["cells"]
    say(f"{out}: it grows by {new:,} to {larger['cells']:,} cells")
    return larger, specification_hash(spec)


def _held(out: Path) -> tuple[dict[str, Any] | None, str]:
    """The manifest that is there; or none, and what became of it: what is damaged is set aside."""
    try:
        if (out / MANIFEST).exists():
            return read_manifest(out), ""
        return None, "is missing"
    except DamagedManifest:
        set_aside(out, out / MANIFEST)
        return None, f"was damaged and lies in {out / DAMAGED} now"


def _from_parts(spec: SweepSpec, out: Path) -> dict[str, Any]:
    """The manifest of a folder that has lost it: what its parts say.

    They may be all that there is to compute, and of other versions or another machine than these. `spec` need not have
    been asked for before.
    """
    specs, origins = _recovered(spec, origins_of(out))
    manifest = _asked_for(specs)
    manifest["versions"] = origins[0].versions if origins else manifest["versions"]
    manifest["recovered"] = True
    for name in SEALED:
        if said := [each.manifest[name] for each in origins if name in each.manifest]:
            manifest[name] = said[-1]  # the newest has all names
    if {origin.machine for origin in origins} - {machine.kind_of(manifest["machine"])}:
        manifest["machine"] = {"processor": UNKNOWN}
    return manifest


def _recovered(spec: SweepSpec, origins: list[Origin]) -> tuple[list[SweepSpec], list[Origin]]:
    """All that its folder was asked for, as far as parts tell, in its order; and the origins that are of it.

    Each of these is asked for again, even what a later one covers: parts are named after it, and shares follow the
    order.
    """
    told = [dict(zip(each.named or map(hash_of, each.asked), each.asked, strict=True)) for each in origins]
    wanted, hash_ = as_dict(spec), specification_hash(spec)
    named = {its: one for own in told for its, one in own.items() if not contradictions(one, wanted)}
    known = {its: from_dict(one) for its, one in named.items()}
    if hash_ not in known and (not known or any(each.hash == hash_ for each in origins)):
        known[hash_] = spec
    mine = [each for each in origins if each.hash in known]
    orders = [each.order or list(own) for each, own in zip(origins, told, strict=True) if each.hash in known]
    order = dict.fromkeys(its for each in sorted(orders, key=len, reverse=True) for its in each)
    return [known[its] for its in {**order, **known} if its in known], mine


def _asked_for(specs: Sequence[SweepSpec]) -> dict[str, Any]:
    """The manifest of a folder that is asked for these, one after the other."""
    first, *further = specs
    manifest = new_manifest(first, varying(first), count(first))
    for each in further:
        manifest = grown(manifest, each)
    return manifest
