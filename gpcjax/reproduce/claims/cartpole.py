"""Claims of 5.1.2, the cart-pole."""

from gpcjax.report import words
from gpcjax.reproduce.claims.common import alike, converges, loss, outperforms, steeper, taught_by
from gpcjax.reproduce.measures import Measure
from gpcjax.reproduce.results import Experiment
from gpcjax.reproduce.verdicts import ABOVE_ZERO, Claim, Claimed, test

SECTION = "5.1.2"

MUCH = 0.2
"""This part of the gap from idle to oracle is much."""


def cartpole(experiment: Experiment) -> list[Claim]:
    """Of returns, Fig. 5.4."""
    errors, oracles = experiment.study.errors, taught_by(experiment)
    last, much = words.percent(errors[-1]), MUCH * experiment.gap

    def final(algo: str, error: float) -> Measure:
        return experiment.runs(algo, error).final

    def lost(algo: str) -> Measure:
        return loss(experiment, algo, lambda runs: runs.final)

    return [
        outperforms(SECTION, experiment, "gpc", "coach"),
        outperforms(SECTION, experiment, "gpc-ns", "coach"),
        *steeper(SECTION, experiment, ("gpc", "gpc-ns")),
        alike(
            SECTION,
            "GPC-NS approaches GPC without errors",
            experiment,
            ("gpc", "gpc-ns"),
            ("final return", lambda runs: runs.final),
            errors[:1],
        ),
        Claim(
            SECTION,
            "GPC-NS is brittle to errors where GPC is robust",
            f"GPC-NS' loss of final return from 0% to {last} error, less GPC's, above 0",
            (test(last, lost("gpc-ns") - lost("gpc"), ABOVE_ZERO),),
            oracles,
        ),
        Claim(
            SECTION,
            "COACH is brittle to errors",
            f"COACH's loss of final return from 0% to {last} error, less half of what it has at 0%, above 0",
            (test(last, lost("coach") - 0.5 * final("coach", errors[0]), ABOVE_ZERO),),
            oracles,
        ),
        converges(
            SECTION, "GPC is very robust to errors: it converges with them", experiment, "gpc", errors[1:]
        ),
        converges("5.3", "COACH attains convergence without errors", experiment, "coach", errors[:1]),
        Claim(
            SECTION,
            f"GPC stays ahead of GPC-NS at {last} error by much",
            f"GPC - GPC-NS in final return, above a fifth of the gap from idle to oracle ({much:.0f})",
            (test(last, final("gpc", errors[-1]) - final("gpc-ns", errors[-1]), Claimed(lower=much)),),
            oracles,
        ),
    ]
