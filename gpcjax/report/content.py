"""What the report of a sweep says, as a document."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from gpcjax.report import tables, words
from gpcjax.report.document import (
    Block,
    Definitions,
    Document,
    Folded,
    Heading,
    Paragraph,
    Picture,
    Sheet,
    Warnings,
)
from gpcjax.report.statistics import MANY_RUNS, RESAMPLES
from gpcjax.report.summary import Summary
from gpcjax.sweep.seeds import Seeds

MOST_ROWS = 600
"""Longer tables are left to the files."""

MOST_VALUES = 40
"""Of a setting in the specification: of more the first and the last are written."""


def document(summary: Summary, pictures: Iterable[Picture]) -> Document:
    """Results, limits, methods, and what was run."""
    manifest = summary.study.manifest
    lines = tables.warnings(summary)
    blocks: list[Block] = [Paragraph(_lead(summary), lead=True)]
    blocks += [Warnings(tuple(lines))] if lines else []
    blocks += [
        Heading("Results"),
        *tables.result_sheets(summary),
        *tables.point_sheets(summary),
        *map(Paragraph, tables.reading(summary)),
        *pictures,
        *_differences(summary),
    ]
    if summary.study.varying:
        title, rows = "Every point of the grid", len(summary.rows)
        blocks.append(_folded(title, tables.grid_sheets(summary)) if rows <= MOST_ROWS else _in_files(title))
    blocks += [
        Heading("Limits met"),
        *tables.limits_sheets(summary),
        Paragraph(
            "Steps of the runs that are in the numbers; clipped: the part of them whose action was outside [-1, 1]; "
            "met full: corrections that met a full dictionary; stopped: runs that ended before their time, with the "
            "steps until then."
        ),
        Heading("How the numbers are made"),
        Definitions(_methods(summary)),
        Heading("What was run"),
        *facts("Specification", manifest.get("specification") or {}, {"hash": manifest.get("hash", "")}),
        *facts("Run", _throughput(manifest)),
        *facts("Machine", manifest.get("machine") or {}),
        *(
            block
            for each in manifest.get("further_machines") or ()
            for block in facts("It went on with another machine", each)
        ),
        *facts("Versions", manifest.get("versions") or {}),
    ]
    return Document(_title(summary), tuple(blocks))


def _title(summary: Summary) -> str:
    *first, last = map(words.algorithm, summary.study.algorithms)
    return f"{summary.study.env}: " + (f"{', '.join(first)} and {last}" if first else last)


def _lead(summary: Summary) -> str:
    study = summary.study
    specification = study.manifest.get("specification", {})
    errors = [words.percent(error) for error in study.errors]
    shown = ", ".join(errors) if len(errors) <= 6 else f"{errors[0]} to {errors[-1]}"
    oracles = ", ".join(dict.fromkeys(group.oracle for group in study.groups))
    seeds = Seeds.of(specification.get("seeds", max(group.runs for group in study.groups)))
    parts = [f"{shown} erroneous advice", f"oracle {oracles}", *([seeds.words] if seeds else [])]
    parts += [f"{study.episodes} episodes"]
    parts += [f"{words.plain_symbol(name)} varies" for name in study.varying]
    return " · ".join(parts)


def _differences(summary: Summary) -> Iterator[Block]:
    rows = len(summary.differences)
    if not rows:
        return
    notes = map(Paragraph, tables.reading_differences(summary))
    yield Heading("Paired differences")
    if rows > MOST_ROWS:
        yield from notes
        yield _in_files(f"{rows:,} differences")
    elif rows > tables.MOST_ROWS:
        yield from notes
        yield _folded(f"{rows} differences", tables.difference_sheets(summary))
    else:
        yield from tables.difference_sheets(summary)
        yield from notes


def _folded(title: str, sheets: list[Sheet]) -> Block:
    return Folded(title, tuple(sheets))


def _in_files(title: str) -> Block:
    return Paragraph(f"{title}: more than {MOST_ROWS} rows, see summary.csv and differences.csv.")


def facts(title: str, *parts: Mapping[str, Any]) -> Iterator[Block]:
    """A headed list of values, as in a manifest; nothing if there are none."""
    entries = {name.replace("_", " "): _shown(value) for part in parts for name, value in part.items()}
    if entries:
        yield Heading(title, level=3)
        yield Definitions(entries)


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name} = {_shown(inner)}" for name, inner in value.items()) or "as in the thesis"
    if isinstance(value, list | tuple):
        if len(value) > MOST_VALUES:
            return f"{', '.join(map(_shown, value[:3]))}, ..., {_shown(value[-1])} ({len(value):,} values)"
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


def _many_runs(summary: Summary) -> str:
    if max(group.runs for group in summary.study.groups) < MANY_RUNS:
        return ""
    return (
        f" From {MANY_RUNS:,} runs on nothing is resampled: means have Student's t, and medians the two runs between "
        "which they lie by the binomial distribution; both hold as often."
    )


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
        "run had. Of medians of episodes: percentiles of the same resamples." + _many_runs(summary),
        "Differences": "Area of the first algorithm minus that of the second on the same seed; mean over the seeds "
        "that both have. There is no correction for the number of comparisons.",
    }
    if further := summary.study.manifest.get("further_machines"):
        methods["Machines"] = (
            f"Rows of {1 + len(further)} kinds of machine are mixed here: the same run may round otherwise on another "
            "one, so its returns agree in their distribution and not in their last bits. Each part of the rows says on "
            "which kind it was made."
        )
    if summary.study.varying:
        methods["Best and tied"] = (
            "Best is the point with the highest mean final return for an algorithm, oracle and error rate. Tied with "
            "it are the points for which the interval of the paired difference in final return, best minus point, is "
            "not above zero. The best of many points looks better than it is: confirm it with other seeds."
        )
        for name in summary.study.varying:
            methods[words.plain_symbol(name)] = words.meaning(name)
    return methods
