"""What a participant does, one step after the other, as the study and his or her cell say. Standard library only."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gpcjax.study.design import LETTERS, Cell, Treatment
from gpcjax.study.questions import Question

if TYPE_CHECKING:
    from gpcjax.study.spec import Study

DUMMY, RECORDED = "dummy", "recorded"


@dataclass(frozen=True)
class RunStep:
    """A run: one learner, blind, on one task."""

    number: int
    """From 1, of all runs of this participant."""
    phase: str
    """DUMMY or RECORDED."""
    letter: str
    treatment: Treatment
    task: str
    repetition: int
    """From 1, of this learner on this task, dummy runs first: what makes the run's seed."""

    @property
    def folder(self) -> str:
        """The name of its folder."""
        task = re.sub(r"[^A-Za-z0-9_.]+", "-", self.task)
        return f"{self.number:02}-{self.phase}-{self.letter}-{task}"


@dataclass(frozen=True)
class Step:
    """One step. `run` is there for runs, `questions` for questions."""

    kind: str
    """consent, check, instructions, trial, run, questions."""
    name: str
    """Its own in this participant's steps."""
    run: RunStep | None = None
    """Of questions, the run that they are about; None: about all."""
    questions: tuple[Question, ...] = ()


def letters_of(cell: Cell) -> dict[str, Treatment]:
    """What is behind each letter: A is whom this participant meets first."""
    return dict(zip(LETTERS, cell.treatments, strict=False))


def steps_of(study: "Study", cell: Cell) -> tuple[Step, ...]:
    """All steps of a participant with this cell."""
    return tuple(_steps(study, cell))


def _steps(study: "Study", cell: Cell) -> Iterator[Step]:
    yield Step("consent", "consent")
    yield Step("check", "check")
    yield Step("instructions", "instructions")
    if study.trial is not None:
        yield Step("trial", "trial")
    letters, number = letters_of(cell), 0
    blocks = [(letter, task) for task in cell.tasks for letter in letters]
    if study.outer == "learners":
        blocks = [(letter, task) for letter in letters for task in cell.tasks]
    phases = [DUMMY] * study.runs.dummy + [RECORDED] * study.runs.recorded
    asked = {
        when: tuple(each for each in study.questions if each.when == when)
        for when in ("run", "learner", "end")
    }
    for letter, task in blocks:
        for repetition, phase in enumerate(phases, 1):
            number += 1
            run = RunStep(number, phase, letter, letters[letter], task, repetition)
            yield Step("run", run.folder, run)
            after = asked["run"] if phase == RECORDED else ()
            if repetition == len(phases):
                after += asked["learner"]
            if after:
                yield Step("questions", f"questions-{run.folder}", run, after)
    if asked["end"]:
        yield Step("questions", "questions-end", None, asked["end"])
