"""A store that looks like a sweep's, made of formulas: no engine and no jax."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gpcjax.sweep.plan import hash_of

LEVELS = {"cartpole": (40.0, 2500.0), "pendulum": (-1200.0, -150.0), "lunarlander": (-130.0, 250.0)}
"""Return of the idle policy and of the oracle."""

SPEED = {"gpc": 0.45, "gpc-ns": 0.3, "coach": 0.12}
RATE = {"gpc": (0.35, 0.05), "gpc-ns": (0.45, 0.08), "coach": (0.05, 0.12)}


def episodes(
    env: str = "cartpole",
    algos: Sequence[str] = ("gpc", "gpc-ns", "coach"),
    errors: Sequence[float] = (0.0, 0.1, 0.2),
    seeds: int = 12,
    length: int = 30,
    oracles: Sequence[str] = ("gpc",),
    points: Mapping[str, Sequence[Mapping[str, float]]] | None = None,
) -> pd.DataFrame:
    """Rows of OUT/episodes: learning curves that rise more slowly with errors; `points` by algorithm for a grid."""
    idle, best = LEVELS[env]
    runs, drawn = [], []
    for algo, oracle, error, seed in _cells(algos, oracles, errors, seeds):
        for point in (points or {}).get(algo, [{}]):
            random = np.random.default_rng([seed, len(algo), int(100 * error)])
            shift = sum(abs(np.log10(value / 0.2)) for value in point.values())
            speed = SPEED[algo] * (1 - 2 * error) * np.exp(-shift) * random.uniform(0.6, 1.4)
            episode = np.arange(1, length + 1)
            progress = (1 - np.exp(-speed * episode)) + np.random.default_rng(
                [seed, int(1e6 * sum(point.values()))]
            ).normal(0, 0.08, length)
            runs.append(
                (env, algo, oracle, error, seed, *(point.get(name, np.nan) for name in _names(points)))
            )
            drawn.append(
                (
                    episode,
                    idle + (best - idle) * progress.clip(0, 1),
                    random.poisson(20 * np.exp(-speed * episode)),
                    random.uniform(0.05, 0.4, length),
                    random.binomial(200, 0.02, length),
                )
            )
    frame = _each_run(runs, points, [length] * len(runs))
    episode, returns, used, rate, clipped = map(np.concatenate, zip(*drawn, strict=True))
    size = pd.array(np.where(frame["algo"] == "coach", None, 9), dtype="Int32")
    made = frame.assign(**{
        "episode": episode.astype(np.int32),
        "return": returns,
        "length": np.int32(200),
        "corrections": used.astype(np.int32),
        "mean_rate": rate,
        "asked": np.int32(10),
        "chance": 0.05,
        "policy_points": size,
        "human_points": size.copy(),
        "clipped": clipped.astype(np.int32),
        "full": np.int32(0),
        "status": "ok",
    })  # fmt: skip
    return _points_last(made, points)


def corrections(
    algos: Sequence[str] = ("gpc", "gpc-ns", "coach"),
    errors: Sequence[float] = (0.0, 0.1, 0.2),
    seeds: int = 12,
    oracles: Sequence[str] = ("gpc",),
    points: Mapping[str, Sequence[Mapping[str, float]]] | None = None,
) -> pd.DataFrame:
    """Rows of OUT/corrections: rates that fall for GPC and rise for COACH, of 60 to 200 corrections a cell."""
    runs, numbers, drawn = [], [], []
    for algo, oracle, error, seed in _cells(algos, oracles, errors, seeds):
        for point in (points or {}).get(algo, [{}]):
            random = np.random.default_rng([seed, len(algo), int(100 * error), 1])
            number = int(random.integers(60, 200))
            start, end = RATE[algo]
            decay = np.exp(-np.arange(number) / (30 * (1 + 5 * error)))
            sigma = np.full(number, np.nan) if algo == "coach" else random.uniform(0, 0.1, number)
            runs.append(
                ("cartpole", algo, oracle, error, seed, *(point.get(name, np.nan) for name in _names(points)))
            )
            numbers.append(number)
            drawn.append(
                (
                    np.arange(number),
                    end + (start - end) * decay * random.uniform(0.5, 1.5, number),
                    sigma,
                )
            )
    place, rate, sigma = map(np.concatenate, zip(*drawn, strict=True))
    made = _each_run(runs, points, numbers).assign(
        episode=1 + place // 20,
        step=place % 20,
        action_dim=0,
        rate=rate,
        sigma_policy=sigma,
        sigma_human=sigma,
        appended=True,
        replaced=False,
        full=False,
    )
    return _points_last(made, points)


def manifest(frame: pd.DataFrame, varying: Sequence[str] = (), **changes: Any) -> dict[str, Any]:
    """OUT/manifest.json for these episodes."""
    env = str(frame["env"].iloc[0])
    idle, best = LEVELS[env]
    settings = {name: sorted(set(frame[name].dropna())) for name in varying}
    cells = frame.drop_duplicates(["algo", "oracle", "error", "seed", *varying])
    return {
        "format": 2,
        "specification": {
            "env": env,
            "algo": [algo for algo in SPEED if algo in set(frame["algo"])],
            "error": sorted(set(frame["error"])),
            "seeds": int(max(frame["seed"])) + 1,
            "episodes": int(max(frame["episode"])),
            "oracle": list(dict.fromkeys(frame["oracle"])),
            "delta": settings.pop("delta", [0.05]),
            "rate": settings.pop("rate", [0.05]),
            "rate_schedule": [],
            "sparsify": True,
            "on_full": "error",
            "max_capacity": 1024,
            "hyperparameters": settings,
        },
        "hash": "0123456789ab",
        "varying": list(varying),
        "baselines": {
            "idle": {"mean": idle, "std": 12.0, "n": 100},
            "oracles": {
                name: {"mean": best, "std": 0.0 if env == "cartpole" else 95.0, "n": 100}
                for name in dict.fromkeys(frame["oracle"])
            },
        },
        "versions": {"gpcjax": "0.1.0", "jax": "0.10.0", "python": "3.11.7", "numpy": "2.4.6"},
        "machine": {"processor": "x86_64", "cores": 2, "system": "Linux 6.1"},
        "cells": len(cells),
        "wall_time_s": 83.2,
        "compile_time_s": 9.1,
        "env_steps": 41_000_000,
        "env_steps_per_s": 493_000.0,
        "jobs": 2,
        "complete": True,
        **changes,
    }


def length_scale_grid(
    policy: Sequence[float] = (0.1, 0.2, 0.4, 0.8), human: Sequence[float] = (0.1, 0.2, 0.5)
):
    """`points` for both length-scales, for GPC and GPC-NS; COACH has none."""
    grid = [{"policy_length_scale": p, "human_length_scale": h} for p in policy for h in human]
    return {"gpc": grid, "gpc-ns": grid}


def write(out: Path, frame: pd.DataFrame, rows: pd.DataFrame, description: Mapping[str, Any]) -> Path:
    """The store on disk, of format 2, in two parts."""
    for name, table in (("episodes", frame), ("corrections", rows)):
        (out / name).mkdir(parents=True)
        half = table["seed"] < frame["seed"].nunique() // 2  # a run is in one part
        table[half].to_parquet(out / name / "0.parquet", index=False)
        table[~half].to_parquet(out / name / "1.parquet", index=False)
    specification = description["specification"]
    (out / "manifest.json").write_text(json.dumps({**description, "hash": hash_of(specification)}))
    return out


def _each_run(
    runs: Sequence[tuple[Any, ...]],
    points: Mapping[str, Sequence[Mapping[str, float]]] | None,
    lengths: Sequence[int],
) -> pd.DataFrame:
    """What is the same in all rows of a run, in as many rows as that has."""
    frame = pd.DataFrame(runs, columns=["env", "algo", "oracle", "error", "seed", *_names(points)])
    return frame.loc[frame.index.repeat(lengths)].reset_index(drop=True)


def _points_last(
    frame: pd.DataFrame, points: Mapping[str, Sequence[Mapping[str, float]]] | None
) -> pd.DataFrame:
    names = _names(points)
    return frame[[*frame.columns.drop(names), *names]]


def _cells(algos: Sequence[str], oracles: Sequence[str], errors: Sequence[float], seeds: int):
    return [(a, o, e, s) for a in algos for o in oracles for e in errors for s in range(seeds)]


def _names(points: Mapping[str, Sequence[Mapping[str, float]]] | None) -> list[str]:
    return list(dict.fromkeys(name for grid in (points or {}).values() for point in grid for name in point))
