"""Claims about the method itself, shown by illustrations and tested on many seeds of them."""

import numpy as np

from gpcjax.report import words
from gpcjax.reproduce.measures import Measure, known
from gpcjax.reproduce.records import Illustrations, Repetitions
from gpcjax.reproduce.verdicts import ABOVE_ZERO, BELOW_ZERO, Claim, Claimed, Test, test

NEGLIGIBLE = 1e-3
"""Of an action."""


def illustrated(shown: Illustrations) -> list[Claim]:
    """In the order of the thesis."""
    repeated = shown.repetitions
    return [
        _sparsification(repeated),
        *_consistency(repeated),
        *_state_space(repeated, len(shown.early.returns), len(shown.late.returns)),
        _compensation(repeated),
    ]


def _of(repeated: Repetitions, values: np.ndarray) -> Measure:
    return known(repeated.seeds, values)


def _sparsification(repeated: Repetitions) -> Claim:
    return Claim(
        "3.4.3",
        "Appended points make the action the average of all targets; with SPARS it follows the last one",
        "largest distance of the action from that, over advices of either sign at one state; below 0.001",
        tuple(
            test(name, _of(repeated, behind), Claimed(upper=NEGLIGIBLE), 6)
            for name, behind in zip(("appending", "SPARS"), repeated.behind, strict=True)
        ),
    )


def _consistency(repeated: Repetitions) -> list[Claim]:
    rates = dict(zip(map(str, repeated.algorithms), repeated.consistent, strict=True))
    same, alternating = np.log10(rates["coach"])
    coach = (
        ("first", same[:, -1] - same[:, 0]),
        ("alternating", same[:, -1] - alternating[:, -1]),
    )
    return [
        Claim(
            "3.4.1",
            "Consistent advice keeps the learning rate high, alternating advice lowers it",
            f"mean rate of advices 2 to {same.shape[1]} at one state, all the same less alternating; above 0",
            tuple(
                test(
                    words.algorithm(algo),
                    _of(repeated, (rates[algo][0] - rates[algo][1])[:, 1:].mean(axis=1)),
                    ABOVE_ZERO,
                    4,
                )
                for algo in rates
                if algo != "coach"
            ),
        ),
        Claim(
            "5.1.1",
            "COACH's learning rate rises with consistent advice",
            f"log10 of COACH's rate at one state of the cart-pole at the last of {same.shape[1]} advices that are the "
            "same, less that at the first, and less that at the last of as many that alternate; above 0",
            tuple(test(name, _of(repeated, values), ABOVE_ZERO, 2) for name, values in coach),
        ),
    ]


def _state_space(repeated: Repetitions, early: int, late: int) -> list[Claim]:
    """Of GPC on the pendulum."""
    taught = ("gpc",)
    stages = (f"{early} episodes", f"{late} episodes")
    return [
        Claim(
            "5.1.1",
            "Around the upright rest sigma_h is reduced, so that refinements are small",
            "mean sigma_h of the taught policy's actions within 0.4 rad and 1.5 rad/s of it, less that "
            "elsewhere; below 0",
            (_difference(stages[1], repeated, repeated.rest, BELOW_ZERO),),
            taught,
        ),
        Claim(
            "5.1.1",
            "sigma_p is lower where advice was given",
            "mean sigma_p at the places of all corrections, less that over the whole state space; below 0",
            (_difference(stages[1], repeated, repeated.advised, BELOW_ZERO),),
            taught,
        ),
        Claim(
            "5.4.2",
            "sigma_h marks states whose action has not converged to its target",
            "mean sigma_h at visited states whose action is farther than delta from its target, less that at the "
            "others; above 0",
            tuple(
                _difference(stage, repeated, pair, ABOVE_ZERO)
                for stage, pair in zip(stages, repeated.unconverged, strict=True)
            ),
            taught,
        ),
    ]


def _difference(condition: str, repeated: Repetitions, pair: np.ndarray, claimed: Claimed) -> Test:
    return test(condition, _of(repeated, pair[0] - pair[1]), claimed, 3)


def _compensation(repeated: Repetitions) -> Claim:
    short, long = repeated.length_scales
    return Claim(
        "5.4.1",
        "With a long l_h a wrong advice takes more right ones to compensate",
        f"right advices until the action is back, l_h = {long:g} less {short:g}, for drawn targets and numbers of the "
        "wrong advice; above 0",
        tuple(
            test(words.algorithm(str(algo)), _of(repeated, samples[1] - samples[0]), ABOVE_ZERO, 1)
            for algo, samples in zip(repeated.compensated, repeated.samples, strict=True)
        ),
    )
