"""Claims of 5.1.3, the lunar lander."""

from gpcjax.reproduce.claims.common import CLOSED, alike, converges, each_error, outperforms, taught_by
from gpcjax.reproduce.results import Experiment
from gpcjax.reproduce.verdicts import Claim, Claimed

SECTION = "5.1.3"


def lander(experiment: Experiment) -> list[Claim]:
    """Of returns, Fig. 5.5. GPC-NS takes so long there that a reproduction may not have it yet."""
    errors = experiment.study.errors
    made = [
        outperforms(SECTION, experiment, "gpc", "coach"),
        Claim(
            SECTION,
            "COACH attains no performance",
            f"COACH: {CLOSED}; below 0.1",
            each_error(errors, lambda e: experiment.runs("coach", e).closed, Claimed(upper=0.1), 2),
            taught_by(experiment),
        ),
        converges(SECTION, "GPC converges at every error rate", experiment, "gpc", errors),
    ]
    if "gpc-ns" not in experiment.study.algorithms:
        return made
    return [
        *made,
        outperforms(SECTION, experiment, "gpc-ns", "coach"),
        alike(
            SECTION,
            "GPC and GPC-NS perform alike",
            experiment,
            ("gpc", "gpc-ns"),
            ("final return", lambda runs: runs.final),
            errors,
        ),
        converges(SECTION, "GPC-NS converges at every error rate", experiment, "gpc-ns", errors),
    ]
