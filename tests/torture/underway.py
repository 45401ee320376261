"""Faults injected into the checkpoints of a sweep that was killed: is what is damaged ever gone on with?

    python -m tests.torture.underway OUT [--cases 1000] [--seed 0]

OUT is the folder of a sweep that was killed in the middle of its runs. Each case copies it, spoils its checkpoints in
one to three ways, and asks where runs can go on, as a sweep does. Right is: whatever is offered is to the bit what was
saved of that run; what is damaged is set aside with one line; what is somebody else's stays as it is.
"""

import argparse
import collections
import contextlib
import json
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpcjax.policies.folder import CARD, SUMS, _names, _sum, read_arrays, read_card
from gpcjax.sweep.checkpoints import HERE, KIND, runs_of, survey
from gpcjax.sweep.layout import CHECKPOINTS, DAMAGED
from gpcjax.sweep.plan import Cell
from tests.torture.faults import EDITS

AGREE = ("versions", "machine", "keeping")


@dataclass
class Case:
    """A copy of the folder, while it is spoiled."""

    out: Path
    random: np.random.Generator

    def pick(self, items):
        return items[int(self.random.integers(len(items)))]

    def folder(self) -> Path:
        """A checkpoint, where there is one left."""
        folders = sorted(path for path in (self.out / CHECKPOINTS).iterdir() if path.name[0].isdigit())
        return self.pick(folders) if folders else self.out / CHECKPOINTS

    def file(self) -> Path:
        """A file of one, where there is one left."""
        files = sorted(path for path in self.folder().rglob("*") if path.is_file())
        return self.pick(files) if files else self.out / "none"


def _edited(name: str) -> Callable[[Case], None]:
    def spoil(case: Case) -> None:
        path = case.file()
        if path.is_file():
            path.write_bytes(EDITS[name](case, bytearray(path.read_bytes())))

    return spoil


def _swapped(case: Case) -> None:
    """Two files, of one checkpoint or of two: cards, arrays, sums."""
    one, two = case.file(), case.file()
    if one.is_file() and two.is_file():
        content = one.read_bytes()
        one.write_bytes(two.read_bytes())
        two.write_bytes(content)


def _part_of_another(name: str) -> Callable[[Case], None]:
    def spoil(case: Case) -> None:
        one, two = case.folder() / name, case.folder() / name
        if one.exists() and two.exists() and one != two:
            with tempfile.TemporaryDirectory(dir=case.out) as between:
                one.rename(Path(between, "it"))
                two.rename(one)
                Path(between, "it").rename(two)

    return spoil


def _resealed(edit: Callable[[Case, dict], None]) -> Callable[[Case], None]:
    """A card that says something else, with sums that are right."""

    def spoil(case: Case) -> None:
        folder = case.folder()
        with contextlib.suppress(Exception):  # it may be spoiled already
            card = json.loads((folder / CARD).read_text())
            edit(case, card)
            (folder / CARD).write_text(json.dumps(card))
            sums = "".join(f"{_sum(folder / name)}  {name}\n" for name in _names(folder))
            (folder / SUMS).write_text(sums)

    return spoil


def _other_version(case: Case, card: dict) -> None:
    card["versions"] = card["versions"] | {"jax": "99.0"}


def _without(case: Case, card: dict) -> None:
    del card[case.pick(sorted(card))]


def _odd(case: Case, card: dict) -> None:
    card[case.pick(sorted(card))] = case.pick([None, 7, "text", [], {}, [[["deep"]]], True])


def _delete(case: Case) -> None:
    case.file().unlink(missing_ok=True)


def _folder_in_place(case: Case) -> None:
    path = case.file()
    if path.is_file():
        path.unlink()
        path.mkdir()


def _renamed(case: Case) -> None:
    path = case.folder()
    if path.name != CHECKPOINTS:
        path.rename(path.with_name(f"{1 + int(path.name.partition('-')[0])}-7-7"))


def _copied(case: Case) -> None:
    path = case.folder()
    target = (
        path.with_name(f"{1 + int(path.name.partition('-')[0])}-8-8") if path.name != CHECKPOINTS else path
    )
    if not target.exists():
        shutil.copytree(path, target)


def _foreign(case: Case) -> None:
    folder = case.out / CHECKPOINTS / case.pick(["mine", "old", "notes-1-2"])
    folder.mkdir(exist_ok=True)
    (folder / "text").write_text("mine")


def _empty(case: Case) -> None:
    (case.out / CHECKPOINTS / "1795690957943205000-7-9").mkdir(exist_ok=True)


FAULTS: dict[str, Callable[[Case], None]] = {
    **{f"a file: {name}": _edited(name) for name in EDITS},
    "a file deleted": _delete,
    "a folder in a file's place": _folder_in_place,
    "two files swapped": _swapped,
    "cards swapped": _part_of_another(CARD),
    "arrays swapped": _part_of_another("arrays"),
    "sums swapped": _part_of_another(SUMS),
    "of another version": _resealed(_other_version),
    "a key of the card is gone": _resealed(_without),
    "a value of the card is odd": _resealed(_odd),
    "renamed": _renamed,
    "copied": _copied,
    "somebody else's": _foreign,
    "an empty folder": _empty,
}

Saved = dict[Cell, list[dict[str, bytes]]]
"""What was saved of each run, in each of the checkpoints: all arrays of its checkpoint, as they lie there."""


def saved_in(out: Path) -> tuple[Saved, dict]:
    """What the checkpoints of a whole folder hold, and what their runs must agree in."""
    found: Saved = collections.defaultdict(list)
    agree: dict = {}
    for folder in (out / CHECKPOINTS).iterdir():
        card = read_card(folder, KIND)
        agree = {name: card[name] for name in AGREE}
        for cell, _ in runs_of(card):
            found[cell].append(_content(folder))
    return found, agree


def _content(folder: Path) -> dict[str, bytes]:
    arrays = read_arrays(folder, read_card(folder, KIND), KIND)
    return {name: value.tobytes() for name, value in arrays.items()}


def judge(case: Case, saved: Saved, agree: dict) -> str:
    """What became of spoiled checkpoints, in a word.

    Raises:
        AssertionError: it was not right.
    """
    lines: list[str] = []
    places = survey(case.out, saved.__contains__, agree, lines.append).get(HERE, {})
    for cell, place in places.items():
        folder = case.out / CHECKPOINTS / place.folder
        try:
            content = _content(folder)
        except (ValueError, KeyError):  # as a worker, which begins the run anew with a line
            continue
        assert content in saved[cell], f"{cell} would go on from what was never saved"
        assert runs_of(read_card(folder, KIND))[place.index][0] == cell
    assert len(lines) <= 1 and all("set aside" in line and "\n" not in line for line in lines), lines
    aside = case.out / DAMAGED / CHECKPOINTS
    assert bool(lines) == (aside.is_dir() and bool(list(aside.iterdir())))
    for text in (case.out / CHECKPOINTS).glob("*/text"):
        assert text.read_text() == "mine"
    return "goes on" if len(places) == len(saved) else "begins anew"


def torture(out: Path, cases: int, seed: int) -> Iterator[tuple[str, str | None, str]]:
    """The names of the faults of each case, what became of it (None: it was not right), and why."""
    saved, agree = saved_in(out)
    names = list(FAULTS)
    with tempfile.TemporaryDirectory() as scratch:
        for number in range(cases):
            case = Case(Path(scratch, "case"), np.random.default_rng([seed, number]))
            shutil.copytree(out, case.out)
            chosen = [names[number % len(names)]]
            if number >= len(names):  # every fault alone first, then some at once
                chosen += [names[i] for i in case.random.integers(0, len(names), case.random.integers(3))]
            try:
                for name in chosen:
                    FAULTS[name](case)
                yield f"{number}: {'; '.join(chosen)}", judge(case, saved, agree), ""
            except Exception:
                yield f"{number}: {'; '.join(chosen)}", None, traceback.format_exc()
            shutil.rmtree(case.out)


def main() -> int:
    """Says how many cases became what, and prints those that were not right."""
    parser = argparse.ArgumentParser(description="Spoil the checkpoints of a killed sweep.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    counts = collections.Counter()
    for name, status, why in torture(arguments.out, arguments.cases, arguments.seed):
        counts[status or "WRONG"] += 1
        if status is None:
            print(f"{name}\n{why}")
    print(", ".join(f"{count} {status}" for status, count in counts.most_common()))
    return 1 if counts["WRONG"] else 0


if __name__ == "__main__":
    sys.exit(main())
