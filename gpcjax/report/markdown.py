"""A document as Markdown, as GitHub shows it: figures are files beside it.

Texts are plain, so that what Markdown would take for a sign of its own is escaped; a sign that stands where it means
nothing to Markdown (`a < b`, `GPC * 2`, `[0, 1]`) stays as it is, since people read the source as well.
"""

import re
from collections.abc import Callable
from typing import Any

from gpcjax.report.document import (
    Block,
    Code,
    Definitions,
    Document,
    Folded,
    Heading,
    Paragraph,
    Picture,
    Sheet,
    Warnings,
)

_SIGNS = re.compile(
    r"[\\`]"  # escapes and code
    r"|<(?=[A-Za-z/!?])"  # a tag
    r"|&(?=#?\w+;)"  # a character's name
    r"|\*(?=\S)|(?<=\S)\*(?=\S)|(?<!\w)_(?=\S)|(?<=\S)_(?!\w)|~(?=~)"  # emphasis opens before and closes after a word
    r"|\](?=[(\[:])"  # a link
    r"|\$(?=\S)"  # a formula
)
_BEGINNINGS = re.compile(r"^(?=#{1,6}\s|[-+*>]\s|>|=+$|-+$)|^(\d+)(?=[.)]\s)")
"""Of a line that would begin a heading, a list or a quotation, or underline one."""


def render(document: Document) -> str:
    """The whole text."""
    parts = [f"# {text(document.title)}", *map(_block, document.blocks)]
    return "\n\n".join(part.rstrip() for part in parts if part) + "\n"


def table(sheet: Sheet) -> str:
    """A table alone, without its title."""
    rows = [
        [_cell(cell, (index, column) in sheet.strong) for column, cell in enumerate(row)]
        for index, row in enumerate(sheet.rows)
    ]
    head = [_cell(name, strong=False) for name in sheet.columns]
    return "".join("| " + " | ".join(line) + " |\n" for line in (head, ["---"] * len(head), *rows))


def text(plain: str) -> str:
    """Plain text as a line of Markdown."""
    return _SIGNS.sub(lambda sign: "\\" + sign[0], " ".join(plain.split()))


def _block(block: Block) -> str:
    return _RENDERERS[type(block)](block)


def _cell(plain: str, strong: bool) -> str:
    shown = text(plain).replace("|", "\\|")
    return f"**{shown}**" if strong and shown else shown


def _heading(heading: Heading) -> str:
    return f"{'#' * heading.level} {text(heading.text)}"


def _paragraph(paragraph: Paragraph) -> str:
    return _BEGINNINGS.sub(lambda begun: f"{begun[1] or ''}\\", text(paragraph.text))


def _warnings(warnings: Warnings) -> str:
    first, *others = map(text, warnings.lines)
    return "\n>\n".join(f"> {line}" for line in (f"**{first}**", *others))


def _code(code: Code) -> str:
    return "\n".join(f"    {line}" for line in code.lines)


def _titled(sheet: Sheet) -> str:
    return f"**{text(sheet.heading)}**\n\n{table(sheet)}" if sheet.title else table(sheet)


def _picture(picture: Picture) -> str:
    return f"![{text(picture.alternative)}]({picture.file})\n\n{text(picture.caption)}"


def _definitions(definitions: Definitions) -> str:
    return "\n".join(f"- **{text(name)}**: {text(meaning)}" for name, meaning in definitions.entries.items())


def _folded(folded: Folded) -> str:
    inside = "\n\n".join(map(_titled, folded.sheets)).rstrip()
    return f"<details><summary>{text(folded.title)}</summary>\n\n{inside}\n\n</details>"


_RENDERERS: dict[type, Callable[[Any], str]] = {
    Heading: _heading,
    Paragraph: _paragraph,
    Warnings: _warnings,
    Code: _code,
    Sheet: _titled,
    Picture: _picture,
    Definitions: _definitions,
    Folded: _folded,
}
