"""Claims of the same form that several parts make."""

from collections.abc import Callable, Sequence

from gpcjax.report import words
from gpcjax.reproduce.measures import Measure
from gpcjax.reproduce.results import EARLY, Experiment, Runs
from gpcjax.reproduce.verdicts import ABOVE_ZERO, ALIKE, CONVERGED, Claim, Claimed, Test, test

OTHER_THRESHOLDS = (0.8, 0.95)
"""Of what closes the gap: what the verdict would be if converged meant that."""

CLOSED = "final return less that of the idle policy, in parts of the gap to the oracle"


def each_error(
    errors: Sequence[float], values: Callable[[float], Measure], claimed: Claimed, decimals: int = 0
) -> tuple[Test, ...]:
    """A test for each error rate, which is its condition."""
    return tuple(test(words.percent(error), values(error), claimed, decimals) for error in errors)


def taught_by(*experiments: Experiment) -> tuple[str, ...]:
    """The oracles of these experiments, each once."""
    return tuple(dict.fromkeys(oracle for each in experiments for oracle in each.study.oracles))


def outperforms(section: str, experiment: Experiment, first: str, second: str) -> Claim:
    """Whether one learner is ahead of another in area, at each error rate."""
    names = words.algorithm(first), words.algorithm(second)
    return Claim(
        section,
        f"{names[0]} outperforms {names[1]} at every error rate",
        f"{names[0]} - {names[1]} in area, above 0",
        each_error(
            experiment.study.errors,
            lambda e: experiment.runs(first, e).area - experiment.runs(second, e).area,
            ABOVE_ZERO,
        ),
        taught_by(experiment),
    )


def alike(
    section: str,
    text: str,
    experiment: Experiment,
    algorithms: tuple[str, str],
    measured: tuple[str, Callable[[Runs], Measure]],
    errors: Sequence[float],
) -> Claim:
    """Whether two learners are alike in something (its name and how it is measured), within `ALIKE` of the gap."""
    (first, second), (name, values), margin = algorithms, measured, ALIKE * experiment.gap
    statistic = (
        f"{words.algorithm(first)} - {words.algorithm(second)} in {name}, within {words.percent(ALIKE)} of the gap "
        f"from idle to oracle (±{margin:.0f})"
    )
    return Claim(
        section,
        text,
        statistic,
        each_error(
            errors,
            lambda e: values(experiment.runs(first, e)) - values(experiment.runs(second, e)),
            Claimed(-margin, margin),
        ),
        taught_by(experiment),
    )


def steeper(section: str, experiment: Experiment, algorithms: Sequence[str]) -> list[Claim]:
    """Whether learning curves are steeper than COACH's at the beginning: as a slope, and as the level they reach."""
    names = " and ".join(map(words.algorithm, algorithms))
    plural = len(algorithms) > 1
    text = (
        f"{names} have steeper learning curves than COACH at the beginning"
        if plural
        else f"{names}'s learning curve is steeper than COACH's at the beginning"
    )
    ways: tuple[tuple[str, str, Callable[[Runs], Measure], int], ...] = (
        ("slope", "slope of the line of least squares, return an episode", lambda runs: runs.steepness, 1),
        ("level", "mean return", lambda runs: runs.early, 0),
    )
    return [
        Claim(
            section,
            f"{text} ({way})",
            f"difference to COACH in {what}, over the first {EARLY} episodes, above 0",
            tuple(
                test(
                    f"{words.algorithm(algo)} {words.percent(e)}" if plural else words.percent(e),
                    values(experiment.runs(algo, e)) - values(experiment.runs("coach", e)),
                    ABOVE_ZERO,
                    decimals,
                )
                for algo in algorithms
                for e in experiment.study.errors
            ),
            taught_by(experiment),
        )
        for way, what, values, decimals in ways
    ]


def converges(section: str, text: str, experiment: Experiment, algo: str, errors: Sequence[float]) -> Claim:
    """Whether a learner's final return closes `CONVERGED` of the gap, and what other thresholds would say."""

    def claim(threshold: float, remark: str = "") -> Claim:
        return Claim(
            section,
            text,
            f"{words.algorithm(algo)}: {CLOSED}, above {threshold:g}",
            each_error(errors, lambda e: experiment.runs(algo, e).closed, Claimed(lower=threshold), 2),
            taught_by(experiment),
            remark=remark,
        )

    others = (f"with {threshold:g} instead: {claim(threshold).short}" for threshold in OTHER_THRESHOLDS)
    return claim(CONVERGED, "; ".join(others))


def loss(experiment: Experiment, algo: str, values: Callable[[Runs], Measure]) -> Measure:
    """What a learner loses from the first error rate to the last."""
    errors = experiment.study.errors
    first, last = (values(experiment.runs(algo, e)) for e in (errors[0], errors[-1]))
    return first - last
