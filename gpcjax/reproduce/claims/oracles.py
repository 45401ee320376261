"""The order of the learners again, for each oracle and each distance within which it is silent."""

from collections.abc import Sequence

from gpcjax.report import words
from gpcjax.report.groups import unique
from gpcjax.reproduce.parts import CIRCLE, DEPENDENCE, taught_by_gpc
from gpcjax.reproduce.results import Experiment, Results
from gpcjax.reproduce.verdicts import ABOVE_ZERO, Claim, test

PAIRS = (("gpc", "coach"), ("gpc-ns", "coach"), ("gpc", "gpc-ns"))


def oracles(results: Results) -> list[Claim]:
    """Of each experiment that is there: with the oracles that GPC itself taught, and with the others."""
    return [
        claim
        for name, (task, section) in DEPENDENCE.items()
        if name in results
        for claim in _order(results[name], task, section)
    ]


def _order(experiment: Experiment, task: str, section: str) -> list[Claim]:
    every = tuple(experiment.study.oracles)
    kinds = (
        (f"oracles that GPC itself taught ({CIRCLE})", tuple(filter(taught_by_gpc, every))),
        ("oracles that owe nothing to GPC", tuple(name for name in every if not taught_by_gpc(name))),
    )
    return [
        _outperforms(experiment, (first, second), error, names, f"{task}, {kind}", section)
        for kind, names in kinds
        if names
        for first, second in PAIRS
        for error in experiment.study.errors
    ]


def _outperforms(
    experiment: Experiment,
    pair: tuple[str, str],
    error: float,
    names: Sequence[str],
    oracles: str,
    section: str,
) -> Claim:
    deltas = unique(group.point.get("delta") for group in experiment.study.groups)
    tests = []
    for oracle in names:
        for delta in deltas:
            first, second = (experiment.runs(algo, error, oracle, delta).area for algo in pair)
            tests.append(test(oracle if delta is None else f"{oracle} {delta:g}", first - second, ABOVE_ZERO))
    first, second = map(words.algorithm, pair)
    return Claim(
        section,
        f"{first} outperforms {second} at {words.percent(error)} error: {oracles}",
        f"{first} - {second} in area, above 0, for each oracle and each distance delta within which it is silent",
        tuple(tests),
        tuple(names),
    )
