"""From a store to its report: read, count, draw, write. Every file is replaced as a whole.

A report needs no lock: it reads what is whole of a store that a sweep is writing to, and the sweep draws it again at
its end.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from gpcjax.allowed import checked_path
from gpcjax.errors import UserError
from gpcjax.report import content, curves, grids, html, style
from gpcjax.report.groups import gather
from gpcjax.report.summary import Summary, summarise
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.chosen import corrections_of
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.layout import tell
from gpcjax.sweep.runfolder import check_report, check_writable

_MEND = "make room and give the right to write, or report on a copy"


def draw(out: Any) -> Summary:
    """Read the store in `out` and write its tables, figures and report there again.

    What is damaged or foreign in the store is left out, with a line on stderr.

    Raises:
        UserError: `out` holds no store, no episode yet or none that is whole, or nothing can be written there.
    """
    out = checked_path("out", out)
    check_report(out)
    check_writable(out)
    episodes, manifest = read_counted(out, tell)
    if episodes is None:
        raise UserError("the store holds no episodes: run the sweep first")
    study, places = gather(episodes, manifest), episodes.places
    del episodes  # what is drawn is in the study
    summary = summarise(study)
    chosen = curves.shown_rates(summary)
    return _written(out, summary, corrections_of(out, manifest, chosen, places.without(chosen)))


def draw_frames(
    out: Path, episodes: pd.DataFrame, corrections: pd.DataFrame, manifest: Mapping[str, Any]
) -> Summary:
    """The same for rows and a manifest that were read.

    Raises:
        UserError: there is no episode, or a file cannot be written.
    """
    return _written(out, summarise(gather(episodes, manifest)), corrections)


def _written(out: Path, summary: Summary, corrections: pd.DataFrame) -> Summary:
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
            pictures.append(style.pictured(drawing))
    files["report.html"] = html.render(content.document(summary, pictures))
    for name, written in files.items():
        try:
            write_atomic(out / name, written)
        except OSError as error:
            raise UserError(f"{out / name}: cannot be written ({error.strerror}), {_MEND}") from None
    return replace(summary, files=tuple(out / name for name in files))
