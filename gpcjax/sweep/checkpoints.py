"""Runs that were under way when a sweep ended: which of them can go on, and from where. Loads no jax.

    OUT/checkpoints/TIME-PID-NUMBER/    a folder of `gpcjax.policies.folder`: arrays by orbax, a card, their sums

A worker writes such a folder every now and then, with all runs that it has at that moment, and then removes the one
before; the last one of a program goes when all its rows are stored. Its card lists their cells, and how far each of
them is. Nothing in it is part of what a sweep found: whatever is not whole, or of other versions, costs the time that
it would have saved. Only machines of the kind that wrote it go on with it: on others the bits would be neither of the
two.
"""

import base64
import contextlib
import dataclasses
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from gpcjax.errors import UserError
from gpcjax.policies.folder import read_card
from gpcjax.sweep.digests import ENTRY as DIGESTS
from gpcjax.sweep.digests import Digests, conflicts
from gpcjax.sweep.keeping import Keeping
from gpcjax.sweep.layout import CHECKPOINTS, Say, is_checkpoint, is_unfinished_checkpoint
from gpcjax.sweep.manifest import are_digests
from gpcjax.sweep.packing import compressed, expanded
from gpcjax.sweep.parts import names_in
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.runfolder import set_aside
from gpcjax.sweep.scales import SCALES
from gpcjax.sweep.source import Source

KIND = "checkpoint"


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a run is saved: the name of a folder in `OUT/checkpoints`, and which of the runs there it is."""

    folder: str
    index: int


Places = dict[str, dict[Cell, Place]]
"""Where runs are saved, by the kind of machine that has saved them and alone can go on with them."""

HERE = ""
"""This kind of machine: the desk's."""

SNAPSHOTS = 2
"""The format of what is in a checkpoint, `gpcjax.engine.snapshots.FORMAT`: those of another one go without a word."""

LAYOUT = 2
"""Of cells and of what is kept of them in a checkpoint, likewise."""


def told(
    versions: Mapping[str, str],
    machine: str,
    keeping: Keeping | None,
    digests: Digests = MappingProxyType({}),
) -> dict[str, Any]:
    """What runs must agree in to go on from a checkpoint, beside their cells."""
    return {
        "versions": dict(versions),
        "machine": machine,
        "snapshots": SNAPSHOTS,
        "layout": LAYOUT,
        "keeping": None if keeping is None else dataclasses.asdict(keeping),
        DIGESTS: dict(digests),
    }


def cell_as_json(cell: Cell) -> dict[str, Any]:
    """For a card."""
    return dataclasses.asdict(cell)


def cell_of(entries: Mapping[str, Any]) -> Cell:
    """The cell that `cell_as_json` was given. Raises KeyError, TypeError or ValueError for others."""
    hyperparameters = tuple((str(name), float(value)) for name, value in entries["hyperparameters"])
    series = {name: tuple(map(float, entries.get(name, ()))) for name in ("rate_schedule", *SCALES)}
    start = Source(**entries["start"]) if entries.get("start") else None
    return Cell(**{**entries, "hyperparameters": hyperparameters, **series, "start": start})


def runs_as_json(runs: Iterable[tuple[Cell, int]]) -> str:
    """Cells and the steps that each has made, for a card: one text, which thousands of them fit in."""
    told = [{"cell": cell_as_json(cell), "steps": steps} for cell, steps in runs]
    return base64.b64encode(compressed(told)).decode()


def runs_of(card: Mapping[str, Any]) -> list[tuple[Cell, int]]:
    """What `runs_as_json` was given. Raises KeyError, TypeError or ValueError for others."""
    told = expanded(base64.b64decode(card["runs"], validate=True))
    return [(cell_of(each["cell"]), int(each["steps"])) for each in told]


def survey(out: Path, is_missing: Callable[[Cell], bool], agree: Mapping[str, Any], say: Say) -> Places:
    """Where runs that are missing can go on: of several places, where they are most advanced.

    What helps none of them is removed, what is damaged is set aside with a line; a folder that is none of ours stays,
    and so does what another kind of machine has saved: a worker of that kind may come.

    Args:
        out: the run folder; the caller is the one who writes there.
        is_missing: whether a cell has no rows yet.
        agree: see `told`.
        say: takes a line for the person.
    """
    found = dict[tuple[str, Cell], tuple[int, Place]]()
    damaged, folders = [], []
    for name in names_in(out / CHECKPOINTS):
        path = out / CHECKPOINTS / name
        if is_unfinished_checkpoint(name):
            shutil.rmtree(path, ignore_errors=True)
        if not is_checkpoint(name):
            continue
        try:
            machine, runs = _runs(path, agree)
        except (UserError, KeyError, TypeError, ValueError):
            damaged.append(path)
            continue
        folders.append(name)
        kind = HERE if machine == agree.get("machine") else str(machine)
        for index, (cell, steps) in enumerate(runs):
            if is_missing(cell) and steps > found.get((kind, cell), (-1,))[0]:
                found[kind, cell] = steps, Place(name, index)
    if damaged:
        set_aside(out, *damaged)
        runs = "1 damaged checkpoint" if len(damaged) == 1 else f"{len(damaged)} damaged checkpoints"
        say(f"{out}: {runs} set aside, their runs begin anew ({CHECKPOINTS}/{damaged[0].name})")
    useful = {place.folder for _, place in found.values()}
    for name in set(folders) - useful:
        shutil.rmtree(out / CHECKPOINTS / name, ignore_errors=True)
    places: Places = {}
    for (kind, cell), (_, place) in found.items():
        places.setdefault(kind, {})[cell] = place
    return places


def under_way(out: Path, versions: Mapping[str, str]) -> set[Cell]:
    """The cells that these versions have saved in a folder, with whatever code of a person's own. Changes nothing."""
    agree = {"versions": dict(versions), "snapshots": SNAPSHOTS, "layout": LAYOUT}
    found: set[Cell] = set()
    for name in filter(is_checkpoint, names_in(out / CHECKPOINTS)):
        with contextlib.suppress(
            UserError, KeyError, TypeError, ValueError
        ):  # set aside where runs are to go on
            found.update(cell for cell, _ in _runs(out / CHECKPOINTS / name, agree)[1])
    return found


def receive(out: Path, name: str, write: Callable[[Path], None]) -> dict[Cell, Place]:
    """Takes in a checkpoint that was written on another machine; gives where its runs are.

    Args:
        out: the run folder.
        name: of the checkpoint.
        write: makes the folder of this name below the one that it is given.

    Raises:
        OSError, UserError, KeyError, TypeError, ValueError: it cannot be written, or is none.
    """
    whole = out / CHECKPOINTS / name
    parts = out / CHECKPOINTS / f".{name}-received"  # as what a writer leaves that is killed
    shutil.rmtree(parts, ignore_errors=True)
    (out / CHECKPOINTS).mkdir(exist_ok=True)  # not the run folder, which may have been removed
    parts.mkdir()
    try:
        write(parts)
        (parts / name).rename(whole)
    finally:
        shutil.rmtree(parts, ignore_errors=True)
    return {cell: Place(name, index) for index, (cell, _) in enumerate(_runs(whole, {})[1])}


def remove(out: Path, name: str) -> None:
    """A checkpoint of which all runs are stored."""
    if is_checkpoint(name):
        shutil.rmtree(out / CHECKPOINTS / name, ignore_errors=True)


def remove_all(out: Path) -> None:
    """The checkpoints of a sweep that has come to its end."""
    for name in names_in(out / CHECKPOINTS):
        if is_checkpoint(name) or is_unfinished_checkpoint(name):
            shutil.rmtree(out / CHECKPOINTS / name, ignore_errors=True)
    with contextlib.suppress(OSError):  # there is none, or somebody's own file is in it
        (out / CHECKPOINTS).rmdir()


def _runs(path: Path, agree: Mapping[str, Any]) -> tuple[Any, list[tuple[Cell, int]]]:
    """The machine of a checkpoint, its cells and the steps that each has made; no cells where it does not `agree`.

    Whatever machine it is of.
    """
    card = read_card(path, KIND)
    if card["kind"] != KIND:
        raise ValueError("no checkpoint")
    wanted = {name: value for name, value in agree.items() if name not in ("machine", DIGESTS)}
    agrees = {name: card.get(name) for name in wanted} == wanted
    # More names may have come since; and before there were digests, none of them was told.
    if not are_digests(held := card.get(DIGESTS, {})):
        raise ValueError(DIGESTS)
    agrees = agrees and not conflicts(held, agree.get(DIGESTS, {}))
    return card.get("machine"), runs_of(card) if agrees else []
