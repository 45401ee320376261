"""What a study's recorded runs come to, over participants: means, paired differences, effects of order. Loads no jax.

A participant is the unit: his or her runs with a learner on a task are averaged first, as runs of one person are not
independent of each other. Intervals are those of `gpcjax.report.statistics`, over participants.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from gpcjax.report.bootstrap import TAILS
from gpcjax.report.compare_numbers import better_paired
from gpcjax.report.distributions import student_quantile, student_tail
from gpcjax.report.statistics import Interval, Scores, holm, mean_interval, paired_difference, student_p
from gpcjax.study.design import Treatment
from gpcjax.study.report.held import Held, RunRows
from gpcjax.study.steps import RECORDED
from gpcjax.sweep.sofar import FINAL_EPISODES

STATISTICS = {"area": "area", "final": "final return", "corrections": "corrections"}
"""What is compared of a run, and how tables call it."""


@dataclass(frozen=True, eq=False)
class Taught:
    """The recorded runs of one learner, in one arm, on one task."""

    task: str
    treatment: Treatment
    by_participant: Mapping[int, tuple[RunRows, ...]]
    """The complete runs of each participant who counts, by number."""

    @property
    def participants(self) -> list[int]:
        """Their numbers, ascending."""
        return sorted(self.by_participant)

    @property
    def runs(self) -> int:
        """How many there are."""
        return sum(map(len, self.by_participant.values()))

    @cached_property
    def curves(self) -> Float[np.ndarray, "participants episodes"]:
        """Returns, a row for each participant: the mean over the runs that have the episode, nan where none has."""
        return self._curves("return")

    @cached_property
    def rates(self) -> Float[np.ndarray, "participants episodes"]:
        """Corrections for each step, likewise."""
        return self._curves("rate")

    def scores(self, statistic: str) -> Scores:
        """One number for each participant."""
        values = [
            np.mean([score(run, statistic) for run in self.by_participant[one]]) for one in self.participants
        ]
        return Scores(np.array(self.participants, np.int64), np.array(values, np.float64))

    def interval(self, statistic: str) -> Interval:
        """Mean over participants."""
        return mean_interval(self.scores(statistic).values[:, None])

    def _curves(self, name: str) -> np.ndarray:
        each = [
            mean_curve([curve(run, name) for run in self.by_participant[one]]) for one in self.participants
        ]
        return padded(each)


def curve(run: RunRows, name: str) -> Float[np.ndarray, "episodes"]:
    """The returns of a run's whole episodes, or (`rate`) the corrections for each of their steps."""
    if name == "rate":
        corrections, length = (run.whole.column(each).to_numpy() for each in ("corrections", "length"))
        return corrections / length
    return run.whole.column(name).to_numpy().astype(np.float64)


def padded(curves: Sequence[Float[np.ndarray, "_"]]) -> Float[np.ndarray, "curves episodes"]:
    """Curves as rows, with nan behind those that are shorter."""
    made = np.full((len(curves), max(map(len, curves), default=0)), np.nan)
    for row, each in zip(made, curves, strict=True):
        row[: len(each)] = each
    return made


def mean_curve(curves: Sequence[Float[np.ndarray, "_"]]) -> Float[np.ndarray, "episodes"]:
    """The mean at each episode over the curves that have it."""
    rows = padded(curves)
    return np.nansum(rows, axis=0) / (~np.isnan(rows)).sum(axis=0)


def score(run: RunRows, statistic: str) -> float:
    """One number of a run."""
    match statistic:
        case "area":
            return float(curve(run, "return").mean())
        case "final":
            return float(curve(run, "return")[-FINAL_EPISODES:].mean())
    return float(run.episodes.column("corrections").to_numpy().sum())


@dataclass(frozen=True)
class Difference:
    """First minus second, over participants."""

    task: str
    first: Treatment
    second: Treatment
    statistic: str
    difference: Interval
    p: float
    participants: int
    paired: bool
    """Whether each participant has both; else they are of two arms."""
    better: Interval
    """Chance that a participant's return is higher with the first; no number where they are not paired."""
    p_holm: float = np.nan

    @property
    def survives(self) -> bool:
        """Whether it is beyond zero, by its interval, and after Holm's correction."""
        return self.difference.excludes_zero and self.p_holm <= 0.05


@dataclass(frozen=True)
class Effect:
    """What the order does: a mean over participants at each place, and the last minus the first."""

    task: str
    name: str
    places: tuple[Interval, ...]
    counts: tuple[int, ...]
    difference: Interval
    pairs: int


@dataclass(frozen=True, eq=False)
class Numbers:
    """All of it."""

    taught: tuple[Taught, ...]
    differences: tuple[Difference, ...]
    effects: tuple[Effect, ...]

    def of(self, task: str) -> list[Taught]:
        """The learners on a task."""
        return [each for each in self.taught if each.task == task]


def numbers_of(held: Held) -> Numbers:
    """Of a study."""
    found: dict[tuple[str, Treatment], dict[int, list[RunRows]]] = {}
    for arm in held.study.arms:
        for learner in arm.learners:
            for task in held.study.tasks:
                found[task, Treatment(learner, arm.name)] = {}
    for run in held.runs:
        if run.counts and run.step.phase == RECORDED:
            own = found[run.step.task, run.step.treatment]
            own.setdefault(run.participant.kept.number, []).append(run)
    taught = [
        Taught(task, treatment, {one: tuple(runs) for one, runs in sorted(by.items())})
        for (task, treatment), by in sorted(
            found.items(), key=lambda each: held.study.tasks.index(each[0][0])
        )
        if by
    ]
    return Numbers(tuple(taught), tuple(_differences(held, taught)), tuple(_effects(held, taught)))


def _differences(held: Held, taught: Sequence[Taught]) -> list[Difference]:
    made = []
    for one, other in itertools.combinations(taught, 2):
        if one.task != other.task:
            continue
        same_arm = one.treatment.arm == other.treatment.arm
        if same_arm or held.study.within:
            made += [_paired(one, other, statistic) for statistic in STATISTICS]
        elif one.treatment.learner == other.treatment.learner:
            made += [_between(one, other, statistic) for statistic in STATISTICS]
    return corrected(made)


def corrected(made: Sequence[Difference]) -> list[Difference]:
    """The same with Holm's p: all of them are one family, but for those that have no p."""
    known = [each.p for each in made if not np.isnan(each.p)]
    adjusted = iter(holm(known))
    return [each if np.isnan(each.p) else replace(each, p_holm=next(adjusted)) for each in made]


def _paired(one: Taught, other: Taught, statistic: str) -> Difference:
    first, second = one.scores(statistic), other.scores(statistic)
    difference, pairs = paired_difference(first, second)
    _, mine, its = np.intersect1d(first.seeds, second.seeds, return_indices=True)
    a, b = first.values[mine], second.values[its]
    return Difference(
        one.task, one.treatment, other.treatment, statistic, difference, student_p(a - b), pairs, True,
        better_paired(a, b),
    )  # fmt: skip


def _between(one: Taught, other: Taught, statistic: str) -> Difference:
    a, b = one.scores(statistic).values, other.scores(statistic).values
    difference, p = welch(a, b)
    nothing = Interval(np.nan, np.nan, np.nan)
    return Difference(
        one.task, one.treatment, other.treatment, statistic, difference, p, len(a) + len(b), False, nothing
    )


def welch(first: Float[np.ndarray, "a"], second: Float[np.ndarray, "b"]) -> tuple[Interval, float]:
    """Difference of the means of two independent samples with its 95% interval and two-sided p, by Welch's t.

    No bounds and no p where a sample has fewer than two numbers, or where neither varies.
    """
    difference = float(first.mean() - second.mean()) if len(first) and len(second) else np.nan
    if min(len(first), len(second)) < 2:
        return Interval(difference, np.nan, np.nan), np.nan
    parts = [each.var(ddof=1) / len(each) for each in (first, second)]
    error = np.sqrt(sum(parts))
    if error == 0:
        return Interval(difference, np.nan, np.nan), np.nan
    freedom = sum(parts) ** 2 / sum(
        part**2 / (len(each) - 1) for part, each in zip(parts, (first, second), strict=True)
    )
    reach = float(student_quantile(TAILS[1], freedom)) * error
    p = 2 * student_tail(abs(difference) / error, freedom)
    return Interval(difference, float(difference - reach), float(difference + reach)), p


def _effects(held: Held, taught: Sequence[Taught]) -> list[Effect]:
    """Of the place at which a learner was met, and of the repetition, on the area of each task."""
    made = []
    for task in dict.fromkeys(each.task for each in taught):
        runs = [
            run for each in taught if each.task == task for of in each.by_participant.values() for run in of
        ]
        places = {
            "learner met": lambda run: list(run.participant.letters).index(run.step.letter) + 1,
            "recorded run": lambda run: run.step.repetition - held.study.runs.dummy,
        }
        for name, place_of in places.items():
            by_place: dict[int, dict[int, list[float]]] = {}
            for run in runs:
                own = by_place.setdefault(place_of(run), {})
                own.setdefault(run.participant.kept.number, []).append(score(run, "area"))
            if len(by_place) > 1:
                made.append(_effect(task, name, by_place))
    return made


def _effect(task: str, name: str, by_place: Mapping[int, Mapping[int, Sequence[float]]]) -> Effect:
    scores = [
        Scores(np.array(sorted(own)), np.array([np.mean(own[one]) for one in sorted(own)]))
        for _, own in sorted(by_place.items())
    ]
    difference, pairs = paired_difference(scores[-1], scores[0])
    return Effect(
        task,
        name,
        tuple(mean_interval(each.values[:, None]) for each in scores),
        tuple(len(each.values) for each in scores),
        difference,
        pairs,
    )
