"""What a comparison says: its tables of texts, the sentences that go with them, and its page."""

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rich.console import RenderableType

from gpcjax.report import compare_notes as notes
from gpcjax.report import words
from gpcjax.report.compare_match import Folder, Pair, Value, names_of
from gpcjax.report.compare_numbers import STATISTICS, Difference
from gpcjax.report.content import facts
from gpcjax.report.document import (
    Block,
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
from gpcjax.report.groups import FINAL_EPISODES, unique
from gpcjax.report.statistics import RESAMPLES
from gpcjax.report.terminal import laid_out

if TYPE_CHECKING:
    from gpcjax.report.compare import Comparison

MOST_ROWS = 120
"""Longer tables are left to comparison.csv."""

ALWAYS = ("error", "algo")
"""Settings that every table has."""

KINDS: dict[str, Kind] = {
    "error": "word",
    "algo": "word",
    "oracle": "word",
    "teacher": "word",
    "statistic": "word",
}


def settings_shown(pairs: Sequence[Pair]) -> tuple[str, ...]:
    """Settings that tell the pairs of groups apart, or in which the groups of one differ."""
    folders = unique(folder for pair in pairs for folder in (pair.first, pair.second))
    return tuple(name for name in names_of(folders) if name in ALWAYS or len(_values(pairs, name)) > 1)


def _values(pairs: Sequence[Pair], name: str) -> set[object]:
    """What a setting is in these groups, where it changes anything."""
    return {
        value
        for pair in pairs
        for value in (pair.first.setting(pair.one, name), pair.second.setting(pair.other, name))
        if value is not None
    }


def setting_shown(pair: Pair, name: str) -> str:
    """A setting of both groups: `0.1`, or `0.1 / 0.2` of the first and of the second."""
    one, other = pair.first.setting(pair.one, name), pair.second.setting(pair.other, name)
    mine, its = notes.shown(name, one), notes.shown(name, other)
    return mine if one == other else f"{mine} / {its}"


def sheets(comparison: "Comparison") -> list[Sheet]:
    """The differences, a sheet for each two folders: a row for each statistic of each pair of groups."""
    names = settings_shown([each.pair for each in comparison.differences])
    head = [*ALWAYS, *(name for name in names if name not in ALWAYS)]
    columns = (
        *(name if name in KINDS else words.plain_symbol(name) for name in head),
        *("statistic", "difference", "p (Holm)", "P(better)", "paired", "pairs"),
    )
    made = []
    for first, second in unique((each.pair.first, each.pair.second) for each in comparison.differences):
        ours = [
            each for each in comparison.differences if (each.pair.first, each.pair.second) == (first, second)
        ]
        decimals = words.places([each.difference.estimate for each in ours])
        rows = tuple(_row(each, head, decimals) for each in ours)
        ends = frozenset(i for i in range(len(rows)) if i % len(STATISTICS) == len(STATISTICS) - 1)
        made.append(Sheet(f"differences, {first.name} - {second.name}", columns, rows, ends, KINDS))
    return made


def _row(difference: Difference, head: Sequence[str], decimals: int) -> tuple[str, ...]:
    begins = difference.statistic == next(iter(STATISTICS))
    settings = (setting_shown(difference.pair, name) if begins else "" for name in head)
    star = " **" if difference.survives else " * " if difference.difference.excludes_zero else "   "
    return (
        *settings,
        STATISTICS[difference.statistic],
        words.interval(difference.difference, decimals) + star,
        p_shown(difference.p_holm),
        words.interval(difference.better, 2),
        words.interval(difference.better_paired, 2),
        str(difference.pairs) if begins else "",
    )


def p_shown(p: float) -> str:
    """`0.012`, or `<0.001`."""
    return "<0.001" if p < 0.001 else words.number(p, 3)


def warnings(comparison: "Comparison") -> list[str]:
    """What nobody may miss who reads the differences."""
    return [
        *notes.several_things(comparison.folders, comparison.matches),
        *notes.uncounted(comparison.folders),
    ]


def remarks(comparison: "Comparison") -> list[str]:
    """What differs, what is matched and what is not."""
    return [
        *notes.differing(comparison.folders),
        *notes.matched(comparison.matches),
        *notes.of_pairs(comparison.differences),
        *notes.alone(comparison.matches),
    ]


def reading(comparison: "Comparison") -> list[str]:
    """How to read the table."""
    count = sum(not math.isnan(each.p) for each in comparison.differences)
    lines = [
        "Difference: first folder minus second, mean over the seeds that both have, with its 95% interval; of the area "
        f"(mean return of an episode) and the final return (mean of the last {FINAL_EPISODES} episodes). "
        f"* beyond zero by its interval; ** also after Holm's correction for {count} differences.",
        "P(better): chance that a run of the first folder is better than a run of the second, whatever their seeds "
        "(0.5: neither is); paired: than the run of the same seed. Both with 95% intervals.",
    ]
    runs = max((each.pairs for each in comparison.differences), default=0)
    if runs < 10:
        lines.append("Fewer than ten pairs say little of rare outcomes, and so do their intervals.")
    return lines


def terminal(comparison: "Comparison") -> RenderableType:
    """What `gpcjax compare` prints; a table that is too long is left to the files."""
    tables = sheets(comparison)
    rows = sum(len(sheet.rows) for sheet in tables)
    many = [f"{rows} differences are in comparison.csv."] if rows > MOST_ROWS else []
    notes_below = [*many, *remarks(comparison), *reading(comparison)]
    return laid_out(warnings(comparison), [] if many else tables, notes_below)


def document(comparison: "Comparison", pictures: Iterable[Picture]) -> Document:
    """What differs, the differences, how they are made, and what was compared."""
    folders, lines = comparison.folders, warnings(comparison)
    tables = sheets(comparison)
    rows = sum(len(sheet.rows) for sheet in tables)
    shown: list[Block] = [*tables]
    if rows > MOST_ROWS:
        shown = [Paragraph(f"{rows} differences: see comparison.csv.")]
        if rows <= 5 * MOST_ROWS:
            shown = [Folded(f"{rows} differences", tuple(tables))]
    blocks: list[Block] = [
        Paragraph(_lead(comparison), lead=True),
        *([Warnings(tuple(lines))] if lines else []),
        Heading("What differs"),
        *map(Paragraph, remarks(comparison)),
        Heading("Differences"),
        *shown,
        *map(Paragraph, reading(comparison)),
        *pictures,
        Heading("How the numbers are made"),
        Definitions(_methods()),
        Heading("What was compared"),
        *(block for folder in folders for block in facts(folder.name, _facts(folder))),
    ]
    names = [folder.name for folder in folders]
    return Document(f"{comparison.env}: {words.listed(names)} compared", tuple(blocks))


def _lead(comparison: "Comparison") -> str:
    areas = [each for each in comparison.differences if each.statistic == "area"]
    groups, pairs = len(areas), sum(each.pairs for each in areas)
    beyond = sum(each.difference.excludes_zero for each in comparison.differences)
    survive = sum(each.survives for each in comparison.differences)
    return (
        f"{groups} pair{'' if groups == 1 else 's'} of groups · {pairs} pairs of runs with the same seed · "
        f"{beyond} of {len(comparison.differences)} differences beyond zero, {survive} of them after Holm's correction"
    )


def _facts(folder: Folder) -> dict[str, object]:
    return {
        "folder": str(folder.path),
        "hash": folder.hash,
        **folder.lengths,
        **{name: _listed(name, values) for name, values in folder.values.items()},
        "versions": folder.versions,
        "kind of machine": ", ".join(kind or "not told" for kind in folder.kinds),
    }


def _listed(name: str, values: Iterable[Value]) -> str:
    return ", ".join(notes.shown(name, value) for value in values)


def _methods() -> dict[str, str]:
    return {
        "Pairs": "Runs with the same seed have the same starts and the same draws of the teacher. They are compared "
        "with each other where learner, oracle, error and all settings are the same, or differ in what the groups are "
        "matched across. A run that stopped counts as a robot that does nothing from that episode on; runs that are "
        "not finished are in no number.",
        "Difference": "First folder minus second on the same seed, mean over seeds: above zero the first is better.",
        "Intervals": "Of differences and P(better): 95% intervals of a studentised bootstrap over seeds "
        f"({RESAMPLES:,} resamples with a fixed random seed, each taking a seed's runs of both folders), never "
        "narrower than Student's t. Of the paired chance and of profiles: exact binomial intervals (Clopper and "
        "Pearson); no interval of P(better) tells more than theirs would of as many pairs that all come out alike.",
        "p (Holm)": "Two-sided p of Student's t for a mean difference of zero, after Holm's correction: all "
        "differences of this page are one family. The intervals beside it are not corrected.",
        "P(better)": "The probability of improvement of Agarwal et al. (2021): the part of all pairs of a run of the "
        "first and a run of the second, of any seeds, in which the first has the higher return; equal ones count half.",
        "Paired": "The same over pairs of runs with the same seed alone. It says something else where seeds make much "
        "of the difference between runs: a small advantage on every seed has P(better) near 0.5 and a paired chance "
        "of 1.",
        "Profile": "The part of the runs whose final return is above a value, with its interval at each value for "
        "itself, over the seeds that all lines of a panel have. The line further to the right is better.",
    }
