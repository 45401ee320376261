"""What a search says at its end: in the terminal, and as a page."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gpcjax.errors import unwritten
from gpcjax.report import compare_page, html, words
from gpcjax.report.compare import Comparison
from gpcjax.report.document import Code, Document, Heading, Kind, Paragraph, Picture, Sheet, Warnings
from gpcjax.sweep.atomic import write_atomic
from gpcjax.tune.found import Found

PAGE, TABLE, BEST, FIGURE = "tune.html", "tune.csv", "best.toml", "tune"

MOST_ROWS = 20
"""Points of a table; all are in tune.csv."""

MOST_TERMINAL = 8


def sheet(found: Found, most: int) -> Sheet:
    """The best points, and those of the front first of all."""
    names, objectives = list(found.space), found.objectives
    several = len(objectives) > 1
    chosen = [each for each in found.points if each.on_front] if several else list(found.points)
    chosen = (chosen + [each for each in found.points if each not in chosen])[:most]
    decimals = [words.places([each.scores[place] for each in chosen]) for place in range(len(objectives))]
    rows = []
    for each in chosen:
        mark = (
            "best"
            if each is found.best
            else "front"
            if several and each.on_front
            else "tied"
            if each.tied
            else ""
        )
        scores = [words.number(score, places) for score, places in zip(each.scores, decimals, strict=True)]
        rows.append((mark, *(f"{each.point[name]:.4g}" for name in names), *scores, str(each.runs)))
    title = (
        "front"
        if several
        else "points"
        if len(found.points) <= most
        else f"{most} best of {len(found.points):,} points"
    )
    columns = ("", *map(words.plain_symbol, names), *(each.name for each in objectives), "runs")
    kinds: dict[str, Kind] = {"": "word"}
    return Sheet(title, columns, tuple(rows), kinds=kinds)


def warnings(found: Found) -> list[str]:
    """What a reader must know of the best point."""
    told = []
    if found.edges:
        edges = ", ".join(f"{words.plain_symbol(name)} of {found.space[name]}" for name in found.edges)
        told.append(
            f"The best point lies at an end of its range ({edges}): a wider one may hold a better point."
        )
    if not np.isfinite(found.best.scores).all():
        told.append("No point reaches the objective: what is called best is no more than the first of them.")
    return told


def verdict(comparison: Comparison | None, seeds: str) -> list[str]:
    """A sentence for each statistic of the check."""
    if comparison is None:
        return ["What was found is what is usual: there is nothing to compare."]
    told = []
    for each in comparison.differences:
        places = words.places([each.difference.estimate, each.difference.lower, each.difference.upper])
        told.append(
            f"{_condition(comparison, each)}{each.statistic.replace('_', ' ')}, tuned minus usual, on {seeds}: "
            f"{words.interval(each.difference, places)}"
            f"{'' if each.difference.excludes_zero else ' (no difference shown)'}"
        )
    return told


def _condition(comparison: Comparison, each: object) -> str:
    pair = each.pair  # pyright: ignore[reportAttributeAccessIssue]
    if len(comparison.differences) <= 2:
        return ""
    return f"{words.percent(pair.one.error)} error, oracle {pair.one.oracle}: "


def write(
    out: Path,
    title: str,
    lead: str,
    sheets: Sequence[Sheet],
    pictures: Sequence[Picture],
    warned: Sequence[str],
    comparison: Comparison | None,
    said: Sequence[str],
    commands: Sequence[str],
) -> Path:
    """The page of a search in its folder; gives its path. Raises UserError where it cannot be written."""
    blocks = [
        Paragraph(lead, lead=True),
        *([Warnings(tuple(warned))] if warned else []),
        Heading("On other seeds"),
        *map(Paragraph, said),
        *(compare_page.sheets(comparison) if comparison else []),
        Heading("Points"),
        *pictures,
        *sheets,
        Heading("Commands"),
        Code(tuple(commands)),
    ]
    path = out / PAGE
    try:
        write_atomic(path, html.render(Document(title, tuple(blocks))))
    except OSError as error:
        line = f"{path}: cannot be written ({error.strerror}): make room and give the right to write"
        raise unwritten(error, line) from None
    return path
