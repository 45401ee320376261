"""What participants answered, over participants: scales by learner, choices, free texts. Loads no jax."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gpcjax.report.compare_numbers import better_paired
from gpcjax.report.statistics import Interval, Scores, mean_interval, paired_difference, student_p
from gpcjax.study.design import Treatment
from gpcjax.study.kept import ACTIVE, COMPLETE
from gpcjax.study.participant import Participant
from gpcjax.study.questions import Question
from gpcjax.study.report.held import Held
from gpcjax.study.report.numbers import Difference, corrected

Key = tuple[str | None, Treatment | None]
"""Task and treatment that an answer is about; None for one about all."""


@dataclass(frozen=True, eq=False)
class Scale:
    """The answers on a scale about one thing."""

    question: Question
    about: Key
    counts: tuple[int, ...]
    """Of each point, from 1."""
    scores: Scores
    """Of each participant the mean answer."""

    @property
    def mean(self) -> Interval:
        """Over participants."""
        return mean_interval(self.scores.values[:, None])


@dataclass(frozen=True)
class Choice:
    """How often each option was chosen."""

    question: Question
    about: Key
    counts: Mapping[str, int]
    """A letter counts as whom it stands for."""


@dataclass(frozen=True)
class Text:
    """A free text."""

    question: Question
    about: Key
    participant: int
    text: str


@dataclass(frozen=True, eq=False)
class Asked:
    """All of it."""

    scales: tuple[Scale, ...]
    choices: tuple[Choice, ...]
    texts: tuple[Text, ...]
    differences: tuple[Difference, ...]
    """Of scales about learners, each pair of learners of the same task and question, whose name is the statistic."""


def asked_of(held: Held, name_of: Mapping[Treatment, str]) -> Asked:
    """Of a study; who has dropped out does not count.

    Args:
        held: the study.
        name_of: what a treatment is called where a choice means it.
    """
    people = [one for one in held.people if one.kept.state in (ACTIVE, COMPLETE)]
    scales, choices, texts = [], [], []
    for question in held.study.questions:
        answers = [
            (one, _about(one, answer), answer["value"])
            for one in people
            for answer in one.kept.answers
            if answer["question"] == question.name and answer["value"] is not None
        ]
        abouts = sorted(
            dict.fromkeys(about for _, about, _ in answers), key=lambda about: _place(held, about)
        )
        for about in abouts:
            own = [(one, value) for one, each, value in answers if each == about]
            match question.kind:
                case "scale":
                    scales.append(_scale(question, about, own))
                case "choice":
                    choices.append(_choice(question, about, own, name_of))
                case _:
                    texts += [Text(question, about, one.kept.number, value) for one, value in own]
    return Asked(tuple(scales), tuple(choices), tuple(texts), tuple(_differences(scales)))


def _about(one: Participant, answer: Mapping[str, str]) -> Key:
    if answer["run"] is None:
        return None, None
    return answer["task"], one.letters[answer["letter"]]


def _place(held: Held, about: Key) -> tuple[int, ...]:
    task, treatment = about
    if task is None or treatment is None:
        return (-1,)
    arms = [arm.name for arm in held.study.arms]
    arm = held.study.arm(treatment.arm)
    return held.study.tasks.index(task), arms.index(arm.name), arm.learners.index(treatment.learner)


def _scale(question: Question, about: Key, answers: Sequence[tuple[Participant, int]]) -> Scale:
    counts = Counter(value for _, value in answers)
    by: dict[int, list[int]] = {}
    for one, value in answers:
        by.setdefault(one.kept.number, []).append(value)
    numbers = sorted(by)
    scores = Scores(np.array(numbers, np.int64), np.array([np.mean(by[one]) for one in numbers], np.float64))
    return Scale(question, about, tuple(counts[point] for point in range(1, question.points + 1)), scores)


def _choice(
    question: Question,
    about: Key,
    answers: Sequence[tuple[Participant, str]],
    name_of: Mapping[Treatment, str],
) -> Choice:
    counts = Counter(name_of[one.letters[value]] if value in one.letters else value for one, value in answers)
    meant = {
        (letter, name_of[treatment])
        for one, _ in answers
        for letter, treatment in one.letters.items()
        if letter in question.options
    }
    letters = {letter for letter, _ in meant}
    shown = [
        *sorted({name for _, name in meant}),
        *(each for each in question.options if each not in letters),
    ]
    return Choice(question, about, {option: counts[option] for option in shown})


def _differences(scales: Sequence[Scale]) -> list[Difference]:
    made = []
    for one, other in itertools.combinations(scales, 2):
        (task, first), (its, second) = one.about, other.about
        if (
            one.question is not other.question
            or task != its
            or first is None
            or second is None
            or task is None
        ):
            continue
        difference, pairs = paired_difference(one.scores, other.scores)
        if not pairs:
            continue
        _, mine, theirs = np.intersect1d(one.scores.seeds, other.scores.seeds, return_indices=True)
        a, b = one.scores.values[mine], other.scores.values[theirs]
        made.append(
            Difference(
                task,
                first,
                second,
                one.question.name,
                difference,
                student_p(a - b),
                pairs,
                True,
                better_paired(a, b),
            )
        )
    return corrected(made)
