"""What the report of a study says, as a document. Loads no jax."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

from gpcjax.report import words
from gpcjax.report.compare_page import p_shown
from gpcjax.report.document import (
    Block,
    Definitions,
    Document,
    Folded,
    Heading,
    Paragraph,
    Picture,
    Sheet,
    Warnings,
)
from gpcjax.report.statistics import RESAMPLES
from gpcjax.study.design import Treatment
from gpcjax.study.kept import ACTIVE, COMPLETE
from gpcjax.study.report.asked import Asked, Key
from gpcjax.study.report.held import Held
from gpcjax.study.report.naming import learners_of, names_of
from gpcjax.study.report.numbers import STATISTICS, Difference, Numbers
from gpcjax.study.report.stores import versions_differ
from gpcjax.study.report.who import WORDS, events, states
from gpcjax.study.steps import RECORDED
from gpcjax.sweep.sofar import FINAL_EPISODES

FEW = 10
"""Participants below which intervals say little of rare outcomes."""


def document(
    held: Held, numbers: Numbers, asked: Asked, pictures: Iterable[Picture], stores: Mapping[str, int]
) -> Document:
    """Who took part, results, answers, order, drop-outs, methods, files."""
    name_of = names_of(held)
    lines = list(_warnings(held, numbers))
    blocks: list[Block] = [
        Paragraph(_lead(held), lead=True),
        *([Warnings(tuple(lines))] if lines else []),
        Heading("Results"),
        *([] if numbers.taught else [Paragraph("No recorded run of anybody who counts is complete yet.")]),
        *_results(numbers, name_of),
        *pictures,
        *_differences("Differences", numbers.differences, name_of, STATISTICS),
        *_answers(asked, name_of),
        *_order(numbers),
        Heading("Who took part"),
        states(held),
        *events(held),
        Heading("How the numbers are made"),
        Definitions(_methods(held)),
        Heading("Files"),
        Definitions(_files(stores)),
    ]
    return Document(held.study.title, tuple(blocks))


def _lead(held: Held) -> str:
    study = held.study
    count = Counter(one.kept.state for one in held.people)
    recorded = sum(run.counts and run.step.phase == RECORDED for run in held.runs)
    parts = [
        f"{count[COMPLETE]} of {study.participants} participants complete",
        *([f"{count[ACTIVE]} under way"] if count[ACTIVE] else []),
        f"{recorded} recorded runs",
        words.listed([words.task(task) for task in study.tasks]),
        f"single-blind, {words.listed(learners_of(held))}",
        *([f"arms {words.listed([arm.name for arm in study.arms])}"] if len(study.arms) > 1 else []),
    ]
    return " · ".join(parts)


def _warnings(held: Held, numbers: Numbers) -> Iterator[str]:
    if any(one.kept.state == ACTIVE for one in held.people):
        yield "The study is not over: whoever looks at results before its end, and ends it by them, finds too much."
    if versions_differ(held):
        yield "Runs were taught with different versions of gpcjax or its libraries; each run's manifest names them."
    fewest = min((len(each.by_participant) for each in numbers.taught), default=FEW)
    if fewest < FEW:
        yield f"Fewer than {FEW} participants say little of rare outcomes, and so do their intervals."


def _results(numbers: Numbers, name_of: Mapping[Treatment, str]) -> Iterator[Block]:
    columns = ("task", "learner", "people", "runs", "area", "final return", "corrections")
    rows, breaks = [], set()
    for task in dict.fromkeys(each.task for each in numbers.taught):
        own = numbers.of(task)
        intervals = {name: [each.interval(name) for each in own] for name in STATISTICS}
        decimals = {name: words.places([each.estimate for each in of]) for name, of in intervals.items()}
        for place, each in enumerate(own):
            rows.append(
                (
                    words.task(task) if place == 0 else "",
                    name_of[each.treatment],
                    str(len(each.by_participant)),
                    str(each.runs),
                    *(words.interval(intervals[name][place], decimals[name]) for name in STATISTICS),
                )
            )
        breaks.add(len(rows) - 1)
    if rows:
        yield Sheet("", columns, tuple(rows), frozenset(breaks), WORDS)
        yield Paragraph(
            "Means over participants with 95% intervals. Area: mean return of an episode; final return: mean of the "
            f"last {FINAL_EPISODES} episodes, or of fewer where a run has fewer; corrections: in a run."
        )


def _differences(
    title: str, made: Sequence[Difference], name_of: Mapping[Treatment, str], statistics: Mapping[str, str]
) -> Iterator[Block]:
    if not made:
        return
    columns = (
        "task",
        "first",
        "second",
        "statistic",
        "difference",
        "p (Holm)",
        "P(higher)",
        "people",
    )
    rows = []
    for each in made:
        alike = [one for one in made if (one.statistic, one.task) == (each.statistic, each.task)]
        decimals = words.places([one.difference.estimate for one in alike])
        star = " **" if each.survives else " * " if each.difference.excludes_zero else "   "
        rows.append(
            (
                words.task(each.task),
                name_of[each.first],
                name_of[each.second],
                statistics.get(each.statistic, each.statistic),
                words.interval(each.difference, decimals) + star,
                p_shown(each.p_holm),
                words.interval(each.better, 2),
                f"{each.participants}" + ("" if each.paired else " (not paired)"),
            )
        )
    yield Heading(title, level=3)
    yield Sheet("", columns, tuple(rows), kinds=WORDS)
    between = (
        " Not paired: participants of two arms, by Welch's t."
        if any(not each.paired for each in made)
        else ""
    )
    yield Paragraph(
        "First minus second, mean over the participants who have both, each with the mean of his or her runs, with its "
        "95% interval; P(higher): chance that the first has more for a participant. * beyond zero by its interval; "
        f"** also after Holm's correction for {len(made)} differences." + between
    )


def _answers(asked: Asked, name_of: Mapping[Treatment, str]) -> Iterator[Block]:
    if not (asked.scales or asked.choices or asked.texts):
        return
    yield Heading("Answers")
    for question in dict.fromkeys(each.question for each in asked.scales):
        own = [each for each in asked.scales if each.question is question]
        points = tuple(str(point) for point in range(1, question.points + 1))
        ends = (
            f" (1: {question.labels[0]}, {question.points}: {question.labels[1]})"
            if any(question.labels)
            else ""
        )
        yield Sheet(
            f"{question.text}{ends}",
            ("task", "learner", "people", "mean", *points),
            tuple(
                (
                    *_about(each.about, name_of),
                    str(len(each.scores.values)),
                    words.interval(each.mean, 2),
                    *map(str, each.counts),
                )
                for each in own
            ),
            kinds=WORDS,
        )
    yield from _differences("Differences of answers", asked.differences, name_of, {})
    for each in asked.choices:
        task, learner = _about(each.about, name_of)
        about = f" ({task}, {learner})" if task else ""
        yield Sheet(
            f"{each.question.text}{about}",
            ("answer", "people"),
            tuple((option, str(count)) for option, count in each.counts.items()),
            kinds={"answer": "word"},
        )
    for question in dict.fromkeys(each.question for each in asked.texts):
        own = [each for each in asked.texts if each.question is question]
        rows = tuple((str(each.participant), *_about(each.about, name_of), each.text) for each in own)
        sheet = Sheet(question.text, ("participant", "task", "learner", "text"), rows, kinds=WORDS)
        yield Folded(f"{len(rows)} text{'' if len(rows) == 1 else 's'} on {question.name}", (sheet,))


def _about(about: Key, name_of: Mapping[Treatment, str]) -> tuple[str, str]:
    task, treatment = about
    return "" if task is None else words.task(task), "" if treatment is None else name_of[treatment]


def _order(numbers: Numbers) -> Iterator[Block]:
    if not numbers.effects:
        return
    places = max(len(each.places) for each in numbers.effects)
    rows = []
    for each in numbers.effects:
        decimals = words.places([one.estimate for one in each.places])
        shown = [words.interval(one, decimals) for one in each.places]
        rows.append(
            (
                words.task(each.task),
                each.name,
                *shown,
                *[words.ABSENT] * (places - len(shown)),
                words.interval(each.difference, decimals) + (" *" if each.difference.excludes_zero else "  "),
                str(each.pairs),
            )
        )
    columns = ("task", "order", *map(_ordinal, range(1, places + 1)), "last - first", "people")
    yield Heading("Effects of the order")
    yield Sheet("", columns, tuple(rows), kinds=WORDS)
    yield Paragraph(
        "Area, mean over participants with its 95% interval. Learner met: by whether the learner was the first that "
        "the participant met, or a later one, whoever it was; recorded run: the first recorded run with each learner, "
        "and later ones. A difference beyond zero (*) is one of practice or tiredness; where orders are "
        "counterbalanced it is no part of the differences between learners, but it widens their intervals."
    )


def _ordinal(number: int) -> str:
    return {1: "1st", 2: "2nd", 3: "3rd"}.get(number, f"{number}th")


def _methods(held: Held) -> dict[str, str]:
    return {
        "Who counts": "Participants who have done all steps, and those who are still under way. Who left, failed the "
        "check or the trial, was stopped or did not come back in time is in the tables and in no number here.",
        "Runs": "Recorded runs that are complete: by their last episode, or by the limit of time. The "
        "last episode of a run that the limit of time has cut is in no number but the corrections of a run. Dummy "
        "runs are in the tables alone. The runs of one participant are not independent of each other: they are "
        "averaged first, and each participant counts once.",
        "Intervals": f"95% intervals of a studentised bootstrap over participants ({RESAMPLES:,} resamples with a "
        "fixed random seed), never narrower than Student's t. Of the chance that the first is higher: exact binomial "
        "intervals (Clopper and Pearson).",
        "p (Holm)": "Two-sided p of Student's t for a mean difference of zero, after Holm's correction over all "
        "differences of one table. The intervals beside it are not corrected.",
        "Starts": "The starts of episodes are the same for a participant's n-th run with each learner on a task.",
        "Order": f"Learners: {len(held.study.slots)} places, over which orders are spread as the study's file says; "
        "a place is given again when somebody drops out.",
        "Seed": str(held.study.seed),
    }


def _files(stores: Mapping[str, int]) -> dict[str, str]:
    return {
        "dictionary.md": "what the columns of all tables are",
        "participants.parquet, runs.parquet, episodes.parquet, answers.parquet": "the tables",
        "figures/": "the figures as PNG and PDF",
        **{
            f"{name}/": f"a run folder of {count} run{'' if count == 1 else 's'}"
            for name, count in stores.items()
        },
    }
