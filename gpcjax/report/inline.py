"""What a notebook shows of results: the numbers and figures of a report's page, without how it was all made."""

import base64
from collections.abc import Sequence
from html import escape
from itertools import takewhile
from typing import TYPE_CHECKING

from gpcjax.report import compare_page, html, tables
from gpcjax.report.document import Block, Heading, Paragraph, Warnings
from gpcjax.report.summary import ImageFile, Summary

if TYPE_CHECKING:
    from gpcjax.report.compare import Comparison

PIXELS = 800
"""Width of a figure."""


def summary_inline(summary: Summary) -> str:
    """Results and figures of a sweep."""
    lines = tables.warnings(summary)
    blocks: list[Block] = [
        *([Warnings(tuple(lines))] if lines else []),
        *tables.result_sheets(summary),
        *map(Paragraph, tables.reading(summary)),
    ]
    return html.inline(blocks, _shown([*summary.figures.values()]))


def comparison_inline(comparison: "Comparison") -> str:
    """Differences and profiles of run folders."""
    from gpcjax.report.figures import compare_figure, style

    page = compare_page.document(comparison, [style.pictured(compare_figure.drawn(comparison))])
    made = Heading("How the numbers are made")
    return html.inline(takewhile(lambda block: block != made, page.blocks))


def _shown(figures: Sequence[ImageFile]) -> str:
    """Files as parts of the page; what is gone meanwhile is left out."""
    return "".join(
        f'<img alt="{escape(figure.path.stem)}" style="max-width: {PIXELS}px; width: 100%" '
        f'src="data:image/png;base64,{base64.b64encode(figure.path.read_bytes()).decode()}">'
        for figure in figures
        if figure.path.is_file()
    )
