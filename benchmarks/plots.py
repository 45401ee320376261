"""The figure of `make bench`: steps per second of gpcjax against what they depend on."""

from pathlib import Path
from statistics import median
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from gpcjax.report.figures.style import publication

PANELS = {
    "lanes": "lanes (runs to do, one core)",
    "capacity": "capacity of one block (points)",
    "rate": "advice rate (chance at a step)",
    "cores": "cores (a process on each)",
}


def draw(record: dict[str, Any], path: Path) -> None:
    """Draws `record["curves"]`, medians with the range of the repetitions, as a PNG."""
    with publication():
        figure, axes = plt.subplots(2, 2, figsize=(7, 5), layout="constrained")
        for axis, (name, label) in zip(axes.flat, PANELS.items(), strict=True):
            _panel(axis, name, label, record["curves"][name])
        episodes = record["curves"]["case"]["episodes"]
        figure.suptitle(
            f"GPC on cart-pole, runs of {episodes} episodes: environment steps per second, median and range",
            fontsize=9,
        )
        figure.savefig(path, dpi=150)
        plt.close(figure)


def _panel(axis: Axes, name: str, label: str, curve: dict[str, list[dict[str, Any]]]) -> None:
    points = [float(point) for point in curve]
    speeds = [[each["env_steps"] / each["seconds"] for each in measured] for measured in curve.values()]
    middle = [median(values) for values in speeds]
    below = [m - min(values) for m, values in zip(middle, speeds, strict=True)]
    above = [max(values) - m for m, values in zip(middle, speeds, strict=True)]
    axis.errorbar(points, middle, yerr=(below, above), marker="o", markersize=4, capsize=2, linewidth=1.2)
    axis.set_xlabel(label)
    axis.set_ylabel("steps/s")
    axis.grid(alpha=0.3)
    if name == "cores":
        axis.set_xticks(points)
        axis.set_xlim(0.5, max(points) + 0.5)
        axis.set_ylim(0, None)
    else:
        axis.set_xscale("log", base=10 if name == "rate" else 2)
        axis.set_yscale("log")
        labelled = points[:: 2 if len(points) > 8 else 1]
        axis.set_xticks(labelled, [f"{point:g}" for point in labelled])
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_minor_formatter(NullFormatter())
    axis.yaxis.set_major_formatter(FuncFormatter(_short))


def _short(value: float, _: int) -> str:
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:g} {letter}"
    return f"{value:g}"
