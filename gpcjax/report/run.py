"""From a store to its report: read, count, draw, write. Every file is replaced as a whole."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from gpcjax.report import curves, grids, html, style
from gpcjax.report.groups import gather
from gpcjax.report.summary import Summary, summarise
from gpcjax.sweep import store
from gpcjax.sweep.atomic import write_atomic


def draw(out: str | os.PathLike[str]) -> Summary:
    """Read the store in `out` and write its tables, figures and report there again.

    Raises:
        UserError: `out` holds no store, or no episode yet.
    """
    out = Path(out)
    return draw_frames(out, store.read_episodes(out), store.read_corrections(out), store.read_manifest(out))


def draw_frames(
    out: Path, episodes: pd.DataFrame, corrections: pd.DataFrame, manifest: Mapping[str, Any]
) -> Summary:
    """The same for rows and a manifest that were read.

    Raises:
        UserError: there is no episode.
    """
    summary = summarise(gather(episodes, manifest))
    drawings = {
        "curves": curves.learning_curves(summary),
        "rates": curves.learning_rates(summary, corrections),
        "heatmap": grids.final_returns(summary),
    }
    files = {
        "summary.csv": summary.table().to_csv(index=False),
        "differences.csv": summary.difference_table().to_csv(index=False),
    }
    pictures = []
    for name, drawing in drawings.items():
        if drawing is not None:
            files |= {f"{name}.{kind}": style.image(drawing.figure, kind) for kind in ("png", "pdf")}
            pictures.append(html.pictured(drawing))
    files["report.html"] = html.page(summary, pictures)
    for name, content in files.items():
        write_atomic(out / name, content)
    return replace(summary, files=tuple(out / name for name in files))
