"""All participants of a study's folder: who comes in, who has which slot, who is deleted. Standard library only."""

import difflib
import json
import re
import shutil
from pathlib import Path

from gpcjax.errors import UserError
from gpcjax.study.design import free_slot
from gpcjax.study.participant import CARD, Participant
from gpcjax.study.reading import read_study
from gpcjax.study.spec import CODE_WORDS, Study, is_code
from gpcjax.sweep.atomic import write_atomic

SPEC, PEOPLE, NUMBERS, TOKEN = "study.toml", "participants", "numbers.json", "token"

ANALYSIS = "analysis"
"""The folder of everything that is made of participants' data: rows, figures, a report. Deleted with each of them."""

_GOING = ".deleted-"
"""Begins the name of a participant's folder while it is removed."""

_FOLDER = re.compile(r"p[0-9]{4}")


class Refused(UserError):
    """Somebody who cannot take part; the message is for that person."""


class Register:
    """The participants of one folder. One process at a time has it (`gpcjax.sweep.lock.held`).

    Raises:
        UserError: what is kept of one is damaged.
    """

    def __init__(self, out: Path, study: Study):
        self.out, self.study = out, study
        for left in (out / PEOPLE).glob(f"{_GOING}*"):  # of a crash while it was deleted
            shutil.rmtree(left)
        self._by_code = {each.code: each for each in read_people(out, study)}

    def __iter__(self):
        return iter(sorted(self._by_code.values(), key=lambda each: each.kept.number))

    def get(self, code: str) -> Participant | None:
        """The participant with this code."""
        return self._by_code.get(code)

    @property
    def free(self) -> int:
        """Slots that nobody has."""
        return len(self.study.slots) - sum(each.has_slot for each in self._by_code.values())

    def expire(self) -> list[Participant]:
        """Ends those who have not come back in time; gives them."""
        late = [each for each in self._by_code.values() if each.is_late()]
        for each in late:
            each.end("expired")
        return late

    def check(self, code: str) -> None:
        """That a code may come in.

        Raises:
            Refused: it is none, or is not admitted.
        """
        codes = self.study.joining.codes
        if not is_code(code):
            raise Refused(f"This is no code: it has {CODE_WORDS}.")
        if codes is not None and code not in codes:
            raise Refused("This code is not known here. Please look whether it is typed right.")

    def admit(self, code: str) -> Participant:
        """A new participant with this code, with the first free slot.

        Raises:
            Refused: the code is none, is not admitted, or all slots are taken.
            UserError: what is written down of numbers is damaged.
            OSError: nothing can be written.
        """
        self.check(code)
        self.expire()
        slot = free_slot(
            len(self.study.slots), (each.kept.slot for each in self._by_code.values() if each.has_slot)
        )
        if slot is None:
            raise Refused("All places of this study are taken. Thank you for your interest.")
        number = self._next_number()
        made = Participant.new(self.out / PEOPLE, self.study, number, slot, code)
        self._by_code[code] = made
        return made

    def delete(self, code: str) -> list[str]:
        """Removes everything of a participant, and all that was made of the data of several; gives what it was.

        Raises:
            UserError: nobody has this code.
            OSError: something cannot be removed.
        """
        found = self._by_code.get(code)
        if found is None:
            raise UserError(
                f"{self.out}: nobody has the code {code!r} there, see gpcjax study status {self.out}"
            )
        going = found.folder.with_name(f"{_GOING}{found.folder.name}")
        if found.folder.exists() or not going.exists():  # which it is where an earlier try came no further
            found.folder.rename(going)
        removed = [f"{found.folder} ({_count(going)} files)"]
        shutil.rmtree(going)
        analysis = self.out / ANALYSIS
        if analysis.exists():
            removed.append(f"{analysis} ({_count(analysis)} files), which held what was made of the data")
            shutil.rmtree(analysis)
        del self._by_code[code]
        return removed

    def kept_number(self) -> int:
        """The first number that nobody has had, as far as that is written down.

        Raises:
            UserError: what is written down is damaged.
            OSError: it cannot be read.
        """
        path = self.out / NUMBERS
        if not path.exists():
            return 1
        try:
            match json.loads(path.read_bytes()):
                case {"next": int(number)} if type(number) is int and number > 0:
                    return number
        except (ValueError, RecursionError):
            pass
        raise UserError(
            f'{path}: it is damaged, write {{"next": NUMBER}} there, above the numbers of all who ever took part'
        )

    def _next_number(self) -> int:
        """One that nobody has had: not even somebody who was deleted, as seeds follow from it."""
        number = max([self.kept_number(), *(each.kept.number + 1 for each in self._by_code.values())])
        write_atomic(self.out / NUMBERS, json.dumps({"next": number + 1}) + "\n")
        return number


def read_people(out: Path, study: Study) -> list[Participant]:
    """The participants of a folder, by number.

    Raises:
        UserError: what is kept of one is damaged.
    """
    parent = out / PEOPLE
    names = sorted(path.name for path in parent.iterdir()) if parent.is_dir() else []
    folders = [parent / name for name in names if _FOLDER.fullmatch(name)]
    # One without a card was being made by a process that was killed.
    return [Participant.read(folder, study) for folder in folders if (folder / CARD).exists()]


def read_folder(out: Path) -> Study:
    """The study of a folder. Raises UserError: there is none."""
    if not (out / SPEC).is_file():
        raise UserError(f"{out}: no study is kept there, give a folder of gpcjax study")
    return read_study(out / SPEC)


def open_folder(out: Path, spec: Path | None) -> Study:
    """The study of a folder, which is made where there is none, with a copy of the specification.

    Raises:
        UserError: the specification has mistakes, the folder holds another one or something else, or cannot be written.
    """
    if spec is None:
        return read_folder(out)
    study = read_study(spec)
    content, path = spec.read_bytes(), out / SPEC
    if path.exists():
        if path.read_bytes() != content:
            raise UserError(
                f"{spec}: {out} keeps another study ({_difference(path, spec)}), give a new folder (--out)"
            )
        return study
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(f"{out}: it holds something else, give a new folder (--out)")
    try:
        (out / PEOPLE).mkdir(parents=True)
        write_atomic(path, content)
    except OSError as error:
        raise UserError(
            f"{out}: nothing can be written there ({error.strerror}), give a new folder"
        ) from None
    return study


def new_folder(spec: Path) -> Path:
    """A folder that does not exist yet: runs/study-NAME-NUMBER."""
    stem = (
        re.sub(r"[^A-Za-z0-9_.-]+", "-", spec.stem.removeprefix("study_").removeprefix("study-")) or "study"
    )
    return next(
        path
        for number in range(1, 1_000_000)
        if not (path := Path("runs") / f"study-{stem}-{number}").exists()
    )


def _difference(there: Path, here: Path) -> str:
    """The first line in which two files differ."""
    old, new = (path.read_text(errors="replace").splitlines() for path in (there, here))
    for line in difflib.unified_diff(old, new, n=0, lineterm=""):
        if line[:1] in "+-" and line[:3] not in ("+++", "---"):
            side = "it alone has" if line[0] == "-" else "it lacks"
            return f"{side} {line[1:].strip()!r}"
    return "in the ends of lines"


def _count(folder: Path) -> int:
    return sum(1 for path in folder.rglob("*") if path.is_file())
