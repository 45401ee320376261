"""Synthetic studies with the numbers that they had when every group was counted for itself.

`python -m tests.report.golden` writes them anew, by the code as it is.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gpcjax.report.groups import gather
from gpcjax.report.summary import Summary, summarise
from tests.report import synthetic

NUMBERS = Path(__file__).with_suffix(".json")


def studies() -> Iterator[tuple[str, pd.DataFrame, dict[str, Any]]]:
    """By name: episodes, and the manifest."""
    frame = synthetic.episodes()
    yield "plain", frame, synthetic.manifest(frame)
    points = synthetic.length_scale_grid()
    frame = synthetic.episodes(points=points, errors=(0.0, 0.2), seeds=6, length=12)
    yield "grid", frame, synthetic.manifest(frame, varying=list(points["gpc"][0]))
    frame = mixed()
    yield "mixed", frame, synthetic.manifest(frame)


def mixed() -> pd.DataFrame:
    """Seeds that differ between groups, runs that stopped in both ways, runs that are not finished; two oracles."""
    frame = synthetic.episodes(
        algos=("gpc", "coach"), errors=(0.0, 0.1), seeds=11, oracles=("gpc", "lqr"), length=9
    )
    seed, episode, coach = frame["seed"], frame["episode"], frame["algo"] == "coach"
    frame.loc[(seed == 4) & (episode == 6), "status"] = "full"
    frame.loc[(seed == 5) & (episode == 2), "return"] = np.inf
    absent = (coach & (seed <= 2)) | ((frame["error"] == 0.1) & (seed >= 9))
    absent |= ((seed == 4) & (episode > 6)) | (coach & (seed == 7) & (episode > 3))
    return frame[~absent]


def numbers(summary: Summary) -> dict[str, Any]:
    """What is compared: both tables, and the runs that stopped, are not counted, not finished, missing."""
    return {
        "summary": _columns(summary.table()),
        "differences": _columns(summary.difference_table()),
        "runs": [summary.stopped, summary.uncounted, summary.unfinished, summary.missing],
    }


def _columns(table: pd.DataFrame) -> dict[str, list[Any]]:
    table = table.drop(columns="env")
    return {
        name: table[name].astype(object).where(table[name].notna(), None).tolist()
        for name in table.columns
        if name not in ("oracle_return", "oracle_std", "idle_return", "idle_std")
    }


if __name__ == "__main__":
    found = {name: numbers(summarise(gather(frame, manifest))) for name, frame, manifest in studies()}
    NUMBERS.write_text(json.dumps(found, separators=(",", ":")) + "\n")
