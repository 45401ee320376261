"""What names of a person's own stand for, in the manifest of a folder: no name has rows of two things. Loads no jax."""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.sweep.checkpoints import under_way
from gpcjax.sweep.digests import ENTRY, conflicts, digests_of, names_of, which
from gpcjax.sweep.layout import EPISODES, Say
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.rows import cells_of
from gpcjax.sweep.spec import ORACLE, SweepSpec
from gpcjax.sweep.versions import versions


def note(
    out: Path,
    manifest: dict[str, Any],
    specs: Iterable[SweepSpec],
    missing: Iterable[Cell],
    baselines: Collection[str],
    say: Say,
) -> None:
    """Adds to the manifest of a folder what the names stand for of which something is to run.

    What it says already stays, but of a name that has no rows yet, and no runs under way: what was measured of that
    alone is forgotten. Where nothing is to run a line tells what its rows were not made with.

    Args:
        out: the run folder.
        manifest: of the folder.
        specs: have these names.
        missing: the cells that are to run.
        baselines: the idle policy, and experts, that are to be measured.
        say: takes a line for the person.

    Raises:
        UserError: a name of which there are rows stood for something else.
    """
    specs = list(specs)
    asked = {(cell.env, cell.teacher, cell.algo, cell.oracle) for cell in missing}
    names = {name for one in asked for name in names_of(*one)}
    names |= {f"env {spec.env}" for spec in specs if baselines} | {f"oracle {name}" for name in baselines}
    every = {name: parts for spec in specs for name, parts in digests_of(spec).items()}
    now = {name: parts for name, parts in every.items() if name in names}
    held = manifest.get(ENTRY, {})
    changed, new = conflicts(held, now), now.keys() - held.keys()
    made = _made(out, manifest) if changed or new else set()
    for name, parts in changed.items():
        if name in made:
            raise UserError(
                f"{out}: {name} is not what it was when this folder was begun{which(name, parts)}: bring that back, "
                "or give a new folder (--out)"
            )
        _forget_baselines(manifest, name)
    stays = [name for name in conflicts(held, every) if name not in names]
    if stays and manifest["versions"] == versions():
        say(f"{out}: {', '.join(stays)} changed since its rows were made, which stay as they are")
    if untold := [name for name in now if name in new & made]:
        say(
            f"{out}: its manifest does not say what {', '.join(untold)} was when its rows were made: it is held to "
            "what it is now"
        )
    if now:
        manifest[ENTRY] = {**held, **now}


def refuse_unlike(folders: Iterable[tuple[Path, Mapping[str, Any]]]) -> None:
    """Refuses run folders, each with its manifest, in which a name stands for two things. Raises UserError."""
    told: dict[str, tuple[Path, Mapping[str, str]]] = {}
    for folder, manifest in folders:
        held = manifest.get(ENTRY, {})
        for name in conflicts(held, {name: parts for name, (_, parts) in told.items()}):
            raise UserError(
                f"{folder}: its {name} is another one than that of {told[name][0]}: run one again into a new folder"
            )
        told = {name: (folder, parts) for name, parts in held.items()} | told


def _made(out: Path, manifest: Mapping[str, Any]) -> set[str]:
    """The names of which a folder has rows, or runs under way."""
    from gpcjax.sweep.parts import Found, whole_parts  # which loads pyarrow

    columns = ("env", "algo", "oracle")
    found = set[tuple[str, ...]]()
    for part in whole_parts(out, manifest, Found(), {EPISODES: columns}):
        found |= cells_of(part.tables[EPISODES], columns)
    teacher = manifest["specification"].get("teacher", ORACLE)
    runs = {(env, teacher, algo, oracle) for env, algo, oracle in found}
    runs |= {
        (cell.env, cell.teacher, cell.algo, cell.oracle) for cell in under_way(out, manifest["versions"])
    }
    return {name for run in runs for name in names_of(*run)}


def _forget_baselines(manifest: dict[str, Any], name: str) -> None:
    """What was measured of something else under this name."""
    setting, _, name = name.partition(" ")
    known = manifest["baselines"]
    if setting == "env":
        manifest["baselines"] = {"idle": None, "oracles": {}}
    elif setting == "oracle":
        oracles = {each: numbers for each, numbers in known["oracles"].items() if each != name}
        manifest["baselines"] = {**known, "oracles": oracles}
