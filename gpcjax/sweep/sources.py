"""Folders that runs begin with: what is learned there, and which of it a run takes. Loads no jax.

Such a folder is a run folder with kept states, of which the newest of each run counts, or one saved learner.
"""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.policies.folder import CARD, SUMS, read_card
from gpcjax.registry import find
from gpcjax.sweep.growth import setting_of
from gpcjax.sweep.kept import newest
from gpcjax.sweep.layout import MANIFEST, sha256
from gpcjax.sweep.plan import Cell, plan
from gpcjax.sweep.reading import read_kept
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import SweepSpec

RELATIVES = {"gpc": ("gpc-ns",), "gpc-ns": ("gpc",)}
"""Learners that can go on with what another one has learned, beside those of their own name."""

_TOLD_OF_RUN = ("oracle", "error")
"""Columns that tell runs of a learner with a seed apart, beside the settings that vary."""

_MOST_SHOWN = 5


class State(NamedTuple):
    """What one run had learned in the end, or what a saved learner has."""

    values: Mapping[str, Any]
    """Of the columns that tell it from others; nothing of a saved learner."""
    card: Mapping[str, Any]
    """`gpcjax.learners.packed`: algo, sizes; the capacities of a run are its points, those of a saved learner its room,
    which is left out here."""
    packed: tuple[str, bytes]
    """Card and arrays as they were kept; of a saved learner nothing, whose arrays are in its folder."""


class Contents:
    """What a folder holds for runs to begin with.

    Args:
        folder: absolute.
        states: all of them.
        digest: of all of them, in any order.
    """

    def __init__(self, folder: Path, states: Sequence[State], digest: str):
        self.folder, self.digest, self._states = folder, digest, states
        self._runs: dict[tuple[str, int], list[State]] = {}
        for state in states:
            if state.values:
                self._runs.setdefault((state.values["algo"], state.values["seed"]), []).append(state)

    def of(self, cell: Cell, place: str = "start") -> State:
        """What a run begins with.

        Raises:
            UserError: nothing here, or it does not say which; `place` begins the message.
        """
        told = f"{place} {self.folder}"
        held = list(dict.fromkeys(state.card["algo"] for state in self._states))
        algo = next((name for name in (cell.algo, *RELATIVES.get(cell.algo, ())) if name in held), None)
        if algo is None:
            raise UserError(
                f"{told}: it holds what {_listed(held)} learned, which means nothing to {cell.algo}: "
                f"give --algo {','.join(held)}, or another folder"
            )
        if not self._runs:
            (state,) = self._states
            return state
        found = self._runs.get((algo, cell.seed), [])
        if not found:
            seeds = [seed for name, seed in self._runs if name == algo]
            raise UserError(
                f"{told}: it holds nothing that {algo} learned with seed {cell.seed}, give --seeds among those it has "
                f"({_listed(sorted(seeds))})"
            )
        for name in found[0].values:
            values = list(dict.fromkeys(state.values[name] for state in found))
            if len(values) == 1 or name in ("algo", "seed"):
                continue
            own = getattr(cell, name) if name in _TOLD_OF_RUN else setting_of(cell, name)
            found = [state for state in found if state.values[name] == own]
            if not found:
                raise UserError(
                    f"{told}: {algo} learned there with {name} {_listed(values)}, and these runs have "
                    f"{'no' if own is None else shown(own)} {name}: give one of them, or a folder with one alone"
                )
        (state,) = found
        return state


def source_of(text: str, place: str) -> Source:
    """What a person names as a folder to begin with.

    Raises:
        UserError: it is no such folder, or damaged; `place` begins the message.
    """
    folder = Path(os.path.abspath(os.path.expanduser(text)))
    return Source(str(folder), contents_of(folder, place).digest)


def check_start(spec: SweepSpec, place: str = "start") -> None:
    """Refuses a sweep of which a run finds nothing to begin with, as far as that can be told without computing.

    Raises:
        UserError: a run finds nothing, or several things; or what it finds is of other sizes than the task, or too
            large for `max_capacity`.
    """
    if spec.start is None:
        return
    contents, sizes = contents_of(Path(spec.start.folder), place), find("task", spec.env).sizes
    for cell in plan(spec):
        card = contents.of(cell, place).card
        told = f"{place} {contents.folder}"
        if sizes is not None and sizes != (given := (card["obs_size"], card["action_size"])):
            raise UserError(
                f"{told}: it was learned with {given[0]} numbers of an observation and {given[1]} actions, "
                f"{spec.env} has {sizes[0]} and {sizes[1]}"
            )
        points = max(card.get("capacities", {}).values(), default=0)
        if points > spec.max_capacity:
            raise UserError(
                f"{told}: a dictionary holds {points} points, give a --max-capacity of that at least"
            )


def contents_of(folder: Path, place: str) -> Contents:
    """What a folder holds. Raises UserError."""
    if (folder / MANIFEST).is_file():
        return _of_runs(folder, place)
    if (folder / CARD).is_file():
        card = read_card(folder, "learner")
        if card.get("kind") == "learner" and (folder / SUMS).is_file():
            # Its sums, which were checked, tell its content.
            digest = sha256((folder / SUMS).read_bytes())[:12]
            return Contents(
                folder, [State({}, {**_checked(card, folder, place), "capacities": {}}, ("", b""))], digest
            )
    raise UserError(
        f"{place} {folder}: nothing to begin with is there, give a run folder with kept states (--keep states) or a "
        "saved learner (gpcjax.save_learner, OUT/saves/NAME of gpcjax teach)"
    )


def _of_runs(folder: Path, place: str) -> Contents:
    frame = read_kept(folder)
    if len(frame):
        frame = frame.loc[frame["kind"] == "state"]
    if frame.empty:
        taught = ", give OUT/saves/NAME of it" if (folder / "course.json").exists() else ""
        raise UserError(
            f"{place} {folder}: no states were kept there{taught or ', give --keep states to the sweep that makes it'}"
        )
    beside = ("env", "algo", "seed", "episode", "return", "kind", "card", "arrays", *_TOLD_OF_RUN)
    names = ["algo", "seed", *_TOLD_OF_RUN, *(name for name in frame.columns if name not in beside)]
    states, sums, last = [], [], newest(frame)
    columns = [last[name].tolist() for name in (*names, "episode", "card", "arrays")]
    for *values, episode, card, arrays in zip(*columns, strict=True):
        own = {name: None if value != value else value for name, value in zip(names, values, strict=True)}
        states.append(State(own, _checked(json.loads(card), folder, place), (card, arrays)))
        content = sha256(card.encode() + arrays)
        sums.append(json.dumps([own["algo"], own["seed"], episode, content]))
    return Contents(folder, states, sha256("\n".join(sorted(sums)).encode())[:12])


def _checked(card: Mapping[str, Any], folder: Path, place: str) -> Mapping[str, Any]:
    """A card, if it says what of it is asked here."""
    match card:
        case {"algo": str(), "obs_size": int(), "action_size": int()}:
            return card
    raise UserError(f"{place} {folder}: what was kept there is damaged, or of another version")


def _listed(values: Iterable[Any]) -> str:
    texts = [shown(value) if isinstance(value, float) else str(value) for value in values]
    return ", ".join(texts if len(texts) <= _MOST_SHOWN else [*texts[: _MOST_SHOWN - 1], "...", texts[-1]])
