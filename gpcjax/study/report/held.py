"""What a study's folder holds, read once: participants, their logs, and the rows of their runs. Loads no jax."""

import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from gpcjax.errors import UserError
from gpcjax.recording import RECORD
from gpcjax.study.kept import ACTIVE, COMPLETE
from gpcjax.study.participant import LOG, Participant
from gpcjax.study.register import read_folder, read_people
from gpcjax.study.spec import Study
from gpcjax.study.steps import RunStep
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, MANIFEST, Say
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.parts import Found, whole_parts

TAIL = 4096
"""Bytes at the end of a recording among which its last episode's end is."""

TRIES = 5
"""A run that is under way has its rows replaced: so often they are read again."""


@dataclass(frozen=True, eq=False)
class RunRows:
    """A run, and its rows."""

    participant: Participant
    step: RunStep
    complete: bool
    episodes: pa.Table
    """As `gpcjax.sweep.rows` has it, by episode."""
    corrections: pa.Table
    manifest: Mapping[str, Any]
    machine: str
    """The kind of machine that computed it."""
    is_cut: bool
    """Whether the limit of time ended its last episode, before the task did."""

    @property
    def whole(self) -> pa.Table:
        """The episodes that the task has ended: what a cut one returned is no return of an episode."""
        return self.episodes.slice(0, self.episodes.num_rows - self.is_cut)

    @property
    def counts(self) -> bool:
        """Whether it is in the numbers: complete, with a whole episode, of somebody who takes part or has done all."""
        some = self.complete and self.whole.num_rows > 0
        return some and self.participant.kept.state in (ACTIVE, COMPLETE)

    @property
    def seed(self) -> int:
        """Of its starts."""
        return self.participant.seed + self.step.repetition


@dataclass(frozen=True, eq=False)
class Held:
    """All of it."""

    out: Path
    study: Study
    people: tuple[Participant, ...]
    runs: tuple[RunRows, ...]
    events: Mapping[int, tuple[dict[str, Any], ...]] = field(repr=False)
    """Of the log of each participant, by number."""

    def counted(self, number: int, event: str) -> int:
        """How often something is in the log of one of them."""
        return Counter(each["event"] for each in self.events[number])[event]


def read_held(out: Path, say: Say) -> Held:
    """What a study's folder holds, while it may be going on.

    Args:
        out: the folder.
        say: takes a line about what cannot be read, and is left out.

    Raises:
        UserError: there is no study, or what is kept of a participant is damaged.
    """
    study = read_folder(out)
    people = tuple(read_people(out, study))
    runs = tuple(run for one in people for run in _runs(one, say))
    return Held(out, study, people, runs, {one.kept.number: _events(one) for one in people})


def _runs(one: Participant, say: Say) -> Iterator[RunRows]:
    for place, step in enumerate(one.steps):
        if step.kind != "run" or step.run is None or place > one.kept.step:
            continue
        folder = one.run_folder(step.run)
        if not (folder / MANIFEST).exists():
            continue
        rows = _rows(folder, say)
        if rows is not None:
            yield RunRows(one, step.run, place < one.kept.step, *rows, _is_cut(folder / RECORD))


def _rows(folder: Path, say: Say) -> tuple[pa.Table, pa.Table, dict[str, Any], str] | None:
    """The rows of a run that may be under way; None, with a line, if they are not whole."""
    reason = "its rows are not whole"
    for _ in range(TRIES):
        found = Found()
        try:
            manifest = read_manifest(folder)
            parts = list(whole_parts(folder, manifest, found, {EPISODES: None, CORRECTIONS: None}))
        except UserError as error:
            reason = str(error)
            continue
        if len(parts) == 1 and not found.damaged:
            (part,) = parts
            machine = "" if part.origin is None else part.origin.machine
            return part.tables[EPISODES], part.tables[CORRECTIONS], manifest, machine
    say(f"{folder}: left out, {reason}; gpcjax replay says what of it can be made again")
    return None


def _is_cut(record: Path) -> bool:
    """Whether the last episode of a recording was ended by the limit of time, as its last lines say."""
    try:
        with open(record, "rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL))
            lines = file.read().splitlines()
    except OSError:
        return False
    for line in reversed(lines):
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if isinstance(event, dict) and event.get("event") == "note" and "ended" in event.get("values", {}):
            return event["values"]["ended"] == "time"
    return False


def _events(one: Participant) -> tuple[dict[str, Any], ...]:
    """The lines of a log; the last one may be half written."""
    try:
        lines = (one.folder / LOG).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ()
    found = []
    for line in lines:
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if isinstance(event, dict) and isinstance(event.get("event"), str):
            found.append(event)
    return tuple(found)
