"""The report as one HTML file that needs nothing else: no link, no script, figures inside."""

import base64
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

from gpcjax.report import style, tables, words
from gpcjax.report.statistics import RESAMPLES
from gpcjax.report.summary import Summary
from gpcjax.report.tables import Sheet

MOST_ROWS = 600
"""Longer tables are left to the files."""

PIXELS = 120
"""Of the screen for an inch of a figure: a full row of panels fills the page, and its smallest text has 12 pixels.

On a narrow screen the figure is not shrunk but scrolls, as the tables do.
"""


@dataclass(frozen=True)
class Picture:
    """A figure for the report: an SVG, its width in inches on paper, what it shows in a few words, and its caption."""

    svg: bytes
    inches: float
    alternative: str
    caption: str


def pictured(drawing: style.Drawing) -> Picture:
    """A drawing for the page."""
    figure, alternative, caption = drawing
    return Picture(style.image(figure, "svg"), figure.get_figwidth(), alternative, caption)


def page(summary: Summary, pictures: Iterable[Picture]) -> str:
    """The whole document."""
    study, manifest = summary.study, summary.study.manifest
    body = [
        f"<h1>{escape(_title(summary))}</h1>",
        f'<p class="lead">{escape(_lead(summary))}</p>',
        _warnings(summary),
        "<h2>Results</h2>",
        *map(table, tables.result_sheets(summary)),
        *map(table, tables.point_sheets(summary)),
        *map(paragraph, tables.reading(summary)),
        *map(picture, pictures),
        *_differences(summary),
        *(_folded("Every point of the grid", tables.grid_sheets(summary)) if study.varying else []),
        "<h2>Limits met</h2>",
        *map(table, tables.limits_sheets(summary)),
        paragraph(
            "Steps of the runs that are in the numbers; clipped: the part of them whose action was outside [-1, 1]; "
            "met full: corrections that met a full dictionary; stopped: runs that ended before their time, with the "
            "steps until then."
        ),
        "<h2>How the numbers are made</h2>",
        definitions(_methods(summary)),
        "<h2>What was run</h2>",
        facts("Specification", manifest.get("specification") or {}, {"hash": manifest.get("hash", "")}),
        facts("Run", _throughput(manifest)),
        facts("Machine", manifest.get("machine") or {}),
        *(facts("It went on with another machine", each) for each in manifest.get("further_machines") or ()),
        facts("Versions", manifest.get("versions") or {}),
    ]
    return document(_title(summary), body)


def document(title: str, body: Iterable[str]) -> str:
    """A page of these parts, with our style; empty ones are left out."""
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_CSS}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(filter(None, body))
        + "\n</main>\n</body>\n</html>\n"
    )


def _title(summary: Summary) -> str:
    *first, last = map(words.algorithm, summary.study.algorithms)
    return f"{summary.study.env}: " + (f"{', '.join(first)} and {last}" if first else last)


def _lead(summary: Summary) -> str:
    study = summary.study
    specification = study.manifest.get("specification", {})
    errors = [words.percent(error) for error in study.errors]
    shown = ", ".join(errors) if len(errors) <= 6 else f"{errors[0]} to {errors[-1]}"
    oracles = ", ".join(dict.fromkeys(group.oracle for group in study.groups))
    seeds = specification.get("seeds", max(group.runs for group in study.groups))
    parts = [f"{shown} erroneous advice", f"oracle {oracles}", f"{seeds} seeds", f"{study.episodes} episodes"]
    parts += [f"{words.plain_symbol(name)} varies" for name in study.varying]
    return " · ".join(parts)


def _warnings(summary: Summary) -> str:
    lines = tables.warnings(summary)
    return f'<div class="warning">{"".join(map(paragraph, lines))}</div>' if lines else ""


def _differences(summary: Summary) -> list[str]:
    sheets = tables.difference_sheets(summary)
    rows = sum(len(sheet.rows) for sheet in sheets)
    if not rows:
        return []
    notes = list(map(paragraph, tables.reading_differences()))
    if rows > tables.MOST_ROWS:
        return ["<h2>Paired differences</h2>", *notes, *_folded(f"{rows} differences", sheets)]
    return ["<h2>Paired differences</h2>", *map(table, sheets), *notes]


def _folded(title: str, sheets: list[Sheet]) -> list[str]:
    if sum(len(sheet.rows) for sheet in sheets) > MOST_ROWS:
        return [paragraph(f"{title}: more than {MOST_ROWS} rows, see summary.csv and differences.csv.")]
    return [f"<details><summary>{escape(title)}</summary>{''.join(map(table, sheets))}</details>"]


def table(sheet: Sheet) -> str:
    """A sheet; columns of words and sentences are set to the left."""
    kinds = [_kind(column) for column in sheet.columns]
    head = "".join(
        f"<th{_class(kind)}>{escape(name)}</th>" for name, kind in zip(sheet.columns, kinds, strict=True)
    )
    rows = []
    for index, row in enumerate(sheet.rows):
        attribute = ' class="end"' if index in sheet.breaks else ""
        cells = "".join(
            f"<td{_class(kind)}>{escape(cell if kind else cell.replace('-', '−'))}</td>"  # noqa: RUF001
            for cell, kind in zip(row, kinds, strict=True)
        )
        rows.append(f"<tr{attribute}>{cells}</tr>")
    caption = escape(sheet.title[0].upper() + sheet.title[1:])
    return (
        f'<div class="scroll"><table><caption>{caption}</caption><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _kind(column: str) -> str:
    """How a column is set: "word", "prose", or nothing for numbers."""
    if column in tables.PROSE_COLUMNS:
        return "prose"
    return "word" if column in tables.WORD_COLUMNS else ""


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def picture(picture: Picture) -> str:
    """A figure with its caption, inside of the page."""
    source = base64.b64encode(picture.svg).decode()
    return (
        f'<figure><div class="drawing"><img width="{round(PIXELS * picture.inches)}" '
        f'alt="{escape(picture.alternative)}" src="data:image/svg+xml;base64,{source}"></div>'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def paragraph(text: str) -> str:
    """Text, with what means something in HTML escaped."""
    return f"<p>{escape(text)}</p>"


def definitions(entries: Mapping[str, str]) -> str:
    """A list of names and what they are."""
    rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in entries.items())
    return f"<dl>{rows}</dl>"


def facts(title: str, *parts: Mapping[str, Any]) -> str:
    """A headed list of values, as in a manifest; nothing if there are none."""
    entries = {name.replace("_", " "): _shown(value) for part in parts for name, value in part.items()}
    return f"<h3>{escape(title)}</h3>{definitions(entries)}" if entries else ""


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name} = {_shown(inner)}" for name, inner in value.items()) or "as in the thesis"
    if isinstance(value, list | tuple):
        return ", ".join(map(_shown, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _throughput(manifest: Mapping[str, Any]) -> dict[str, str]:
    formats = {
        "cells": "{:,}",
        "env_steps": "{:,}",
        "env_steps_per_s": "{:,.0f}",
        "wall_time_s": "{:,.1f}",
        "compile_time_s": "{:,.1f}",
        "jobs": "{}",
    }
    names = {
        "env_steps_per_s": "env steps a second",
        "wall_time_s": "wall time (s)",
        "compile_time_s": "compile time (s)",
    }
    return {names.get(name, name): form.format(manifest[name]) for name, form in formats.items()
            if isinstance(manifest.get(name), int | float)}  # fmt: skip


def _methods(summary: Summary) -> dict[str, str]:
    methods = {
        "Runs": "One run is one seed. The same seed means the same starts and the same draws of the teacher for every "
        "algorithm. A run that stopped (a full dictionary, a number that is not finite) keeps the returns of the "
        "episodes that it finished; from the one in which it stopped on it counts as a robot that does nothing, with "
        "the mean return of the idle policy and no corrections. Runs that are not finished are in no number and no "
        "curve.",
        "Final return": f"The mean return of a run's last {tables.FINAL_EPISODES} episodes; its mean over runs. Beside "
        "the learning curves stands that of each run.",
        "Area": "The area under the learning curve, as the mean return of an episode; its mean over runs.",
        f"To {tables.CLOSED}": f"The first episode (from 1) whose return is at least idle + {tables.CLOSED} of the gap "
        "from the idle policy (a = 0) to the oracle; its median over runs, where never counts as infinitely late.",
        "Corrections": "All corrections of a run; their mean over runs.",
        "Intervals": "Of means: 95% intervals of a studentised bootstrap over seeds "
        f"({RESAMPLES:,} resamples with a fixed random seed: the same store gives the same interval), never narrower "
        "than Student's t. Runs that are all equal have an interval of no width: it cannot know of an outcome that no "
        "run had. Of medians of episodes: percentiles of the same resamples.",
        "Differences": "Area of the first algorithm minus that of the second on the same seed; mean over the seeds "
        "that both have. There is no correction for the number of comparisons.",
    }
    if summary.study.varying:
        methods["Best and tied"] = (
            "Best is the point with the highest mean final return for an algorithm, oracle and error rate. Tied with "
            "it are the points for which the interval of the paired difference in final return, best minus point, is "
            "not above zero. The best of many points looks better than it is: confirm it with other seeds."
        )
        for name in summary.study.varying:
            methods[words.plain_symbol(name)] = words.meaning(name)
    return methods


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
