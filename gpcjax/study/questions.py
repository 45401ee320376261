"""Questions to participants: scales, choices, free text; and what an answer may be. Standard library only."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gpcjax.allowed import Anything, Numbers, OneOf, checked, shown
from gpcjax.errors import UserError
from gpcjax.study.tables import Table, once

WHEN = ("run", "learner", "end")
"""After each recorded run, after the last run of each learner on a task, after all."""
KINDS = ("scale", "choice", "text")
LONGEST_ANSWER = 2000
_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


@dataclass(frozen=True)
class Question:
    """One question."""

    name: str
    """Its column in the answers."""
    text: str
    kind: str
    when: str
    needed: bool
    points: int = 0
    """Of a scale: 1 to this."""
    labels: tuple[str, ...] = ()
    """Of a scale's ends."""
    options: tuple[str, ...] = ()
    """Of a choice."""

    def accept(self, value: Any) -> int | str | None:
        """An answer as it is kept; None where it was left out.

        Raises:
            UserError: it is no answer to this question, or one is needed.
        """
        if value is None or value == "":
            if self.needed:
                raise UserError(f"{self.name}: an answer is needed")
            return None
        match self.kind:
            case "scale":
                return checked(self.name, value, int, Numbers(1, self.points, whole=True))
            case "choice":
                return checked(self.name, value, str, OneOf(self.options))
        text = checked(self.name, value, str, Anything("a text")).strip()
        if len(text) > LONGEST_ANSWER:
            raise UserError(f"{self.name}: give at most {LONGEST_ANSWER:,} letters")
        return text or self.accept(None)

    def shown(self) -> dict[str, Any]:
        """As the page has it."""
        return {
            "name": self.name,
            "text": self.text,
            "kind": self.kind,
            "needed": self.needed,
            "points": self.points,
            "labels": list(self.labels),
            "options": list(self.options),
            "longest": LONGEST_ANSWER,
        }


def question_of(table: Table) -> Question:
    """The question of one table [[questions]]. Raises UserError."""
    kind = table.take("kind", str, OneOf(KINDS))
    name = table.take("name", str)
    if not _NAME.fullmatch(name):
        raise UserError(
            f"{table.source('name')} {shown(name)}: give small letters, digits and _, a letter first"
        )
    points, labels, options = 0, (), ()
    if kind == "scale":
        points = table.take("points", int, Numbers(2, 11, whole=True), 7)
        labels = table.several("labels", least=2, default=("", ""))
        if len(labels) != 2:
            raise UserError(f"{table.source('labels')}: give two, of the lowest and of the highest point")
    if kind == "choice":
        options = table.several("options", least=2)
        once(options, table.source("options"))
    question = Question(
        name=name,
        text=table.take("text", str),
        kind=kind,
        when=table.take("when", str, OneOf(WHEN), "end"),
        needed=table.take("needed", bool, Anything("true or false"), kind != "text"),
        points=points,
        labels=labels,
        options=options,
    )
    table.done()
    return question


def answers_of(questions: tuple[Question, ...], given: Mapping[str, Any]) -> dict[str, int | str | None]:
    """The answers to these questions, checked.

    Raises:
        UserError: one is missing or none, or there is one to another question.
    """
    known = {question.name for question in questions}
    for name in given:
        if name not in known:
            raise UserError(f"{shown(name)} is no question here")
    return {question.name: question.accept(given.get(question.name)) for question in questions}
