"""Experiments whose results are made of formulas: learning curves as high as a test says, rates as it says."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from gpcjax.report.groups import gather
from gpcjax.reproduce.parts import ABLATIONS, ROWS
from gpcjax.reproduce.results import Experiment
from tests.report import synthetic

ERRORS = (0.0, 0.1, 0.2)
EPISODES = 12
CORRECTIONS = 160
"""Of each run: enough for every window of corrections that a claim speaks of."""

LEVELS = {"gpc": 0.9, "gpc-ns": 0.9, "coach": 0.4}
SLOPES = {"gpc": -0.3, "gpc-ns": -0.3, "coach": 0.3}
"""How far log10 of the learning rate changes over all corrections."""


KEPT = 32
"""Experiments that are made once, as long as they are the newest: tests compare many with the same others."""

_made: dict[str, Experiment] = {}


def experiment(env: str = "cartpole", levels: Mapping = LEVELS, **settings) -> Experiment:
    """What `make` gives, in tables of its own, which a test may change."""
    if "at" in settings:  # a function, which has no text that tells it from others
        return make(env, levels, **settings)
    name = repr((env, levels, settings))
    kept = _made[name] = _made.pop(name, None) or make(env, levels, **settings)
    while len(_made) > KEPT:
        del _made[next(iter(_made))]
    return dataclasses.replace(kept, episodes=kept.episodes.copy(), corrections=kept.corrections.copy())


def make(
    env: str = "cartpole",
    levels: Mapping[str, float | Sequence[float]] = LEVELS,
    early: Mapping[str, float] | None = None,
    slopes: Mapping[str, float | Sequence[float]] = SLOPES,
    used: float = 10.0,
    rate: float = 0.03,
    first_rate: float = 0.1,
    chance: float = 0.5,
    spread: float = 0.01,
    errors: Sequence[float] = ERRORS,
    seeds: int = 12,
    oracles: Sequence[str] = ("gpc",),
    deltas: Sequence[float] = (),
    at: Callable[[str, float | None], Mapping[str, float]] = lambda oracle, delta: {},
) -> Experiment:
    """One experiment.

    Args:
        env: the task.
        levels: by algorithm, its return in parts of the gap from idle to oracle; a value, or one for each error rate.
        early: the same over the first six episodes alone, where it is another.
        slopes: change of log10 of the learning rate from the first to the last correction, like `levels`.
        used: corrections in an episode.
        rate: mean learning rate of every episode, about.
        first_rate: learning rate of a run's first correction.
        chance: chance of advice in parts of `rate`, which rise and fall together; apart from each other if negative.
        spread: standard deviation of runs, in parts of the gap; those of one seed differ by a tenth of that.
        errors: error rates.
        seeds: runs of each setting.
        oracles: names of the oracles.
        deltas: distances, if several.
        at: levels with an oracle and a delta, where they are others.
    """
    frame = _episodes(env, tuple(levels), tuple(errors), seeds, tuple(oracles), tuple(deltas)).copy()
    idle, best = synthetic.LEVELS[env]
    place = frame["error"].map({error: i for i, error in enumerate(errors)}).to_numpy()
    random = np.random.default_rng(1)
    of_seed, own = random.normal(0, spread, seeds), random.normal(0, spread / 10, len(frame))
    cells = list(
        zip(frame["algo"], frame["oracle"], frame["delta"] if deltas else [None] * len(frame), strict=True)
    )
    at_cell = {
        (algo, oracle, delta): {**levels, **at(oracle, delta)}[algo] for algo, oracle, delta in set(cells)
    }
    part = np.array([_one(at_cell[cell], i) for cell, i in zip(cells, place, strict=True)])
    beginning = frame["episode"].to_numpy() <= EPISODES // 2
    for algo, level in (early or {}).items():
        part = np.where(beginning & (frame["algo"] == algo), level, part)
    frame["return"] = idle + (best - idle) * (part + of_seed[frame["seed"]] + own)
    frame["corrections"] = (used + frame["seed"] % 3).astype(np.int32)
    moved = 0.01 * random.normal(size=len(frame))
    frame["mean_rate"] = rate * (1 + moved)
    frame["chance"] = 0.05 * (1 + chance * moved)
    return _read(frame, slopes, errors, deltas, first_rate)


def table(**changes: Mapping[str, object]) -> dict[str, Experiment]:
    """Experiments for Table 5.4 and its variants: i before ii and iii before iv; `changes` are by row.

    Learning rates are above r_c at first and below it later, and everything is ten times that where r_c is.
    """
    level = {"i": 0.9, "ii": 0.8, "iii": 0.8, "iv": 0.6}
    used = {"i": 5.0, "ii": 10.0, "iii": 10.0, "iv": 20.0}
    slopes = {"i": -0.2, "ii": 0.0, "iii": -0.6, "iv": 0.0}
    made = {}
    for row in ROWS:
        plain = {
            "levels": {"gpc": level[row]},
            "used": used[row],
            "slopes": {"gpc": slopes[row]},
            "errors": (0.1,),
        }
        given = plain | changes.get(row, {})
        times = {round(variant.static_rate / 0.04) for variant in ABLATIONS.values()}
        made[row] = {
            k: experiment(
                **given
                | {"rate": k * given.get("rate", 0.03), "first_rate": k * given.get("first_rate", 0.1)}
            )
            for k in times
        }
    return {
        f"{name}_{row}": made[row][round(variant.static_rate / 0.04)]
        for name, variant in ABLATIONS.items()
        for row in ROWS
    }


@functools.cache
def _episodes(env, algos, errors, seeds, oracles, deltas):
    """The rows of such runs, before it is said how well they do."""
    points = {algo: [{"delta": delta} for delta in deltas] for algo in algos} if deltas else None
    return synthetic.episodes(env, algos, errors, seeds, EPISODES, oracles, points)


def _read(frame, slopes, errors, deltas, first_rate):
    corrections = frame.drop_duplicates(["algo", "oracle", "error", "seed", *(["delta"] if deltas else [])])
    slope = np.repeat(
        [
            float(_one(slopes[algo], errors.index(error)))
            for algo, error in zip(corrections["algo"], corrections["error"], strict=True)
        ],
        CORRECTIONS,
    )
    corrections = corrections.loc[corrections.index.repeat(CORRECTIONS)].reset_index(drop=True)
    number = np.tile(np.arange(CORRECTIONS), len(corrections) // CORRECTIONS)
    random = np.random.default_rng(2)
    noise = 0.01 * random.normal(size=len(number))
    corrections = corrections.assign(
        episode=1 + number // 20,
        step=number % 20,
        action_dim=0,
        rate=first_rate * 10 ** (slope * number / CORRECTIONS + noise),
    )
    description = synthetic.manifest(frame, varying=["delta"] if deltas else [])
    return Experiment(gather(frame, description), frame, corrections)


def _one(value, place):
    return value[place] if isinstance(value, Sequence) else value
