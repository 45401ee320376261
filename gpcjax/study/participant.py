"""One participant on disk: where he or she is in the steps, and what was answered. Standard library only.

participant.json is replaced as a whole at each change, so that a crash leaves the state before or after it; log.jsonl
is appended to. Nothing of a person is kept but the code.
"""

import copy
import functools
import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ParamSpec

from gpcjax.errors import UserError
from gpcjax.study.design import base_seed
from gpcjax.study.kept import ACTIVE, COMPLETE, ENDED, Kept
from gpcjax.study.questions import answers_of
from gpcjax.study.spec import Study, is_code
from gpcjax.study.steps import RunStep, Step, letters_of, steps_of
from gpcjax.sweep.atomic import write_atomic

FORMAT = 1
SEAL_TRIES, SEAL_APART = 50, 0.1
"""How often a participant's files are looked through where one of them vanishes meanwhile; seconds between."""

CARD, LOG, RUNS, TRIALS = "participant.json", "log.jsonl", "runs", "trials"

P = ParamSpec("P")


def _whole(change: Callable[P, None]) -> Callable[P, None]:
    """A change of a participant that could not be written has not happened: nobody is shown what is not saved."""

    @functools.wraps(change)
    def changed(*given: P.args, **named: P.kwargs) -> None:
        one: Any = given[0]
        before = copy.deepcopy(one.kept)
        try:
            change(*given, **named)
        except BaseException:
            one.kept = before
            raise

    return changed


class Participant:
    """One of them. Changes are on the disk when a method returns; they belong to one thread at a time.

    Args:
        folder: participants/pNNNN.
        study: what he or she takes part in.
        kept: what participant.json says.
    """

    def __init__(self, folder: Path, study: Study, kept: Kept):
        self.folder, self.study, self.kept = folder, study, kept
        self.cell = study.slots[kept.slot]
        self.letters = letters_of(self.cell)
        self.steps = steps_of(study, self.cell)
        self.seed = base_seed(study.seed, kept.number)

    @classmethod
    def new(cls, parent: Path, study: Study, number: int, slot: int, code: str) -> "Participant":
        """Makes the folder of a new one. Raises OSError."""
        folder = parent / f"p{number:04}"
        folder.mkdir(parents=True)
        made = cls(folder, study, Kept(number, code, slot, begun=now(), seen=now()))
        made._begin_step()
        made.log("joined")
        return made

    @classmethod
    def read(cls, folder: Path, study: Study) -> "Participant":
        """The one of a folder.

        Raises:
            UserError: what it says is damaged, or of another study.
        """
        path = folder / CARD
        try:
            content = json.loads(path.read_bytes())
            fields = {name: content[name] for name in Kept.__dataclass_fields__}
            kept = Kept(**fields)
            known = content["format"] == FORMAT and kept.state in (ACTIVE, *ENDED) and is_code(kept.code)
            if known and 0 <= kept.slot < len(study.slots) and folder.name == f"p{kept.number:04}":
                found = cls(folder, study, kept)
                if 0 <= kept.step <= len(found.steps):
                    return found
        except OSError as error:
            raise UserError(
                f"{path}: cannot be read ({error.strerror}), put it back or take the folder away"
            ) from None
        except (ValueError, RecursionError, KeyError, TypeError):
            pass
        raise UserError(f"{path}: it is damaged, or of another version: put it back or take the folder away")

    @property
    def code(self) -> str:
        """His or her own."""
        return self.kept.code

    @property
    def step(self) -> Step | None:
        """The present step; None at the end."""
        active = self.kept.state == ACTIVE and self.kept.step < len(self.steps)
        return self.steps[self.kept.step] if active else None

    @property
    def arm(self) -> str:
        """The arm, where that is the same for all runs; else "all"."""
        return self.cell.arm or "all"

    @property
    def has_slot(self) -> bool:
        """Whether nobody else may have the slot."""
        return self.kept.state in (ACTIVE, COMPLETE)

    def run_folder(self, run: RunStep) -> Path:
        """Where a run is kept."""
        return self.folder / RUNS / run.folder

    def trial_folder(self) -> Path:
        """Where the present attempt at the trial is kept."""
        return self.folder / TRIALS / str(len(self.kept.trials) + 1)

    # --- changes

    @_whole
    def advance(self, kind: str) -> None:
        """Ends the present step, which is of this kind, and begins the next one; after the last all is complete.

        Raises:
            UserError: it is at another step.
        """
        self._at(kind)
        self.kept.times[-1]["ended"] = now()
        self.kept.step += 1
        if self.kept.step == len(self.steps):
            self.end(COMPLETE)
        else:
            self._begin_step()

    @_whole
    def checked(self, measured: Mapping[str, float], passed: bool) -> None:
        """Keeps what was measured of the machine, and goes on if that is enough."""
        self._at("check")
        self.kept.checks.append({**measured, "passed": passed, "at": now()})
        if passed:
            self.advance("check")
        else:
            self.save()

    @_whole
    def attempted(self, passed: bool) -> None:
        """Keeps how an attempt at the trial ended; goes on if it was passed, ends it all if it was the last one."""
        self._at("trial")
        self.kept.trials.append(passed)
        trial = self.study.trial
        if passed:
            self.advance("trial")
        elif trial is not None and len(self.kept.trials) >= trial.attempts:
            self.end("failed", "the trial was not passed")
        else:
            self.save()

    @_whole
    def answered(self, values: Mapping[str, Any]) -> None:
        """Keeps the answers to the present questions, and goes on.

        Raises:
            UserError: something is no answer, or is missing; the message is for the participant.
        """
        step = self._at("questions")
        run = step.run
        for name, value in answers_of(step.questions, values).items():
            self.kept.answers.append(
                {
                    "question": name,
                    "run": run and run.folder,
                    "letter": run and run.letter,
                    "task": run and run.task,
                    "value": value,
                    "at": now(),
                }
            )
        self.advance("questions")

    @_whole
    def end(self, state: str, why: str = "") -> None:
        """Ends it all in this state."""
        if state == COMPLETE:
            self.seal()
        kept = self.kept
        kept.state, kept.why, kept.ended = state, why or ENDED[state], now()
        self.log("ended", state=state, why=kept.why)
        self.save()

    def touch(self) -> None:
        """Has done something just now."""
        self.kept.seen = now()

    def is_late(self) -> bool:
        """Whether he or she has been away for longer than the study allows."""
        away = time.time() - datetime.fromisoformat(self.kept.seen).timestamp()
        return self.kept.state == ACTIVE and away > 3600 * self.study.joining.hours

    def save(self) -> None:
        """Has participant.json as it is now on the disk. Raises OSError."""
        self.touch()
        content = {
            "format": FORMAT,
            **asdict(self.kept),
            "seed": self.seed,
            "arm": self.arm,
            "letters": {letter: treatment._asdict() for letter, treatment in self.letters.items()},
            "tasks": list(self.cell.tasks),
            "steps": [step.name for step in self.steps],
        }
        write_atomic(self.folder / CARD, json.dumps(content, indent=1, ensure_ascii=False) + "\n")

    def seal(self) -> None:
        """Has every file of this participant on the disk, also those that a lesson wrote. Raises OSError.

        A lesson that has just ended may still be putting a policy in place of its earlier one: then once more.
        """
        for again in range(SEAL_TRIES, -1, -1):
            try:
                for path in [*self.folder.rglob("*"), self.folder]:
                    _synchronise(path)
                return
            except FileNotFoundError:
                if not again or not self.folder.is_dir():
                    raise
                time.sleep(SEAL_APART)

    def log(self, event: str, **values: Any) -> None:
        """Appends what happened. Raises OSError."""
        line = json.dumps({"at": now(), "event": event, **values}, ensure_ascii=False) + "\n"
        with open(self.folder / LOG, "ab") as file:
            file.write(line.encode())
            file.flush()
            os.fsync(file.fileno())

    def _begin_step(self) -> None:
        self.kept.times.append({"step": self.steps[self.kept.step].name, "began": now(), "ended": ""})
        self.save()

    def _at(self, kind: str) -> Step:
        step = self.step
        if step is None or step.kind != kind:
            raise UserError(f"{self.code}: not at this step now")
        return step


def _synchronise(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def now() -> str:
    """The time, as it is kept."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
