"""Folders that runs begin with: what is learned there, and which of it a run takes. Loads no jax.

Such a folder is a run folder with kept states, of which the newest of each run counts, or one saved learner. Of the
states themselves few are in memory, neighbours in one part of the folder: they may be gigabytes, and each worker reads
some.
"""

import functools
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.policies.folder import CARD, SUMS, read_arrays, read_card
from gpcjax.sweep.boxes import setting_of
from gpcjax.sweep.layout import KEPT, MANIFEST, Say, sha256, tell
from gpcjax.sweep.packing import unpacked
from gpcjax.sweep.parts import Found
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.reading import kept_parts
from gpcjax.sweep.rows import IDENTITY
from gpcjax.sweep.source import Source
from gpcjax.sweep.steady import steadily

RELATIVES = {"gpc": ("gpc-ns",), "gpc-ns": ("gpc",)}
"""Learners that can go on with what another one has learned, beside those of their own name."""

_TOLD_OF_RUN = ("oracle", "error")
"""Columns that tell runs of a learner with a seed apart, beside the settings that vary."""

_MOST_SHOWN = 5


class Place(NamedTuple):
    """Where a state is kept in a run folder."""

    part: str
    """Name of the file."""
    episode: int
    sum: str
    """Of its content."""


class State(NamedTuple):
    """What one run had learned in the end, or what a saved learner has, but for the arrays."""

    values: Mapping[str, Any]
    """Of the columns that tell it from others; nothing of a saved learner."""
    card: Mapping[str, Any]
    """`gpcjax.learners.packed`: algo, sizes; the capacities of a run are its points, those of a saved learner its room,
    which is left out here."""
    place: Place | None = None
    """Nothing of a saved learner, whose arrays are in its folder."""


class Contents:
    """What a folder holds for runs to begin with.

    Args:
        folder: absolute.
        states: all of them.
        digest: of all of them, in any order.
    """

    def __init__(self, folder: Path, states: Sequence[State], digest: str):
        self.folder, self.digest, self.states = folder, digest, states
        self._held = list(dict.fromkeys(state.card["algo"] for state in states))
        self._apart: dict[tuple[Any, ...], tuple[str, dict[Any, list[State]]] | None] = {}
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
        held = self._held
        algo = next((name for name in (cell.algo, *RELATIVES.get(cell.algo, ())) if name in held), None)
        if algo is None:
            raise UserError(
                f"{told}: it holds what {_listed(held)} learned, which means nothing to {cell.algo}: "
                f"give --algo {','.join(held)}, or another folder"
            )
        if not self._runs:
            (state,) = self.states
            return state
        found = self._runs.get((algo, cell.seed), [])
        if not found:
            seeds = [seed for name, seed in self._runs if name == algo]
            raise UserError(
                f"{told}: it holds nothing that {algo} learned with seed {cell.seed}, give --seeds among those it has "
                f"({_listed(sorted(seeds))})"
            )
        path: tuple[Any, ...] = (algo, cell.seed)
        while (apart := self._told_apart(path, found)) is not None:
            name, by_value = apart
            own = getattr(cell, name) if name in _TOLD_OF_RUN else setting_of(cell, name)
            found, path = by_value.get(own, []), (*path, own)
            if not found:
                raise UserError(
                    f"{told}: {algo} learned there with {name} {_listed(by_value)}, and these runs have "
                    f"{'no' if own is None else shown(own)} {name}: give one of them, or a folder with one alone"
                )
        (state,) = found
        return state

    def _told_apart(
        self, path: tuple[Any, ...], found: Sequence[State]
    ) -> tuple[str, dict[Any, list[State]]] | None:
        """The first column in which these states differ, and they by its values; None where they differ in none.

        Kept for each `path` to them: what runs ask is asked by each of them.
        """
        if path not in self._apart:
            self._apart[path] = None
            for name in found[0].values if len(found) > 1 else ():
                by_value: dict[Any, list[State]] = {}
                for state in found:
                    by_value.setdefault(state.values[name], []).append(state)
                if len(by_value) > 1:
                    self._apart[path] = name, by_value
                    break
        return self._apart[path]

    def packed(self, state: State, place: str = "start") -> tuple[str, bytes]:
        """Card and arrays of one of the states of runs, as they were kept.

        Raises:
            UserError: they are no longer what they were; `place` begins the message.
        """
        assert state.place is not None
        part, episode, digest = state.place
        try:
            path = self.folder / KEPT / part
            places = _places(path)[state.values["algo"], state.values["seed"], episode]
            rows = (_group(path, group).slice(row, 1).to_pylist()[0] for group, row in places)
            pairs = ((row["card"], row["arrays"]) for row in rows)
            return next(pair for pair in pairs if _sum(*pair) == digest)
        except (OSError, KeyError, StopIteration, pa.ArrowException):
            raise UserError(f"{place} {self.folder}: it has changed since the sweep was asked for") from None

    def arrays(self, state: State, place: str = "start") -> Mapping[str, np.ndarray]:
        """Named arrays of one of the states, as `gpcjax.learners.packed` names them.

        Raises:
            UserError: they cannot be read; `place` begins the message.
        """
        if state.place is None:
            return read_arrays(self.folder, read_card(self.folder, "learner"), "learner")
        try:
            return unpacked(*self.packed(state, place))[1]
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, UserError):
                raise
            raise UserError(f"{place} {self.folder}: what was kept there is damaged ({error})") from None


@functools.lru_cache(maxsize=1)
def _places(path: Path) -> dict[tuple[str, int, int], list[tuple[int, int]]]:
    """Row group, and place in it, of what is kept in a file, by learner, seed and episode. Of neighbours it is one."""
    found: dict[tuple[str, int, int], list[tuple[int, int]]] = {}
    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            rows = file.read_row_group(group, columns=["algo", "seed", "episode"])
            columns = (rows[name].to_pylist() for name in ("algo", "seed", "episode"))
            for place, key in enumerate(zip(*columns, strict=True)):
                found.setdefault(key, []).append((group, place))
    return found


@functools.lru_cache(maxsize=1)
def _group(path: Path, group: int) -> pa.Table:
    """Card and arrays of each row of a row group: of few, but in parts of 0.2.0, which have one group."""
    with pq.ParquetFile(path) as file:
        return file.read_row_group(group, columns=["card", "arrays"])


def source_of(text: str, place: str) -> Source:
    """What a person names as a folder to begin with.

    Raises:
        UserError: it is no such folder, or damaged; `place` begins the message.
    """
    folder = Path(os.path.abspath(os.path.expanduser(text)))
    return Source(str(folder), contents_of(folder, place, tell).digest)


def contents_of(folder: Path, place: str, say: Say = lambda line: None) -> Contents:
    """What a folder holds; `say` gets a line for what is damaged. Raises UserError."""
    if (folder / MANIFEST).is_file():
        return _of_runs(folder, place, say)
    if (folder / CARD).is_file():
        card = read_card(folder, "learner")
        if card.get("kind") == "learner" and (folder / SUMS).is_file():
            # Its sums, which were checked, tell its content.
            digest = sha256((folder / SUMS).read_bytes())[:12]
            return Contents(folder, [State({}, _checked(card, folder, place))], digest)
    raise UserError(
        f"{place} {folder}: nothing to begin with is there, give a run folder with kept states (--keep states) or a "
        "saved learner (gpcjax.save_learner, OUT/saves/NAME of gpcjax teach)"
    )


def _of_runs(folder: Path, place: str, say: Say) -> Contents:
    def read(manifest: Mapping[str, Any], found: Found) -> dict[str, State]:
        last: dict[str, State] = {}
        for part, own, episode, card, arrays in _kept_states(folder, manifest, found):
            key = json.dumps(list(own.values()))
            before = last.get(key)
            if before is None or before.place is None or before.place.episode <= episode:
                told = _checked(json.loads(card), folder, place)
                last[key] = State(own, told, Place(part, episode, _sum(card, arrays)))
        return last

    last, _, found = steadily(folder, read)
    found.speak(folder, say, "left out, the same sweep computes what is missing again")
    if not last:
        taught = ", give OUT/saves/NAME of it" if (folder / "course.json").exists() else ""
        raise UserError(
            f"{place} {folder}: no states were kept there{taught or ', give --keep states to the sweep that makes it'}"
        )
    states = sorted(last.values(), key=lambda state: str(list(state.values.values())))
    sums = [
        json.dumps([state.values["algo"], state.values["seed"], state.place.episode, state.place.sum])
        for state in states
        if state.place is not None
    ]
    return Contents(folder, states, sha256("\n".join(sorted(sums)).encode())[:12])


def _kept_states(
    folder: Path, manifest: Mapping[str, Any], found: Found
) -> Iterator[tuple[str, dict[str, Any], int, str, bytes]]:
    """Part, values of the columns that tell runs apart, episode, card and arrays of each state."""
    beside = (*IDENTITY, "episode", "return", "kind", "card", "arrays")
    for part, table in kept_parts(folder, manifest, found):
        names = ["algo", "seed", *_TOLD_OF_RUN, *(name for name in table.column_names if name not in beside)]
        for batch in table.to_batches(max_chunksize=64):
            columns = [
                batch.column(name).to_pylist() for name in (*names, "episode", "kind", "card", "arrays")
            ]
            for *values, episode, kind, card, arrays in zip(*columns, strict=True):
                if kind == "state":
                    own = {
                        name: None if value != value else value
                        for name, value in zip(names, values, strict=True)
                    }
                    yield part, own, episode, card, arrays


def _sum(card: str, arrays: bytes) -> str:
    return sha256(card.encode() + arrays)


def _checked(card: Mapping[str, Any], folder: Path, place: str) -> Mapping[str, Any]:
    """A card, if it says what of it is asked here."""
    match card:
        case {"algo": str(), "obs_size": int(), "action_size": int()}:
            return card
    raise UserError(f"{place} {folder}: what was kept there is damaged, or of another version")


def _listed(values: Iterable[Any]) -> str:
    texts = [shown(value) if isinstance(value, float) else str(value) for value in values]
    return ", ".join(texts if len(texts) <= _MOST_SHOWN else [*texts[: _MOST_SHOWN - 1], "...", texts[-1]])
