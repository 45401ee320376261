"""What a report is made of: headings, paragraphs, tables, figures. Renderers know nothing else, and nothing of sweeps.

Every text in a document is plain: `gpcjax.report.html` and `gpcjax.report.markdown` escape what means something to
them. What a report says is in `gpcjax.report.content` and `gpcjax.reproduce.page`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Kind = Literal["number", "word", "prose"]
"""How a column is set: numbers to the right; words, and sentences that may be broken, to the left."""


@dataclass(frozen=True)
class Heading:
    """The beginning of a section; `level` 1 is the document's own, its title."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """Sentences; a `lead` says what the document is."""

    text: str
    lead: bool = False


@dataclass(frozen=True)
class Warnings:
    """Lines that nobody may miss, the first of them most of all."""

    lines: tuple[str, ...]


@dataclass(frozen=True)
class Code:
    """Lines to type."""

    lines: tuple[str, ...]


@dataclass(frozen=True)
class Sheet:
    """A table of texts.

    | Field     | Meaning                                                                                  |
    |-----------|------------------------------------------------------------------------------------------|
    | `title`   | above it; empty where a heading says the same                                            |
    | `columns` | their names; a learner may call a setting as we call a column, so a name may occur twice |
    | `rows`    | a cell for each column                                                                   |
    | `breaks`  | the rows that end a block                                                                |
    | `kinds`   | of columns that hold no numbers, by name; of others too, so that many tables share it    |
    | `strong`  | (row, column) of the cells that stand out, from 0                                        |

    Raises:
        ValueError: a row has not as many cells as there are columns.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    breaks: frozenset[int] = frozenset()
    # How it is set is no part of what it says, which the record of what was published is a sum of.
    kinds: Mapping[str, Kind] = field(default_factory=dict, repr=False, hash=False)
    strong: frozenset[tuple[int, int]] = field(default=frozenset(), repr=False)

    def __post_init__(self) -> None:
        for index, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ValueError(
                    f"table {self.title!r}: row {index} has {len(row)} cells, for {len(self.columns)} columns"
                )

    def kind(self, column: str) -> Kind:
        """How a column is set."""
        return self.kinds.get(column, "number")

    @property
    def heading(self) -> str:
        """The title as the beginning of a sentence."""
        return self.title[:1].upper() + self.title[1:]


@dataclass(frozen=True)
class Picture:
    """A figure.

    | Field         | Meaning                                                                  |
    |---------------|--------------------------------------------------------------------------|
    | `svg`         | the drawing, for a document that holds its figures                       |
    | `inches`      | its width on paper                                                       |
    | `alternative` | what it shows in a few words                                             |
    | `caption`     | what was drawn                                                           |
    | `file`        | where it lies beside a document that refers to it, as `figures/NAME.png` |
    """

    svg: bytes
    inches: float
    alternative: str
    caption: str
    file: str = ""


@dataclass(frozen=True)
class Definitions:
    """Names and what they are; nothing is shown of none."""

    entries: Mapping[str, str]


@dataclass(frozen=True)
class Folded:
    """Tables that few readers open."""

    title: str
    sheets: tuple[Sheet, ...]


Block = Heading | Paragraph | Warnings | Code | Sheet | Picture | Definitions | Folded


@dataclass(frozen=True)
class Document:
    """A title and what follows, in this order."""

    title: str
    blocks: tuple[Block, ...]
