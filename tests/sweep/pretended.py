"""Rows that no engine made, and workers that hand them in. Loads no jax."""

import numpy as np

from gpcjax.sweep.executors import Totals
from gpcjax.sweep.keeping import KeptRow
from gpcjax.sweep.packing import packed
from gpcjax.sweep.rows import CellRows

BASELINE = {"mean": 20.0, "std": 1.0, "n": 100}


def rows(cell, episodes=3, corrections=2, status="ok", kept=False) -> CellRows:
    """Numbers that tell the cell and the episode."""
    mark = 10.0 * cell.seed + 100 * cell.error
    counts = np.arange(episodes, dtype=np.int32)
    integers = {
        name: counts + i
        for i, name in enumerate(("length", "policy_points", "human_points", "clipped", "full"), start=1)
    }
    measured = {"returns": mark + counts, "corrections": counts, "rate_sum": 0.5 * counts, **integers}
    measured |= {"asked": 2 * counts, "chance_sum": 0.25 * counts}
    sigmas = [np.nan, np.nan] if cell.algo == "coach" else [0.2, 0.3]
    log = {
        "moments": np.array([[0, step, 0] for step in range(corrections)], np.int32).reshape(-1, 3),
        "values": np.array([[mark, *sigmas]] * corrections).reshape(-1, 3),
        "outcome": np.array([[True, False, False]] * corrections, bool).reshape(-1, 3),
    }
    told = {"kind": "learner", "algo": cell.algo, "obs_size": 4, "action_size": 1}
    card, arrays = packed(told, {"mark": np.full(20, mark), "seed": np.array(cell.seed)})
    learned = (KeptRow(episodes, mark + episodes - 1, "state", card, arrays),) if kept else ()
    return CellRows(cell, counts + 1, ["ok"] * (episodes - 1) + [status], measured, log, kept=learned)


def hand_out(desk):
    """Hands all that this desk has to its last worker; gives what takes that worker's rows, baselines and progress."""
    worker = desk.workers - 1
    while (answer := desk.answer(worker, ("ready",))) != ("stop",):
        while answer[0] == "program" and desk.answer(worker, ("next",)) != ("cells", []):
            pass
    return (
        lambda rows: desk.answer(worker, ("rows", rows)),
        lambda name, numbers: desk.answer(worker, ("baseline", name, numbers)),
        lambda totals: desk.answer(worker, ("progress", totals)),
    )


class Pretended:
    """In place of `Processes`: hands in rows of all cells, or of some and then fails."""

    def __init__(self, fails_after=None, error=KeyboardInterrupt, kept=False):
        self.fails_after, self.error, self.calls, self.kept = fails_after, error, [], kept

    def __call__(self, jobs):
        self.jobs = jobs
        return self

    def run(self, desk):
        cells, baselines = list(desk.cells), list(desk.baselines)
        self.calls.append((cells, baselines, self.jobs))
        self._work(cells, baselines, *hand_out(desk))

    def _work(self, cells, baselines, on_rows, on_baseline, on_progress):
        for _, name in baselines:
            on_baseline(name, BASELINE)
        for index, cell in enumerate(cells):
            if index == self.fails_after:
                raise self.error
            on_rows(rows(cell, kept=self.kept))
            on_progress(Totals(env_steps=10 * (index + 1), episodes=3 * (index + 1), compile_seconds=2.0))
