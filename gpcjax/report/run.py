"""From a store to its report: read, count, draw, write. Every file is replaced as a whole.

A report needs no lock: it reads what is whole of a store that a sweep is writing to, and the sweep draws it again at
its end.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from gpcjax.allowed import SWITCH, Numbers, checked, checked_path
from gpcjax.errors import UserError
from gpcjax.report import html
from gpcjax.report.drawn import Mark
from gpcjax.report.groups import gather
from gpcjax.report.summary import Summary, summarise
from gpcjax.sweep.chosen import corrections_of
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.layout import tell
from gpcjax.sweep.runfolder import check_report, check_writable

SECONDS = Numbers(low=0, high=86400, whole=True)


def draw(out: Any, anew: Any = True, refresh: Any = 0) -> Summary:
    """Read the store in `out` and write its tables, figures and report there again.

    What is damaged or foreign in the store is left out, with a line on stderr.

    Args:
        out: the run folder.
        anew: draw also what was drawn before of the same rows, and lies there as it was written. True or False.
        refresh: seconds after which a browser that shows the page loads it anew; 0 for never.

    Returns:
        The numbers of the report (`rows`, `differences`), and the `files` that were written.

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
    mark = Mark.made_of(out, manifest, summary)
    if not checked("anew", anew, bool, SWITCH) and (files := mark.files(out)):
        return replace(summary, files=files)
    # Not above: matplotlib takes longer to import than all else here to compute.
    from gpcjax.report.figures.curves import shown_rates
    from gpcjax.report.figures.drawing import write

    chosen = shown_rates(summary)
    corrections = corrections_of(out, manifest, chosen, places.without(chosen))
    if seconds := checked("refresh", refresh, int, SECONDS):
        return write(out, summary, corrections, lambda files: html.refreshing(seconds))
    return write(out, summary, corrections, mark.of)


def draw_frames(
    out: Path, episodes: pd.DataFrame, corrections: pd.DataFrame, manifest: Mapping[str, Any]
) -> Summary:
    """The same for rows and a manifest that were read.

    Raises:
        UserError: there is no episode, or a file cannot be written.
    """
    from gpcjax.report.figures.drawing import write

    return write(out, summarise(gather(episodes, manifest)), corrections)
