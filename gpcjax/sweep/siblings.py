"""The other shards of a sweep, as far as their folders lie beside one's own. Loads no jax.

Which cells a share has depends on everything that the folder was asked for, in its order. A shard whose folder is new
while its sweep has grown takes that order from another one: so what was lost is made again by the last command alone.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.sweep.growth import contradictions, covering, requests
from gpcjax.sweep.layout import SHARDS
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import specification_hash
from gpcjax.sweep.shards import Shard, held_shard
from gpcjax.sweep.spec import SweepSpec, as_dict, from_dict


def asked_with(out: Path, shard: Shard, spec: SweepSpec) -> list[SweepSpec]:
    """All that a new folder of a share is asked for with `spec`, in the order of the other shards.

    These have been asked for `spec`, or will be: so it comes last, unless they have all of it already. Then it was no
    request of theirs, and would be one here, whose shares no merge takes.
    """
    hash_, found = specification_hash(spec), []
    for manifest in _siblings(out, shard):
        asked = [from_dict(each["specification"]) for each in requests(manifest)]
        places = [place for place, each in enumerate(requests(manifest)) if each["hash"] == hash_]
        if contradictions(manifest["specification"], as_dict(spec)):
            continue  # another sweep's, which merging would tell
        if places:
            found.append((True, [*asked[: places[0]], spec]))
        else:
            found.append((False, asked if covering(manifest, spec) else [*asked, spec]))
    return max(found, key=lambda each: (each[0], len(each[1])), default=(False, [spec]))[1]


def _siblings(out: Path, shard: Shard) -> Iterator[Mapping[str, Any]]:
    """The manifests of the other shards of as many, in the order of their numbers' words."""
    if out.parent.name != SHARDS:
        return
    for path in sorted(out.parent.glob(f"*-of-{shard.of}")):
        if path == out:
            continue
        try:
            manifest = read_manifest(path)
        except UserError:
            continue
        held = held_shard(manifest)
        if held is not None and held.of == shard.of:
            yield manifest
