"""How the terminal shows a summary."""

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.console import Group as Lines
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from gpcjax.report import tables, words
from gpcjax.report.document import Sheet
from gpcjax.report.summary import Summary


def render(summary: Summary) -> RenderableType:
    """What a sweep prints at its end: warnings, results by oracle, paired differences, and how to read them.

    It prints on a stream of any encoding, in the signs that this has.
    """
    differences = tables.difference_sheets(summary) if len(summary.differences) <= tables.MOST_ROWS else []
    notes = tables.reading(summary) + (tables.reading_differences(summary) if differences else [])
    if len(summary.differences) > tables.MOST_ROWS:
        notes.append(
            f"{len(summary.differences):,} paired differences between algorithms are in differences.csv."
        )
    sheets = tables.result_sheets(summary) + tables.point_sheets(summary) + differences
    return laid_out(tables.warnings(summary), sheets, notes)


def laid_out(warnings: Iterable[str], sheets: Iterable[Sheet], notes: Iterable[str]) -> RenderableType:
    """Warnings, tables, and how to read them, on a stream of any encoding."""
    return Lines(
        *(_Line(line, "bold red") for line in warnings),
        *(part for sheet in sheets for part in (Text(), _Fitted(sheet))),
        Text(),
        *(_Line(note, "dim") for note in notes),
    )


def show_sheet(sheet: Sheet) -> None:
    """Prints a table alone."""
    _console().print(_Fitted(sheet))


def show_facts(title: str, facts: Mapping[str, str]) -> None:
    """Prints a title, and names with what they are."""
    console = _console()
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in facts.items():
        table.add_row(name, Text(words.printable(text, console.encoding)))
    console.print(Text(words.printable(title, console.encoding), style="bold"), table, sep="\n")


def _console() -> Console:
    return Console(width=None if sys.stdout.isatty() else 160)  # a file or pipe is no narrow terminal


@dataclass(frozen=True)
class _Line:
    """A sentence."""

    text: str
    style: str

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield Text(words.printable(self.text, options.encoding), style=self.style)


@dataclass(frozen=True)
class _Fitted:
    """A sheet with two spaces between its columns, or one where the terminal is narrow."""

    sheet: Sheet

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        sheet = _printable(self.sheet, options.encoding)
        wide = _table(sheet, gap=2)
        needed = Measurement.get(console, options.update(max_width=1000), wide).maximum
        yield wide if needed <= options.max_width else _table(sheet, gap=1)


def _printable(sheet: Sheet, encoding: str) -> Sheet:
    def each(texts: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(words.printable(text, encoding) for text in texts)

    return replace(
        sheet,
        title=words.printable(sheet.title, encoding),
        columns=each(sheet.columns),
        rows=tuple(map(each, sheet.rows)),
        kinds={words.printable(name, encoding): kind for name, kind in sheet.kinds.items()},
    )


def _table(sheet: Sheet, gap: int) -> Table:
    table = Table(
        title=sheet.title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,  # it draws one space between columns
        padding=(0, gap - 1, 0, 0),
        show_edge=False,
        pad_edge=False,
    )
    for column in sheet.columns:
        table.add_column(column, justify="right" if sheet.kind(column) == "number" else "left", no_wrap=True)
    for index, row in enumerate(sheet.rows):
        table.add_row(*map(Text, row), end_section=index in sheet.breaks)
    return table
