"""How a claim is tested: a statistic with its interval under one condition or several, and the verdict. Loads no jax.

A test holds where the 95 % interval of its statistic lies wholly on the claimed side; "alike" means within a margin,
wholly. Differences are between runs of the same seed. Nothing is corrected for the number of tests.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gpcjax.report import words
from gpcjax.report.groups import Group
from gpcjax.report.statistics import Interval, Scores, mean_interval, paired_difference
from gpcjax.reproduce.results import Experiment

ALIKE = 0.05
"""Two returns are alike within this part of the gap from idle to oracle."""

HOLDS, FAILS = "holds", "does not hold"


@dataclass(frozen=True)
class Test:
    """A statistic under one condition: `verdict` is whether the claim holds there."""

    condition: str
    value: Interval
    runs: int
    verdict: bool
    decimals: int = 0

    @property
    def shown(self) -> str:
        """The estimate with its interval."""
        return words.interval(self.value, self.decimals)


@dataclass(frozen=True)
class Claim:
    """One claim: where it stands, what it says, what tests it."""

    section: str
    text: str
    statistic: str
    tests: tuple[Test, ...]

    @property
    def verdict(self) -> str:
        """Holds, holds under some of the conditions, or does not hold."""
        holding = [test.condition for test in self.tests if test.verdict]
        if len(holding) == len(self.tests):
            return HOLDS
        return f"{HOLDS} at {', '.join(holding)}" if holding else FAILS


def outperforms(section: str, experiment: Experiment, first: str, second: str) -> list[Claim]:
    """Whether one learner is ahead of another in area, at each error rate."""
    area = area_of(experiment)
    return [
        Claim(
            section,
            f"{words.algorithm(first)} outperforms {words.algorithm(second)} at every error rate",
            f"{words.algorithm(first)} - {words.algorithm(second)} in area",
            each_error(experiment, lambda e: above(area(first, e), area(second, e))),
        )
    ]


def alike(
    section: str,
    text: str,
    experiment: Experiment,
    first: str,
    second: str,
    scores: Callable[[Group], Scores],
    name: str,
    errors: Sequence[float] | None = None,
) -> Claim:
    """Whether the scores of two learners are alike, at each error rate or at some."""
    margin = ALIKE * experiment.gap
    tests = []
    for error in experiment.study.errors if errors is None else errors:
        pair = (scores(experiment.group(algo, error)) for algo in (first, second))
        interval, pairs = paired_difference(*pair)
        verdict = -margin < interval.lower and interval.upper < margin
        tests.append(Test(words.percent(error), interval, pairs, verdict))
    statistic = (
        f"{words.algorithm(first)} - {words.algorithm(second)} in {name}, within {words.percent(ALIKE)} of the gap "
        f"from idle to oracle (±{margin:.0f})"
    )
    return Claim(section, text, statistic, tuple(tests))


def each_error(experiment: Experiment, make: Callable[[float], Test]) -> tuple[Test, ...]:
    """A test for each error rate, which is its condition."""
    return tuple(
        Test(words.percent(e), test.value, test.runs, test.verdict, test.decimals)
        for e in experiment.study.errors
        for test in (make(e),)
    )


def above(first: Scores, second: Scores, condition: str = "") -> Test:
    """Whether the first scores are above the second, on the same seeds."""
    return test(condition, *paired_difference(first, second), lambda i: i.lower > 0)


def mean_test(scores: Scores, holds: Callable[[Interval], bool], decimals: int, condition: str = "") -> Test:
    """A test of a mean over runs."""
    return test(condition, *mean(scores), holds, decimals)


def test(
    condition: str, value: Interval, runs: int, holds: Callable[[Interval], bool], decimals: int = 0
) -> Test:
    """A test of a value with its interval, and the number of runs behind it."""
    return Test(condition, value, runs, bool(holds(value)), decimals)


def mean(scores: Scores) -> tuple[Interval, int]:
    """The mean over runs with its interval, and their number."""
    return mean_interval(scores.values[:, None]), len(scores.values)


def exactly(value: float) -> Interval:
    """A value that knows no interval."""
    return Interval(value, np.nan, np.nan)


def minus(first: Scores, second: Scores) -> Scores:
    """The difference of two scores, on the seeds that both have."""
    seeds, mine, theirs = np.intersect1d(first.seeds, second.seeds, assume_unique=True, return_indices=True)
    return Scores(seeds, first.values[mine] - second.values[theirs])


def average(scores: Sequence[Scores]) -> Scores:
    """The mean of several scores, on the seeds that all have."""
    seeds = scores[0].seeds
    for each in scores[1:]:
        seeds = np.intersect1d(seeds, each.seeds, assume_unique=True)
    values = [each.values[np.searchsorted(each.seeds, seeds)] for each in scores]
    return Scores(seeds, np.mean(values, axis=0))


def area_of(experiment: Experiment) -> Callable[[str, float], Scores]:
    """The area under the learning curve, by learner and error rate."""
    return lambda algo, error: experiment.group(algo, error).area


def closed(experiment: Experiment, algo: str, error: float) -> Scores:
    """The part of the gap from idle to oracle that the final return has closed."""
    final = experiment.group(algo, error).final
    return Scores(final.seeds, (final.values - experiment.study.idle.mean) / experiment.gap)


def change_of_difference(experiment: Experiment, errors: Sequence[float]) -> tuple[Interval, int]:
    """How much GPC's lead over COACH in area shrinks from the first error rate to the last."""
    area = area_of(experiment)
    first, last = (minus(area("gpc", e), area("coach", e)) for e in (errors[0], errors[-1]))
    return paired_difference(first, last)
