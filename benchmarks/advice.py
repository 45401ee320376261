"""How much advice people give as they teach: what the scripted participants of a study are set from.

    python -m benchmarks.advice human_advice.csv

reads the 48 sessions of four people that the authors of PPMP (Scholten et al. 2019, arXiv 1903.06151; repository
janscholten/ppmp, MIT) have published, in one table with the columns task, algorithm, person, run, episode, return and
advice_rate (the fraction of an episode's steps at which a key was held). Each session is fitted by least squares with

    rate(episode) = level / (1 + exp((episode - half) / width)),

and the mean and standard deviation over sessions of level, log(half) and log(width) are what
`gpcjax.study.bots.behaviour` has.
"""

import argparse
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.optimize import least_squares

FIRST_EPISODE = 1
BOUNDS = ((0.01, 1.0, 0.5), (1.0, 200.0, 50.0))
"""Lowest and highest level, half and width."""


class Fall(NamedTuple):
    """How advice falls in one session."""

    level: float
    """Fraction of the steps at first."""
    half: float
    """The episode in which half of that is left."""
    width: float
    """Episodes over which it falls."""


class Spread(NamedTuple):
    """Of several sessions."""

    mean: float
    deviation: float


def fall_of(rates: Float[np.ndarray, "episodes"]) -> Fall:
    """The curve of one session, whose episodes are all there, in their order."""
    episodes = np.arange(FIRST_EPISODE, FIRST_EPISODE + len(rates))

    def error(values: np.ndarray) -> np.ndarray:
        level, half, width = values
        return level / (1 + np.exp(np.clip((episodes - half) / width, -50, 50))) - rates

    start = np.clip([rates[:10].mean(), len(rates) / 8, 3.0], *BOUNDS)
    return Fall(*least_squares(error, start, bounds=BOUNDS).x.tolist())


def falls(sessions: pd.DataFrame) -> list[Fall]:
    """The curves of all sessions of a table."""
    keys = ["task", "algorithm", "person", "run"]
    return [
        fall_of(rows.sort_values("episode")["advice_rate"].to_numpy())
        for _, rows in sessions.groupby(keys, sort=True)
    ]


def spreads(fitted: list[Fall]) -> dict[str, Spread]:
    """Mean and standard deviation of level, log(half), log(width)."""
    columns = {
        "level": [each.level for each in fitted],
        "log_half": [math.log(each.half) for each in fitted],
        "log_width": [math.log(each.width) for each in fitted],
    }
    return {name: Spread(float(np.mean(of)), float(np.std(of, ddof=1))) for name, of in columns.items()}


def main() -> None:
    """Prints the numbers."""
    parser = argparse.ArgumentParser(description="fit how people's advice falls, see this module")
    parser.add_argument("table", type=Path)
    sessions = pd.read_csv(parser.parse_args().table)
    fitted = falls(sessions)
    print(f"{len(fitted)} sessions")
    for name, (mean, deviation) in spreads(fitted).items():
        print(f"{name:<9} mean {mean:.3f}  deviation {deviation:.3f}")


if __name__ == "__main__":
    main()
