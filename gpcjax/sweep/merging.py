"""The shards of a sweep as one run folder: `gpcjax merge`. Loads no jax.

A shard's parts say that they are rows of the whole specification, and are what a plain sweep would have written: they
are checked and copied as they are. The manifest comes last, so that an interrupted merge leaves nothing that looks
whole, and the same command does it again, whatever part of it was copied.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.changed import refuse_unlike
from gpcjax.sweep.checkpoints import remove_all
from gpcjax.sweep.digests import ENTRY as DIGESTS
from gpcjax.sweep.digests import conflicts
from gpcjax.sweep.growth import hashes, requests
from gpcjax.sweep.keeping import ENTRY, held_keeping, words_of
from gpcjax.sweep.layout import BESIDE, DAMAGED, EPISODES, MANIFEST, SHARDS, tell
from gpcjax.sweep.lock import held, holder
from gpcjax.sweep.machine import kind_of
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.parts import Found, whole_parts
from gpcjax.sweep.plan import plan
from gpcjax.sweep.rows import IDENTITY, cells_of, key_of
from gpcjax.sweep.runfolder import check_sweep, clean_parts, make_writable, set_aside
from gpcjax.sweep.shards import Shard, held_shard
from gpcjax.sweep.spec import from_dict

UNTOLD = "untold"
"""What is kept of the runs of a folder whose manifest does not say."""

Keys = set[tuple[Any, ...]]
"""What tells cells apart."""


@dataclass(frozen=True)
class _Share:
    """A shard's run folder."""

    folder: Path
    shard: Shard
    manifest: dict[str, Any]
    parts: dict[str, Keys]
    """The cells of each part, by its name."""

    @property
    def cells(self) -> Keys:
        """Of all parts."""
        return set().union(*self.parts.values())


def merge(folders: Sequence[Path], out: Path | None = None) -> Path:
    """Makes a complete run folder of all shards of a sweep; gives it.

    Args:
        folders: run folders of shards, or folders with a folder `shards` of them.
        out: the run folder of the whole, which may hold some of its rows; the one of `folders` with a folder `shards`
            by default.

    Raises:
        UserError: a shard is missing, not complete, damaged or being written; shards are not of the same sweep, number
            of shards or versions, or overlap; or `out` holds something else.
    """
    given = list(_found(folders))
    if out is None:
        wholes = [folder for folder in folders if (folder / SHARDS).is_dir()]
        if len(wholes) != 1:
            raise UserError("merge: --out is missing, give the run folder of the whole")
        out = wholes[0]
    shares = _checked([_share(*each) for each in given])
    first = shares[0].manifest
    specs = [from_dict(request["specification"]) for request in requests(first)]
    names = tuple(first["varying"])
    wanted = {key_of(cell, names) for spec in specs for cell in plan(spec)}
    _refuse_gaps(shares, wanted)
    before = _before(out, shares)
    if before is None:
        check_sweep(out, specs[0], copied=hashes(first))
    make_writable(out)
    with held(out):
        clean_parts(out)
        found = Found()
        stored = _keys(out, first, found)
        for name in found.parts:
            set_aside(out, *(out / folder / name for folder in (EPISODES, *BESIDE)))
        found.speak(out, tell, f"moved to {out / DAMAGED}, the shards have its rows")
        there = set().union(*stored.values())
        for share in shares:
            for name, cells in share.parts.items():
                if name not in stored and not cells <= there:
                    _copy(share.folder, out, name)
        write_manifest(out, _merged(shares, before, len(wanted)))
        remove_all(out)  # of a plain sweep that was under way there
    return out


def _found(folders: Iterable[Path]) -> Iterable[tuple[Path, Shard, dict[str, Any]]]:
    """The run folders of shards that these are or hold, with what each says."""
    for folder in dict.fromkeys(folders):
        paths = [folder]
        if (folder / SHARDS).is_dir():
            paths = sorted(path for path in (folder / SHARDS).iterdir() if (path / MANIFEST).is_file())
            if not paths:
                raise UserError(f"{folder / SHARDS}: no shard is there, run one with --shard i/n")
        for path in paths:
            manifest = read_manifest(path)
            if (shard := held_shard(manifest)) is None:
                raise UserError(
                    f"{path}: this is no shard of a sweep, give folders that --shard i/n has made"
                )
            yield path, shard, manifest


def _share(folder: Path, shard: Shard, manifest: dict[str, Any]) -> _Share:
    if (writer := holder(folder)) is not None:
        raise UserError(f"{folder}: shard {shard} is still being written ({writer}), wait until it ends")
    found = Found()
    parts = _keys(folder, manifest, found)
    if found.damaged:
        path, what = next(iter(found.damaged.items()))
        raise UserError(f"{folder}: shard {shard} is damaged ({path}: {what}), run it again")
    share = _Share(folder, shard, manifest, parts)
    if not manifest["complete"] or len(share.cells) < manifest["cells"]:
        done = f"{len(share.cells):,} of {manifest['cells']:,} cells"
        raise UserError(f"{folder}: shard {shard} is not complete ({done}), run it again")
    return share


def _keys(folder: Path, manifest: Mapping[str, Any], found: Found) -> dict[str, Keys]:
    """The cells of each whole part, by its name."""
    columns = [*IDENTITY, *manifest["varying"]]
    parts = whole_parts(folder, manifest, found, {EPISODES: columns})
    return {part.name: cells_of(part.tables[EPISODES], columns) for part in parts}


def _checked(shares: Sequence[_Share]) -> list[_Share]:
    """The shares in their order, if they are all shares of one sweep, each once."""
    shares = sorted(shares, key=lambda share: share.shard)
    first = shares[0]
    for share in shares[1:]:
        if sorted(hashes(share.manifest)) != sorted(hashes(first.manifest)):
            raise UserError(_other_requests(first, share))
        if share.shard.of != first.shard.of:
            raise UserError(
                f"{share.folder}: it is shard {share.shard}, {first.folder} is {first.shard}: give shards of one number"
            )
        telling = next((each for each in shares if ENTRY in each.manifest), first)
        if keeps := _keeps_other(share.manifest, telling.manifest):
            raise UserError(
                f"{share.folder}: {keeps[0]}, {telling.folder} {keeps[1]}: run one again into a new folder"
            )
        for name, version in first.manifest["versions"].items():
            other = share.manifest["versions"].get(name)
            if other != version:
                raise UserError(
                    f"{share.folder}: it was made with {name} {other}, {first.folder} with {version}: run one again"
                )
    refuse_unlike((share.folder, share.manifest) for share in shares)
    by_index: dict[int, _Share] = {}
    for share in shares:
        if (twin := by_index.setdefault(share.shard.number, share)) is not share:
            raise UserError(
                f"{share.folder}: it is shard {share.shard}, and so is {twin.folder}: give one of the two"
            )
    missing = [str(index) for index in range(1, first.shard.of + 1) if index not in by_index]
    if missing:
        more = f" and {len(missing) - 10:,} more" if len(missing) > 10 else ""
        if len(missing) == 1:
            raise UserError(f"shard {missing[0]} of {first.shard.of} is missing: run it, or give its folder")
        raise UserError(
            f"shards {', '.join(missing[:10])}{more} of {first.shard.of} are missing: run them, or give their folders"
        )
    return shares


def _keeps_other(manifest: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[str, str] | None:
    """What each of two folders keeps of its runs, in words; None if it is the same, or one does not say."""
    kept = [each.get(ENTRY, UNTOLD) for each in (manifest, other)]
    if UNTOLD in kept or kept[0] == kept[1]:
        return None
    its, others = (words_of(held_keeping(each)) for each in (manifest, other))
    return f"of its runs it keeps {its}", others


def _other_requests(first: _Share, share: _Share) -> str:
    """Why two shards are not of one sweep, as far as it can be mended."""
    mine, its = (hashes(each.manifest).keys() for each in (first, share))
    less, more = (share, first) if len(its) < len(mine) else (first, share)
    if not mine & its:
        return f"{share.folder}: it is a shard of another sweep than {first.folder}"
    if hashes(less.manifest).keys() < hashes(more.manifest).keys() and _begins_alike(less, more):
        return (
            f"{less.folder}: it was asked for less than {more.folder}: give it the later commands that `gpcjax show` "
            "tells of that one, too"
        )
    return (
        f"{less.folder}: it was not asked for the same things as {more.folder}, one after the other: run it again into "
        "a new folder with the commands that `gpcjax show` tells of that one, in their order"
    )


def _begins_alike(less: _Share, more: _Share) -> bool:
    """Whether a shard was asked for the same things as another, but not for all of them yet."""
    asked = [[each["hash"] for each in requests(share.manifest)] for share in (less, more)]
    return asked[0] == asked[1][: len(asked[0])]


def _refuse_gaps(shares: Sequence[_Share], wanted: Keys) -> None:
    """Refuse shares that do not make up the whole, each cell once."""
    cells = [share.cells for share in shares]
    if sum(map(len, cells)) == len(wanted) and set().union(*cells) == wanted:
        return
    for share in shares[1:]:
        # In another order they have other shares.
        if list(hashes(share.manifest)) != list(hashes(shares[0].manifest)):
            raise UserError(_other_requests(shares[0], share))
    seen: Keys = set()
    for share in shares:
        if twice := len(share.cells & seen):
            raise UserError(
                f"{share.folder}: {twice:,} of its cells are in another shard too, run one of the two again"
            )
        seen |= share.cells
    if seen != wanted:
        raise UserError(
            f"{len(wanted - seen):,} of {len(wanted):,} cells are in no shard, as if they had been made by another "
            "version: run all shards again into new folders"
        )


def _before(out: Path, shares: Sequence[_Share]) -> dict[str, Any] | None:
    """The manifest of the whole where there is one already: of the same sweep, before it grew perhaps."""
    if not (out / MANIFEST).exists():
        return None
    manifest, first = read_manifest(out), shares[0].manifest
    if held_shard(manifest) is not None or not hashes(manifest).keys() <= hashes(first).keys():
        raise UserError(f"{out}: it holds another sweep than the shards, give a new folder (--out)")
    if manifest["versions"] != first["versions"]:
        raise UserError(f"{out}: it was made with other versions than the shards, give a new folder (--out)")
    for share in shares:
        if other := conflicts(manifest.get(DIGESTS, {}), share.manifest.get(DIGESTS, {})):
            raise UserError(
                f"{out}: its {next(iter(other))} is another one than that of the shards, give a new folder (--out)"
            )
        if keeps := _keeps_other(manifest, share.manifest):
            raise UserError(f"{out}: {keeps[0]}, the shards {keeps[1]}: give a new folder (--out)")
    return manifest


def _copy(source: Path, out: Path, name: str) -> None:
    """A part as it is; its episodes last, which make it one."""
    for folder in (*BESIDE, EPISODES):
        (out / folder).mkdir(exist_ok=True)
        if (source / folder / name).is_file():
            write_atomic(out / folder / name, (source / folder / name).read_bytes())


def _merged(shares: Sequence[_Share], before: Mapping[str, Any] | None, cells: int) -> dict[str, Any]:
    """The manifest of the whole: its time is that of the longest shard, as they ran beside each other."""
    manifests = [share.manifest for share in shares]
    every = [*([before] if before is not None else []), *manifests]
    machines = [each for one in every for each in (one["machine"], *one.get("further_machines", []))]
    kinds: dict[str, Any] = {}
    for each in machines:
        kinds.setdefault(kind_of(each) or str(each), each)
    first, *further = kinds.values()
    if further:
        tell(f"its rows were made on {len(kinds)} kinds of machine: last bits may differ, see the manifest")
    left_out = ["shard", "further_machines"]
    if not all(ENTRY in one for one in every):
        left_out.append(ENTRY)
    merged = {name: value for name, value in manifests[0].items() if name not in left_out}
    digests = {name: parts for one in every for name, parts in one.get(DIGESTS, {}).items()}
    merged |= {
        **({DIGESTS: digests} if digests else {}),
        "baselines": _baselines(every),
        "machine": first,
        **({"further_machines": further} if further else {}),
        "cells": cells,
        "finished": cells,
        "complete": True,
        "wall_time_s": max(each["wall_time_s"] for each in manifests),
        **{name: sum(each[name] for each in manifests) for name in ("jobs", "compile_time_s", "env_steps")},
    }
    merged["env_steps_per_s"] = merged["env_steps"] / max(merged["wall_time_s"], 1e-9)
    return merged


def _baselines(manifests: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Each baseline as the first that has it."""
    idle, oracles = None, {}
    for manifest in manifests:
        idle = idle or manifest["baselines"]["idle"]
        oracles = {**manifest["baselines"]["oracles"], **oracles}
    return {"idle": idle, "oracles": oracles}
