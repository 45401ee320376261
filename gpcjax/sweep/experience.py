"""What programs took on this machine, from one sweep to the next: better than any table. Loads no jax.

A small file beside the compiled programs, which it belongs to: what was compiled before comes from there. It is for
guesses of time alone; where it cannot be read or written, the guesses are those of `gpcjax.sweep.costs`.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.crowd import USUAL_START
from gpcjax.sweep.plan import Program

FILE = "seconds.json"
_MOST_SECONDS = 1e10

MOST = 2000
"""Programs that are remembered: the last ones."""

FROM_CACHE = 0.07
"""Part of the seconds of compiling that it takes once it is kept: 1.4 of 20, 0.2 of 2.8 s were seen."""

FROM_TEXT = 0.25
"""The same of those of a program that was traced anew, and then found by its text: 0.8 of 3.8 s were seen."""

COMPILED_FROM = 0.8
"""Seconds that a program takes at least if it is compiled, and not found by its text."""

START = "start"
"""The entry for the seconds of a core until a worker is there."""

LEAST_DONE = 0.5
"""Of a program's steps, to be remembered: the first episodes of runs are shorter than the later ones, or longer."""


class Cost(NamedTuple):
    """Seconds of one core."""

    episode: float
    """Of an episode, the mean over a run."""
    compiling: float
    """Until a worker has its programs; from the cache, where they are once they were compiled."""
    cells: int
    """That these were seen of."""
    workers: int
    """That were at it."""
    tiers: int = 1
    """That were compiled: what gets farther is compiled anew."""


def of(programs: Iterable[Program], folder: Path | None) -> dict[Program, Cost]:
    """What is known of these programs; `folder` is where compiled ones are kept, or None."""
    entries = _read(folder)
    return {program: Cost(*entries[key]) for program in programs if (key := _key(program)) in entries}


def start_of(folder: Path | None) -> float:
    """Seconds until workers are there: they import, which takes longer than to say so."""
    return _read(folder).get(START, [USUAL_START])[0]


def learn(costs: Mapping[Program, Cost], folder: Path | None, started: float | None = None) -> None:
    """Remembers what programs took, and workers until they were there. Says nothing where that is not possible."""
    if folder is None or not costs:
        return
    entries = _read(folder)
    if started is not None:
        entries[START] = [(entries.pop(START, [started])[0] + started) / 2, 0.0, 1, 1, 1]
    for program, cost in costs.items():
        entries.pop(_key(program), None)
        entries[_key(program)] = list(cost)  # last, as the newest
    newest = dict(list(entries.items())[-MOST:])
    with suppress(OSError, ValueError):
        write_atomic(folder / FILE, json.dumps(newest))


def _key(program: Program) -> str:
    return hashlib.sha256(repr(tuple(program)).encode()).hexdigest()[:16]


def _read(folder: Path | None) -> dict[str, Any]:
    if folder is None:
        return {}
    try:
        entries = json.loads((folder / FILE).read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return (
        {key: value for key, value in entries.items() if _is_cost(value)} if isinstance(entries, dict) else {}
    )


def _is_cost(value: object) -> bool:
    """Whether it may be a `Cost`: none of it is endless, and there are seconds, cells and workers."""
    return (
        isinstance(value, list)
        and len(value) == len(Cost._fields)
        and all(type(each) in (int, float) and 0 <= each < _MOST_SECONDS for each in value)
        and value[0] > 0
        and all(type(each) is int and each >= 1 for each in value[2:])
    )
