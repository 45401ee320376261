"""Claims of all tasks together: 5.4 and 6."""

from collections.abc import Iterable

from gpcjax.report import words
from gpcjax.reproduce.claims.common import loss, taught_by
from gpcjax.reproduce.measures import Measure, average, ratio_of_means
from gpcjax.reproduce.results import Experiment
from gpcjax.reproduce.verdicts import ABOVE_ZERO, ALIKE, BELOW_ZERO, Claim, Claimed, Test, test


def across(pendulum: Experiment, cartpole: Experiment, lander: Experiment) -> list[Claim]:
    """Of the tasks in parts of each one's own gap from the idle policy to the oracle."""
    domains = {"pendulum": pendulum, "cart-pole": cartpole, "lander": lander}
    oracles = taught_by(pendulum, cartpole, lander)
    return [
        Claim(
            "5.4.1",
            "No algorithm ever exceeds GPC",
            "the other's area less GPC's, below 0 (with no margin)",
            tuple(each for name, one in domains.items() for each in _exceeding(name, one)),
            oracles,
        ),
        Claim(
            "5.4.1",
            "GPC-NS outperforms COACH on the majority of the tasks",
            "GPC-NS - COACH in area, in parts of each task's gap, mean over the error rates; above 0 on most",
            tuple(
                test(name, _lead(one, "gpc-ns"), ABOVE_ZERO, 2)
                for name, one in domains.items()
                if "gpc-ns" in one.study.algorithms
            ),
            oracles,
            most=True,
        ),
        Claim(
            "5.4.1",
            "GPC's lead over COACH is largest on the lander, the most complex task",
            "(GPC - COACH) in area, in parts of each task's gap, on the lander less that elsewhere; means over the "
            "error rates; above 0",
            tuple(
                test(name, _lead(lander, "gpc") - _lead(domains[name], "gpc"), ABOVE_ZERO, 2)
                for name in ("pendulum", "cart-pole")
            ),
            oracles,
        ),
        *_robustness(domains, oracles),
        Claim(
            "6.1",
            "GPC-NS approaches GPC's final performance in most experiments",
            f"GPC-NS - GPC in final return, in parts of the gap; above {-2 * ALIKE:g} in most",
            tuple(each for name, one in domains.items() for each in _near(name, one)),
            oracles,
            most=True,
        ),
    ]


def _lead(experiment: Experiment, algo: str) -> Measure:
    """Over COACH in area, in parts of the gap, mean over the error rates."""
    return average(
        [
            (experiment.runs(algo, e).area - experiment.runs("coach", e).area) / experiment.gap
            for e in experiment.study.errors
        ]
    )


def _exceeding(name: str, experiment: Experiment) -> Iterable[Test]:
    for other in ("gpc-ns", "coach"):
        for e in experiment.study.errors if other in experiment.study.algorithms else ():
            difference = experiment.runs(other, e).area - experiment.runs("gpc", e).area
            yield test(f"{name} {words.percent(e)} {words.algorithm(other)}", difference, BELOW_ZERO)


def _near(name: str, experiment: Experiment) -> Iterable[Test]:
    for e in experiment.study.errors if "gpc-ns" in experiment.study.algorithms else ():
        difference = experiment.runs("gpc-ns", e).closed - experiment.runs("gpc", e).closed
        yield test(f"{name} {words.percent(e)}", difference, Claimed(lower=-2 * ALIKE), 2)


def _robustness(domains: dict[str, Experiment], oracles: tuple[str, ...]) -> list[Claim]:
    """Twice, since a learner that attains nothing has nothing to lose."""

    def kept(experiment: Experiment, algo: str) -> Measure:
        first, last = (experiment.runs(algo, experiment.study.errors[place]).closed for place in (0, -1))
        return ratio_of_means(last, first)

    def lost(experiment: Experiment, algo: str) -> Measure:
        return loss(experiment, algo, lambda runs: runs.closed)

    text = "GPC is more robust to errors than COACH on every task"
    return [
        Claim(
            "paper 6",
            f"{text} (loss)",
            "COACH's loss of final return from no errors to the most, less GPC's, in parts of the gap; above 0",
            tuple(
                test(name, lost(one, "coach") - lost(one, "gpc"), ABOVE_ZERO, 2)
                for name, one in domains.items()
            ),
            oracles,
            remark="a learner that attains nothing has nothing to lose",
        ),
        Claim(
            "paper 6",
            f"{text} (what is kept)",
            "part of its final return, above that of the idle policy, that GPC keeps from no errors to the most, less "
            "that part of COACH's; above 0",
            tuple(
                test(name, kept(one, "gpc") - kept(one, "coach"), ABOVE_ZERO, 2)
                for name, one in domains.items()
            ),
            oracles,
            remark="ratios of means over runs, with the jackknife",
        ),
    ]
