"""Runs whose return follows from their settings by a formula: a search's surroundings without an engine."""

import dataclasses
import math

from tests.sweep.pretended import BASELINE, Pretended, rows

PEAK = {"policy_length_scale": 0.5, "human_length_scale": 2.0}


def height(point):
    """Highest at `PEAK`, falling with the square of each factor's logarithm."""
    return 100.0 - 10.0 * sum(math.log(value / PEAK[name]) ** 2 for name, value in point.items())


class Landscape(Pretended):
    """Workers that hand in such rows; `fails_after` so many cells of all sweeps together they raise `error`."""

    def __init__(self, fails_after=None, error=KeyboardInterrupt):
        super().__init__(error=error)
        self.jobs, self.left, self.cells = 1, fails_after, []

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def _work(self, cells, baselines, on_rows, on_baseline, on_progress):
        for _, name in baselines:
            on_baseline(name, BASELINE)
        for cell in cells:
            if self.left == 0:
                raise self.error
            self.left = None if self.left is None else self.left - 1
            self.cells.append(cell)
            on_rows(scored(cell))


def _searched(cell):
    """Its settings, or a worse one than the peak where it has none."""
    return {name: value for name, value in cell.hyperparameters if name in PEAK} or {
        "policy_length_scale": 2.0
    }


def scored(cell):
    """The rows of a cell: the same in each episode, a little more for a higher seed."""
    made = rows(cell, episodes=cell.episodes)
    returns = 0 * made.episodes["returns"] + height(_searched(cell))
    corrections = 0 * made.episodes["corrections"] + round(10 * _searched(cell).get("policy_length_scale", 2))
    return dataclasses.replace(
        made, episodes=made.episodes | {"returns": returns + 0.01 * cell.seed, "corrections": corrections}
    )
