"""A document as one HTML file that needs nothing else: no link, no script, figures inside."""

import base64
from collections.abc import Callable, Iterable
from html import escape
from typing import Any

from gpcjax.report.document import (
    Block,
    Code,
    Definitions,
    Document,
    Folded,
    Heading,
    Kind,
    Paragraph,
    Picture,
    Sheet,
    Warnings,
)

PIXELS = 120
"""Of the screen for an inch of a figure: a full row of panels fills the page, and its smallest text has 12 pixels.

On a narrow screen the figure is not shrunk but scrolls, as the tables do.
"""


def render(document: Document, head: str = "") -> str:
    """The whole page; `head` is a line more of its head, in HTML."""
    body = [f"<h1>{escape(document.title)}</h1>", *map(_block, document.blocks)]
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n{head}'
        f"<title>{escape(document.title)}</title>\n<style>{_CSS}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(filter(None, body))
        + "\n</main>\n</body>\n</html>\n"
    )


def inline(blocks: Iterable[Block], more: str = "") -> str:
    """These blocks for a page of somebody else's, such as a notebook's: with styles that touch nothing beside them.

    `more` is HTML that follows them.
    """
    body = "\n".join(filter(None, map(_block, blocks)))
    return f'<div class="gpcjax-inline"><style>.gpcjax-inline {{{_INLINE}}}</style>\n{body}\n{more}</div>'


def refreshing(seconds: int) -> str:
    """A line of the head by which a browser loads the page anew after so many seconds."""
    return f'<meta http-equiv="refresh" content="{seconds}">'


def _block(block: Block) -> str:
    return _RENDERERS[type(block)](block)


def _heading(heading: Heading) -> str:
    return f"<h{heading.level}>{escape(heading.text)}</h{heading.level}>"


def _paragraph(paragraph: Paragraph) -> str:
    opening = '<p class="lead">' if paragraph.lead else "<p>"
    return f"{opening}{escape(paragraph.text)}</p>"


def _warnings(warnings: Warnings) -> str:
    return f'<div class="warning">{"".join(f"<p>{escape(line)}</p>" for line in warnings.lines)}</div>'


def _code(code: Code) -> str:
    return "\n".join(f"<p><code>{escape(line)}</code></p>" for line in code.lines)


def _table(sheet: Sheet) -> str:
    """Minus signs of numbers are as wide as their plus."""
    kinds: list[Kind] = [sheet.kind(column) for column in sheet.columns]
    head = "".join(
        f"<th{_class(kind)}>{escape(name)}</th>" for name, kind in zip(sheet.columns, kinds, strict=True)
    )
    rows = []
    for index, row in enumerate(sheet.rows):
        attribute = ' class="end"' if index in sheet.breaks else ""
        cells = "".join(
            f"<td{_class(kind)}>{_cell(text, kind, (index, column) in sheet.strong)}</td>"
            for column, (text, kind) in enumerate(zip(row, kinds, strict=True))
        )
        rows.append(f"<tr{attribute}>{cells}</tr>")
    caption = f"<caption>{escape(sheet.heading)}</caption>" if sheet.title else ""
    return (
        f'<div class="scroll"><table>{caption}<thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _cell(text: str, kind: Kind, strong: bool) -> str:
    shown = escape(text.replace("-", "−") if kind == "number" else text)  # noqa: RUF001
    return f"<strong>{shown}</strong>" if strong else shown


def _class(kind: Kind) -> str:
    return "" if kind == "number" else f' class="{kind}"'


def _picture(picture: Picture) -> str:
    source = base64.b64encode(picture.svg).decode()
    return (
        f'<figure><div class="drawing"><img width="{round(PIXELS * picture.inches)}" '
        f'alt="{escape(picture.alternative)}" src="data:image/svg+xml;base64,{source}"></div>'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def _definitions(definitions: Definitions) -> str:
    rows = "".join(
        f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in definitions.entries.items()
    )
    return f"<dl>{rows}</dl>" if rows else ""


def _folded(folded: Folded) -> str:
    return (
        f"<details><summary>{escape(folded.title)}</summary>{''.join(map(_table, folded.sheets))}</details>"
    )


_RENDERERS: dict[type, Callable[[Any], str]] = {
    Heading: _heading,
    Paragraph: _paragraph,
    Warnings: _warnings,
    Code: _code,
    Sheet: _table,
    Picture: _picture,
    Definitions: _definitions,
    Folded: _folded,
}


_INLINE = """
background: #fff; color: #1d1d1f; max-width: 62rem; padding: .2rem .6rem;
font: 14px/1.5 -apple-system, "Segoe UI", "Helvetica Neue", "Liberation Sans", Arial, sans-serif;
p { color: #5f6368; margin: .4rem 0; max-width: 46rem; font-size: 13px; }
.warning { border-left: 4px solid #d55e00; background: #fdf1e8; padding: .3rem .8rem; margin: .8rem 0; }
.scroll { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; white-space: nowrap;
  margin: 0; }
caption { text-align: left; font-weight: 600; padding-bottom: .4rem; }
th { font-weight: 600; text-align: right; padding: .3rem .8rem; background: #fff;
  border-top: 1.5px solid #1d1d1f; border-bottom: 1px solid #1d1d1f; }
td { text-align: right; padding: .15rem .8rem; background: #fff; }
table, caption, th, td { color: #1d1d1f; }
th.word, td.word, th.prose, td.prose { text-align: left; }
tr.end td { border-bottom: 1px solid #d8dadd; }
figure { margin: 1rem 0; }
.drawing { overflow-x: auto; }
.drawing img { display: block; height: auto; max-width: none; }
figcaption { color: #5f6368; font-size: 13px; margin-top: .4rem; max-width: 46rem; }
"""
"""Nested in one rule: a notebook's own tables keep their looks, and its themes change nothing here."""


_CSS = """
:root { color-scheme: light; --ink: #1d1d1f; --soft: #5f6368; --line: #d8dadd; --accent: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: var(--ink);
  font: 16px/1.55 -apple-system, "Segoe UI", "Helvetica Neue", "Liberation Sans", Arial, sans-serif; }
main { max-width: 58rem; margin: 0 auto; padding: 3rem 1.5rem 5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; letter-spacing: -.01em; }
h2 { font-size: 1.25rem; margin: 3rem 0 .8rem; }
h3 { font-size: 1rem; margin: 1.8rem 0 .4rem; }
p { margin: .4rem 0; max-width: 46rem; }
main > p { color: var(--soft); font-size: .875rem; }
main > p.lead { font-size: 1rem; margin-bottom: 1.5rem; }
.warning { border-left: 4px solid #d55e00; background: #fdf1e8; padding: .6rem 1rem; margin: 1.5rem 0; }
.warning p { font-weight: 600; }
.warning p ~ p { font-weight: 400; }
.scroll { overflow-x: auto; margin: 1rem 0 1.4rem; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; white-space: nowrap; }
caption { text-align: left; font-weight: 600; padding-bottom: .5rem; }
th { font-weight: 600; text-align: right; padding: .35rem .9rem; border-top: 1.5px solid var(--ink);
  border-bottom: 1px solid var(--ink); }
td { text-align: right; padding: .22rem .9rem; }
th.word, td.word, th.prose, td.prose { text-align: left; }
td { vertical-align: top; }
td.prose { white-space: normal; min-width: 11rem; }
th:first-child, td:first-child { padding-left: .2rem; }
tr.end td { border-bottom: 1px solid var(--line); padding-bottom: .4rem; }
tr.end + tr td { padding-top: .4rem; }
tbody tr:last-child td { border-bottom: 1.5px solid var(--ink); }
figure { margin: 2.2rem 0; }
.drawing { overflow-x: auto; }
.drawing img { display: block; height: auto; margin: 0 auto; }
figcaption { color: var(--soft); font-size: .875rem; margin-top: .7rem; max-width: 46rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .25rem 1.4rem; margin: 0; font-size: .9rem; }
dt { color: var(--soft); }
dd { margin: 0; max-width: 40rem; overflow-wrap: anywhere; }
details { margin: 1.5rem 0; }
summary { cursor: pointer; color: var(--accent); }
@media (min-width: 64rem) { .drawing { width: max-content; max-width: min(100vw - 4rem, 78rem); position: relative;
  left: 50%; transform: translateX(-50%); } }
@media (max-width: 40rem) { main { padding: 1.5rem 1rem 3rem; } h1 { font-size: 1.5rem; }
  h1, .lead, .warning { overflow-wrap: anywhere; } th, td { padding-left: .5rem; padding-right: .5rem; }
  .scroll caption { position: sticky; left: 0; max-width: calc(100vw - 2rem); white-space: normal; }
  dl { grid-template-columns: minmax(0, 1fr); } dd { margin-bottom: .5rem; } }
@media print { main { max-width: none; padding: 0; } figure, table { break-inside: avoid; }
  .drawing, .scroll { overflow: visible; } .drawing img { max-width: 100%; } }
"""
