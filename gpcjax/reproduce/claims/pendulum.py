"""Claims of 5.1.1, the inverted pendulum."""

from gpcjax.report import words
from gpcjax.reproduce.claims.common import alike, each_error, outperforms, steeper, taught_by
from gpcjax.reproduce.measures import Measure
from gpcjax.reproduce.results import Experiment
from gpcjax.reproduce.verdicts import ABOVE_ZERO, ALIKE, Claim, Claimed, test

SECTION = "5.1.1"


def pendulum(experiment: Experiment) -> list[Claim]:
    """Of returns, Fig. 5.1, and of learning rates, Fig. 5.2."""
    errors = experiment.study.errors
    return [
        outperforms(SECTION, experiment, "gpc", "coach"),
        outperforms(SECTION, experiment, "gpc-ns", "coach"),
        alike(
            SECTION,
            "GPC and GPC-NS behave alike",
            experiment,
            ("gpc", "gpc-ns"),
            ("area", lambda runs: runs.area),
            errors,
        ),
        *steeper(SECTION, experiment, ("gpc", "gpc-ns")),
        alike(
            SECTION,
            "GPC's and COACH's final performance is similar",
            experiment,
            ("gpc", "coach"),
            ("final return", lambda runs: runs.final),
            errors,
        ),
        *_advantage(experiment),
        *_rates(experiment),
    ]


def _advantage(experiment: Experiment) -> list[Claim]:
    errors, margin = experiment.study.errors, ALIKE * experiment.gap
    last = words.percent(errors[-1])

    def lead(error: float) -> Measure:
        return experiment.runs("gpc", error).area - experiment.runs("coach", error).area

    return [
        Claim(
            SECTION,
            "GPC's advantage over COACH shrinks with erroneous advice",
            f"(GPC - COACH) in area without errors less that at {last}, above 0",
            (test(f"0% against {last}", lead(errors[0]) - lead(errors[-1]), ABOVE_ZERO),),
            taught_by(experiment),
        ),
        Claim(
            SECTION,
            f"At {last} error GPC has only a slight advantage over COACH",
            f"GPC - COACH in area, between 0 and {words.percent(ALIKE)} of the gap from idle to oracle ({margin:.0f})",
            (test(last, lead(errors[-1]), Claimed(0.0, margin)),),
            taught_by(experiment),
        ),
    ]


def _rates(experiment: Experiment) -> list[Claim]:
    """Fig. 5.2: learning rates over the first corrections, as logarithms."""
    errors, oracles = experiment.study.errors, taught_by(experiment)

    def rate(algo: str, error: float, first: int, last: int) -> Measure:
        return experiment.runs(algo, error).rate(first, last).log10()

    def fall(algo: str, error: float) -> Measure:
        return rate(algo, error, 1, 20) - rate(algo, error, 101, 150)

    within = "within runs that have so many, above 0"
    coarser = tuple(
        test(
            f"{words.algorithm(algo)} {words.percent(e)}",
            rate(algo, e, 1, 10) - rate("coach", e, 1, 10),
            ABOVE_ZERO,
            2,
        )
        for algo in ("gpc", "gpc-ns")
        for e in errors
    )
    gradual = tuple(
        test(words.algorithm(algo), fall(algo, errors[0]) - fall(algo, errors[-1]), ABOVE_ZERO, 2)
        for algo in ("gpc", "gpc-ns")
    )
    return [
        Claim(
            SECTION,
            "GPC and GPC-NS begin with coarser steps than COACH",
            f"difference to COACH in log10 of the mean rate of corrections 1 to 10, {within}",
            coarser,
            oracles,
        ),
        *(
            Claim(
                SECTION,
                f"{words.algorithm(algo)}'s learning rate falls",
                f"log10 of the mean rate of corrections 1 to 20 less that of 101 to 150, {within}",
                each_error(errors, lambda e, algo=algo: fall(algo, e), ABOVE_ZERO, 2),
                oracles,
            )
            for algo in ("gpc", "gpc-ns")
        ),
        Claim(
            SECTION,
            "COACH's first steps are small beside those that follow",
            f"log10 of the mean rate of corrections 41 to 60 less that of 1 to 10, {within}",
            each_error(errors, lambda e: rate("coach", e, 41, 60) - rate("coach", e, 1, 10), ABOVE_ZERO, 2),
            oracles,
        ),
        Claim(
            SECTION,
            "Errors make the fall of the learning rate more gradual",
            f"that fall without errors less the fall at {words.percent(errors[-1])}, above 0",
            gradual,
            oracles,
        ),
    ]
