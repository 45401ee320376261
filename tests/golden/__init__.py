"""Golden rows: small sweeps of every learner on every task, whose rows are kept here with their bits.

    python -m tests.golden check [CASE ...]      what differs from what is kept, exit status 1 if anything does
    python -m tests.golden store [CASE ...]      keep the rows of this version; say in the commit why they differ

Last bits depend on the processor and on the versions of what computes (`gpcjax.sweep.machine`), which are kept too: on
another kind of machine nothing can be compared.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from gpcjax.sweep import machine
from gpcjax.sweep.reading import read_corrections, read_episodes
from gpcjax.sweep.run import sweep

CASES: dict[str, dict[str, Any]] = {
    "cartpole": {"env": "cartpole", "error": [0, 0.2], "seeds": 3, "episodes": 6},
    "pendulum": {"env": "pendulum", "error": [0, 0.2], "seeds": 3, "episodes": 6},
    "lander": {"env": "lunarlander", "error": 0.1, "seeds": 2, "episodes": 3},
    "active": {
        "env": "cartpole",
        "algo": ["gpc", "gpc-ns"],
        "active_gain": 1.0,
        "rate": 0.01,
        "error": 0.1,
        "seeds": 3,
        "episodes": 4,
    },
    "schedule": {
        "env": "cartpole",
        "algo": ["gpc", "coach"],
        "rate_schedule": [0.1, 0.05, 0.02],
        "seeds": 3,
        "episodes": 4,
    },
    "grid": {
        "env": "pendulum",
        "algo": ["gpc", "gpc-ns"],
        "policy_length_scale": [0.3, 0.7],
        "human_length_scale": [0.1, 0.4],
        "oracle": "energy",
        "seeds": 2,
        "episodes": 4,
    },
    "full": {
        "env": "cartpole",
        "algo": ["gpc", "gpc-ns"],
        "on_full": "replace-nearest",
        "max_capacity": 24,
        "delta": 0.01,
        "seeds": 3,
        "episodes": 4,
    },
    "plain": {
        "env": "cartpole",
        "algo": "gpc",
        "sparsify": False,
        "static_rate": 0.04,
        "seeds": 3,
        "episodes": 4,
    },
    "swept": {
        "env": "cartpole",
        "algo": ["gpc", "coach"],
        "error": [0.0, 0.2],
        "seeds": 2,
        "episodes": 3,
        "oracle": "lqr",
        "rate": 0.2,
        "max_capacity": 48,
        "on_full": "replace-nearest",
    },
}
"""Settings of each sweep: every learner on every task, and each variant that compiles to a program of its own.

The last is what tests/sweep/test_sweeps.py sweeps anyway: there its rows are compared each time.
"""

ROWS = Path(__file__).parent / "rows"
MADE_BY = ROWS / "made_by.json"
_TABLES = {"episodes": read_episodes, "corrections": read_corrections}


def store(case: str, folder: Path) -> None:
    """Runs a case in `folder` and keeps its rows, and what made them."""
    out = sweep(folder / case, jobs=2, **CASES[case])
    for table, read in _TABLES.items():
        read(out).to_parquet(ROWS / f"{case}-{table}.parquet", index=False, compression="zstd")
    MADE_BY.write_text(json.dumps(_here(out), indent=1) + "\n")


def check(case: str, folder: Path, jobs: int = 2, algo: str = "", seeds: int = 0) -> Iterator[str]:
    """Runs a case in `folder`, in so many processes; a line for each thing that is not as it is kept.

    Columns that are kept must be there with the same bits; a version may add others. With `algo` and `seeds` only
    that learner's runs and so many of them: rows of a run depend on no other.
    """
    fewer: dict[str, Any] = ({"algo": algo} if algo else {}) | ({"seeds": seeds} if seeds else {})
    yield from differences(sweep(folder / case, jobs=jobs, **CASES[case] | fewer), case, algo, seeds)


def differences(out: Path, case: str, algo: str = "", seeds: int = 0) -> Iterator[str]:
    """A line for each thing in the run folder `out` of a case that is not as it is kept, as `check` gives them."""
    for table, read in _TABLES.items():
        kept, rows = pd.read_parquet(ROWS / f"{case}-{table}.parquet"), read(out)
        if algo:
            kept = kept[kept["algo"] == algo]
        if seeds:
            kept = kept[kept["seed"] < seeds]
        kept = kept.reset_index(drop=True)
        if len(rows) != len(kept):
            yield f"{case}: {len(rows)} {table}, {len(kept)} are kept"
            continue
        for name in kept.columns:
            if name not in rows:
                yield f"{case}: {table} have no column {name}"
            elif not rows[name].equals(kept[name].astype(rows[name].dtype)):
                same = (rows[name] == kept[name]) | (rows[name].isna() & kept[name].isna())
                yield f"{case}: {table}, {name} differs in {(~same).sum()} of {len(kept)} rows"


def incomparable(out: Path) -> str:
    """Why the rows of the run folder `out` may have other last bits than those that are kept; empty if they may not."""
    made_by, here = json.loads(MADE_BY.read_text()), _here(out)
    return ", ".join(name for name in made_by if made_by[name] != here.get(name))


def _here(out: Path) -> dict[str, str]:
    versions = json.loads((out / "manifest.json").read_text())["versions"]
    return {
        **{name: version for name, version in versions.items() if name != "gpcjax"},
        "machine": machine.kind_of(machine.describe()),
    }
