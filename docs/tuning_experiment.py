"""Does a tuned kernel teach better? The experiment of docs/tuning.md: its runs, its numbers, docs/tuning_mll.png.

    python docs/tuning_experiment.py FOLDER [--run] [--jobs N] [CASE...]

In each case runs of a learner on a task are kept, on seeds from 1000 on; kernels are fitted by marginal likelihood to
what these had learned; and runs on other seeds, with what was fitted and without it, are compared one by one. `--run`
runs what FOLDER does not hold yet of the cases that are named, or of all. What is there takes the place of its lines in
docs/tuning_mll.csv, and all of these are drawn.
"""

import argparse
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import pandas as pd

import gpcjax
from gpcjax.report import words
from gpcjax.report.statistics import Interval, Scores, paired_difference
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.manifest import is_complete
from gpcjax.sweep.seeds import Seeds
from gpcjax.tune.flags import TAKEN

LAST = 5
"""Episodes of the final return, as in reports."""

TAKES = ("length-scales", "all")
"""What is taken of a fit."""

RECORDED, FIGURE = (Path(__file__).with_name(f"tuning_mll.{kind}") for kind in ("csv", "png"))

STARTS, POINTS, SETTINGS = 3, 128, "settings.json"
"""Of a fit: from how many sets of numbers, how many points of a dictionary, and the file of what it came to."""

LANDER = {"oracle": "heuristic", "rate": 0.05}
"""As in the thesis's Figure 5.5."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A learner on a task, and with what its runs begin.

    | Field     | Meaning                                                          |
    |-----------|------------------------------------------------------------------|
    | `task`    | the task                                                         |
    | `algo`    | the learner                                                      |
    | `seeds`   | of the runs that are compared: 0 to `seeds` - 1                   |
    | `fitted`  | of the runs that are fitted: 1000 to 999 + `fitted`               |
    | `takes`   | what is taken of the fit, names of `TAKES`                       |
    | `begin`   | what the kernels begin with, in the case's name; "" for the usual |
    | `kernels` | the settings of these kernels, where they are not the usual ones  |
    | `more`    | further settings of all runs                                     |
    """

    task: str
    algo: str
    seeds: int = 100
    fitted: int = 12
    takes: tuple[str, ...] = TAKES
    begin: str = ""
    kernels: dict[str, Any] = dataclasses.field(default_factory=dict)
    more: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of its folders."""
        return "-".join(filter(None, (self.task, self.algo, self.begin)))

    @property
    def settings(self) -> dict[str, Any]:
        """Of the runs before anything is fitted."""
        return {"env": self.task, "algo": self.algo, "error": 0.1, **self.more, **self.kernels}

    def label(self, take: str) -> str:
        """As the figure has it."""
        begin = {"": "", "long": ", 8 l", "short": ", l / 8"}[self.begin]
        return f"{words.algorithm(self.algo)}{begin}: {take}"


def scaled(factor: float) -> dict[str, float]:
    """The length-scales of the cart-pole's GPC, all of them longer or shorter."""
    learner = gpcjax.make_learner("gpc", "cartpole")
    models = {"policy": learner.policy, "human": learner.human}
    return {
        f"{name}_length_scale": factor * float(model.kernel.length_scale) for name, model in models.items()
    }


def cases() -> tuple[Case, ...]:
    """All of the experiment."""
    alone, bad = ("length-scales",), {"fitted": 10, "takes": ("length-scales",)}
    return (
        Case("cartpole", "gpc"),
        Case("cartpole", "gpc-ns", seeds=40),
        Case("cartpole", "gpc", begin="long", kernels=scaled(8.0), **bad),
        Case("cartpole", "gpc", begin="short", kernels=scaled(1 / 8), **bad),
        Case("mountaincar", "gpc"),
        Case("mountaincar", "gpc-ns", seeds=20),
        Case("pendulum", "gpc"),
        Case("pendulum", "gpc-ns", seeds=20),
        Case("lunarlander", "gpc", seeds=16, fitted=8, more={**LANDER, "episodes": 40}),
        Case("lunarlander", "gpc-ns", seeds=8, fitted=6, takes=alone, more={**LANDER, "episodes": 20}),
    )


def run(case: Case, below: Path, jobs: int) -> None:
    """What is missing of a case."""
    from gpcjax.tune.likelihood import by_likelihood

    kept, before = (below / f"{case.name}-{name}" for name in ("kept", "before"))
    seeds = Seeds(((0, case.seeds - 1),))
    teach = {**case.settings, "seeds": f"1000-{999 + case.fitted}"}
    gpcjax.run_sweep(out=kept, keep="states", jobs=jobs, **teach)
    gpcjax.run_sweep(out=before, seeds=case.seeds, jobs=jobs, **case.settings)
    found = below / f"{case.name}-fit"
    if not (found / SETTINGS).exists():
        fitted = by_likelihood(kept, found, take=TAKEN, seeds=seeds, starts=STARTS, points=POINTS)
        write_atomic(found / SETTINGS, json.dumps(dict(fitted.settings)))
    fit = json.loads((found / SETTINGS).read_text())
    for take in case.takes:
        taken = {name: value for name, value in fit.items() if take == "all" or is_length(name)}
        settings = {**case.settings, **taken, "seeds": case.seeds}
        gpcjax.run_sweep(out=below / f"{case.name}-{take}", jobs=jobs, **settings)


def is_length(name: str) -> bool:
    """Whether a setting is a length-scale, or what makes one of each input."""
    return name.endswith(("length_scale", "scaling"))


_NUMBERS = ("", "_lower", "_upper")
COLUMNS = [
    "task",
    "runs",
    *(f"{name}{end}" for name in ("area", "final_return") for end in _NUMBERS),
    "pairs",
]
"""Of the file of all comparisons."""


class Row(NamedTuple):
    """A paired comparison: tuned minus before, of the same seeds."""

    task: str
    label: str
    area: Interval
    final: Interval
    pairs: int


def scores(folder: Path) -> dict[str, Scores]:
    """Area and final return of each seed."""
    returns = gpcjax.load(folder).pivot(index="seed", columns="episode", values="return").sort_index()
    seeds, values = returns.index.to_numpy(), returns.to_numpy()
    return {"area": Scores(seeds, values.mean(1)), "final": Scores(seeds, values[:, -LAST:].mean(1))}


def compared(below: Path) -> list[Row]:
    """The comparisons of which both folders are complete."""
    rows = []
    for case in cases():
        for take in case.takes:
            folders = [below / f"{case.name}-{name}" for name in (take, "before")]
            if not all(map(is_complete, folders)):
                continue
            tuned, before = map(scores, folders)
            area, pairs = paired_difference(tuned["area"], before["area"])
            final, _ = paired_difference(tuned["final"], before["final"])
            if np.isnan(area.estimate):  # there is no pair of runs of which both got to their ends
                continue
            rows.append(Row(case.task, case.label(take), area, final, pairs))
    return rows


def recorded(new: Sequence[Row], file: Path) -> list[Row]:
    """The lines of the file, with these in the place of theirs; it is written anew."""
    found = {(row.task, row.label): row for row in new}
    rows = []
    for each in pd.read_csv(file).itertuples(index=False):
        task, label, *numbers, pairs = each
        old = Row(task, label, Interval(*numbers[:3]), Interval(*numbers[3:]), int(pairs))
        rows.append(found.pop((task, label), old))
    rows += found.values()
    order = [(case.task, case.label(take)) for case in cases() for take in case.takes]
    rows.sort(key=lambda row: order.index((row.task, row.label)))
    lines = [(row.task, row.label, *row.area, *row.final, row.pairs) for row in rows]
    write_atomic(file, pd.DataFrame(lines, columns=COLUMNS).to_csv(index=False, float_format="%.5g"))
    return rows


def table(rows: Sequence[Row]) -> str:
    """The comparisons, Markdown."""

    def told(each: Interval) -> str:
        return words.interval(each, words.places(each))

    lines = ["| task | learner: what was taken | area | final return | pairs |", "|---|---|---|---|---|"]
    for row in rows:
        cells = (words.task(row.task), row.label, told(row.area), told(row.final), str(row.pairs))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(rows: Sequence[Row], file: Path) -> None:
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
        labels = [f"{row.label} ({row.pairs})" for row in mine]
        axis.set(title=words.task(task), yticks=range(len(mine)), yticklabels=labels)
        axis.set_ylim(len(mine) - 0.5, -0.5)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    axes[-1, 0].set_xlabel("tuned minus before, pairs of runs in brackets, 95% intervals")
    figure.savefig(file, dpi=150)


def main() -> None:
    """What the command line asks for."""
    known = {case.name: case for case in cases()}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(known))
    parser.add_argument("--run", action="store_true", help="run what is missing of these cases, or of all")
    parser.add_argument("--jobs", type=int, default=1)
    wishes = parser.parse_intermixed_args()
    if unknown := set(wishes.cases) - set(known):
        parser.error(f"no such case: {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    for name in (wishes.cases or known) if wishes.run else ():
        run(known[name], wishes.folder, wishes.jobs)
    rows = recorded(compared(wishes.folder), RECORDED)
    print(table(rows))
    draw(rows, FIGURE)


if __name__ == "__main__":
    main()
