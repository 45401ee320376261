"""Illustrations made of formulas, with repetitions that say what a test wants."""

import numpy as np

from gpcjax.reproduce.records import Illustrations, Repetitions
from tests.reproduce import test_sketches as made

SEEDS, ADVICES = 30, 6


def illustrations(**changes):
    """All of them; `changes` move what the claims compare, each by its name in `repetitions`."""
    return Illustrations(
        hyperparameters=made.hyperparameters(),
        situations=made.situations(),
        early=made.plane(),
        sparsification=made.sparsification(),
        late=made.plane(),
        erroneous=made.erroneous(),
        repetitions=repetitions(**changes),
    )


def repetitions(
    behind=1e-5,
    rest=-0.2,
    advised=-0.1,
    unconverged=0.2,
    consistent_gpc=0.1,
    consistent_coach=0.2,
    alternating_coach=0.0,
    samples=2.0,
):
    """Each number is what the first of a pair is above the second, but for a little noise."""
    random = np.random.default_rng(0)

    def pair(difference):
        base = 0.5 + 0.05 * random.normal(size=SEEDS)
        return np.stack([base + difference * (1 + 0.1 * random.normal(size=SEEDS)), base])

    def rates(difference, alternating):
        """Rates of advices that move evenly from 0.3, by so much until the last."""
        ramp = np.linspace(0.0, 1.0, ADVICES) * (1 + 0.1 * random.normal(size=(SEEDS, 1)))
        return np.stack([0.3 + difference * ramp, 0.3 + alternating * ramp])

    return Repetitions(
        seeds=np.arange(SEEDS),
        rest=pair(rest),
        advised=pair(advised),
        unconverged=np.stack([pair(unconverged), pair(unconverged)]),
        behind=behind * (1 + 0.1 * random.uniform(size=(2, SEEDS))),
        algorithms=np.array(["gpc", "gpc-ns", "coach"]),
        consistent=np.stack([
            rates(consistent_gpc, 0.0),
            rates(consistent_gpc, 0.0),
            rates(consistent_coach, alternating_coach),
        ]),
        compensated=np.array(["gpc", "gpc-ns"]),
        length_scales=np.array([0.1, 1.0]),
        samples=np.stack([pair(samples)[::-1], pair(samples)[::-1]]),
    )  # fmt: skip
