"""Draws docs/tuning_mll.png, and prints its numbers: what settings by marginal likelihood do, on seeds of their own.

    python docs/tuning_experiment.py FOLDER

FOLDER holds the run folders of docs/tuning.md: TASK-usual, TASK-LEARNER-lengths and so on. Pairs that are not there are
left out.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np

import gpcjax
from gpcjax.report.statistics import Interval, Scores, paired_difference
from gpcjax.sweep.manifest import is_complete

LAST = 5
"""Episodes of the final return, as in reports."""

PAIRS = (
    ("cartpole", "gpc", "gpc-lengths", "usual", "GPC, length-scales"),
    ("cartpole", "gpc", "gpc-all", "usual", "GPC, all"),
    ("cartpole", "gpc-ns", "gpc-ns-lengths", "usual", "GPC-NS, length-scales"),
    ("cartpole", "gpc-ns", "gpc-ns-all", "usual", "GPC-NS, all"),
    ("cartpole", "gpc", "gpc-long-lengths", "gpc-long", "GPC from l x 8, length-scales"),
    ("cartpole", "gpc", "gpc-short-lengths", "gpc-short", "GPC from l / 8, length-scales"),
    ("mountaincar", "gpc", "gpc-lengths", "usual", "GPC, length-scales"),
    ("mountaincar", "gpc", "gpc-all", "usual", "GPC, all"),
    ("mountaincar", "gpc-ns", "gpc-ns-lengths", "usual", "GPC-NS, length-scales"),
    ("pendulum", "gpc", "gpc-lengths", "usual", "GPC, length-scales"),
    ("pendulum", "gpc", "gpc-all", "usual", "GPC, all"),
    ("pendulum", "gpc-ns", "gpc-ns-lengths", "usual", "GPC-NS, length-scales"),
)
"""Task, learner, the folders of what is compared (without the task), and what it is called."""


class Row(NamedTuple):
    """A paired comparison: tuned minus before, of the same seeds."""

    task: str
    label: str
    area: Interval
    final: Interval
    pairs: int


def scores(folder: Path, algo: str) -> dict[str, Scores]:
    """Area and final return of each seed of a learner."""
    rows = gpcjax.load(folder)
    returns = (
        rows.loc[rows["algo"] == algo].pivot(index="seed", columns="episode", values="return").sort_index()
    )
    seeds, values = returns.index.to_numpy(), returns.to_numpy()
    return {"area": Scores(seeds, values.mean(1)), "final": Scores(seeds, values[:, -LAST:].mean(1))}


def compared(below: Path) -> list[Row]:
    """The comparisons of which both folders are there."""
    rows = []
    for task, algo, after, before, label in PAIRS:
        folders = [below / f"{task}-{name}" for name in (after, before)]
        if not all(map(is_complete, folders)):
            continue
        tuned, usual = (scores(folder, algo) for folder in folders)
        area, pairs = paired_difference(tuned["area"], usual["area"])
        rows.append(Row(task, label, area, paired_difference(tuned["final"], usual["final"])[0], pairs))
        told = (
            f"{name} {each.estimate:.4g} [{each.lower:.4g}, {each.upper:.4g}]"
            for name, each in (("area", area), ("final return", rows[-1].final))
        )
        print(task, label, *told, f"{pairs} pairs", sep="\t")
    return rows


def draw(rows: list[Row], file: Path) -> None:
    """A line for each comparison and an axis for each task, as returns have units of their own."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    tasks = list(dict.fromkeys(row.task for row in rows))
    heights = [sum(row.task == task for row in rows) for task in tasks]
    figure, axes = pyplot.subplots(
        len(tasks), 1, squeeze=False, height_ratios=heights, layout="constrained",
        figsize=(6.5, 0.9 * len(tasks) + 0.4 * sum(heights)),
    )  # fmt: skip
    for axis, task in zip(axes[:, 0], tasks, strict=True):
        mine = [row for row in rows if row.task == task]
        for shift, name, colour in ((-0.12, "area", "#0072B2"), (0.12, "final", "#D55E00")):
            found = [getattr(row, name) for row in mine]
            middle = np.array([each.estimate for each in found])
            ends = np.array([(each.lower, each.upper) for each in found]).T
            places = np.arange(len(mine)) + shift
            label = {"area": "area", "final": "final return"}[name]
            axis.hlines(places, *ends, color=colour, linewidth=2)
            axis.plot(middle, places, "o", color=colour, label=label)
        axis.axvline(0, color="0.6", linewidth=1)
        axis.set(title=task, yticks=range(len(mine)), yticklabels=[row.label for row in mine])
        axis.set_ylim(len(mine) - 0.5, -0.5)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    axes[-1, 0].set_xlabel("tuned minus before, paired by seed, with 95% intervals")
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    draw(compared(Path(sys.argv[1])), Path(__file__).with_name("tuning_mll.png"))
