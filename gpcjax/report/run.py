"""From a store to its report: read, count, draw, write. Every file is replaced as a whole."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from gpcjax.allowed import checked_path
from gpcjax.report import curves, grids, html, style, words
from gpcjax.report.groups import gather
from gpcjax.report.summary import Summary, summarise
from gpcjax.sweep import store
from gpcjax.sweep.atomic import write_atomic


def draw(out: Any) -> Summary:
    """Read the store in `out` and write its tables, figures and report there again.

    Raises:
        UserError: `out` holds no store, or no episode yet.
    """
    out = checked_path("out", out)
    return draw_frames(out, store.read_episodes(out), store.read_corrections(out), store.read_manifest(out))


def draw_frames(
    out: Path, episodes: pd.DataFrame, corrections: pd.DataFrame, manifest: Mapping[str, Any]
) -> Summary:
    """The same for rows and a manifest that were read.

    Raises:
        UserError: there is no episode.
    """
    summary = summarise(gather(episodes, manifest))
    figures = {
        "curves": curves.learning_curves(summary),
        "rates": curves.learning_rates(summary, corrections),
        "heatmap": grids.final_returns(summary),
    }
    files = {
        "summary.csv": summary.table().to_csv(index=False),
        "differences.csv": summary.difference_table().to_csv(index=False),
    }
    pictures = []
    for name, figure in figures.items():
        if figure is not None:
            files |= {f"{name}.{kind}": style.image(figure, kind) for kind in ("png", "pdf")}
            pictures.append(_picture(name, figure, summary))
    files["report.html"] = html.page(summary, pictures)
    for name, content in files.items():
        write_atomic(out / name, content)
    return replace(summary, files=tuple(out / name for name in files))


def _picture(name: str, figure: Figure, summary: Summary) -> html.Picture:
    study = summary.study
    runs = sorted({group.runs for group in study.groups if group.runs})
    number = "no run" if not runs else f"{runs[0]} to {runs[-1]} runs" if len(runs) > 1 else f"{runs[0]} runs"
    of_grid = " Of a grid the point with the highest final return." if study.varying else ""
    thin = " Thin lines are the other points." if study.varying else ""
    alternative, caption = {
        "curves": (
            "Learning curves",
            f"Learning curves in {study.env} ({number} a line). Strong lines: walking mean of {curves.WINDOW} episodes "
            f"of the mean over runs, with its 95% interval; faint lines: the mean itself.{of_grid}{thin}",
        ),
        "rates": (
            "Learning rates",
            f"Learning rate of the first {curves.FIRST_CORRECTIONS} corrections: mean over runs with 95% interval. A "
            f"line ends where fewer than half of the runs have so many corrections.{of_grid}",
        ),
        "heatmap": (
            "Final return over the grid",
            "Final return over "
            + " and ".join(map(words.meaning, study.varying))
            + ": interquartile mean over runs. "
            "The star is the best point; points that are not significantly worse on the same seeds are tied with it."
            + (
                " A field shows the best over the settings that are not on its axes."
                if len(study.varying) > 2
                else ""
            ),
        ),
    }[name]
    return html.Picture(style.image(figure, "svg"), figure.get_figwidth(), alternative, caption)
