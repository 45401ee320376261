"""From what was counted to the files of a report: the slow part of it, with all that it imports."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd

from gpcjax.report import content, html
from gpcjax.report.drawn import PAGE
from gpcjax.report.figures import curves, grids, style
from gpcjax.report.figures.painted import painted
from gpcjax.report.files import write_files
from gpcjax.report.summary import Summary

_MEND = "make room and give the right to write, or report on a copy"


Written = dict[str, bytes | str]
"""The content of files by their names."""


def write(
    out: Path,
    summary: Summary,
    corrections: pd.DataFrame,
    head: Callable[[Written], str] = lambda files: "",
) -> Summary:
    """Draws the figures of a summary and writes its files into `out`; the page comes last.

    `head` gives a line of the page's head, from the files beside it.

    Raises:
        UserError: a file cannot be written.
    """
    found = {
        "curves": curves.learning_curves(summary),
        "rates": curves.learning_rates(summary, corrections),
        "heatmap": grids.final_returns(summary),
    }
    files: Written = {
        "summary.csv": summary.table().to_csv(index=False),
        "differences.csv": summary.difference_table().to_csv(index=False),
    }
    drawings = {name: drawing for name, drawing in found.items() if drawing is not None}
    pictures = []
    images = painted([drawing.figure for drawing in drawings.values()])
    for (name, drawing), image in zip(drawings.items(), images, strict=True):
        files |= {f"{name}.{kind}": content for kind, content in image.files.items()}
        pictures.append(style.pictured(drawing, svg=image.svg))
    page = content.document(summary, pictures)
    files[PAGE] = html.render(page, head(files))
    return replace(summary, files=write_files(out, files, _MEND))
