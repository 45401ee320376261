"""Writes the data dictionary of a run folder, from the docstrings, descriptions and settings that the program has."""

import inspect

import gpcjax
from gpcjax.registry import built_in, find
from gpcjax.sweep.options import TUNING

INTRODUCTION = """# The columns of a store

A run folder holds its rows in Parquet, in parts that are only ever added whole: `episodes/*.parquet` has a row for
each run and episode, `corrections/*.parquet` one for each of the first 200 corrections of each run, `kept/*.parquet`
what was learned, where that was asked for. `gpcjax.load`, `load_corrections`, `load_policies` and `load_states` read
them, and check their seals; [anything that reads Parquet](../stores.md) can. This page is made from the program."""

UNITS = """Actions are normalised: -1 and 1 are the ends of what the task takes. A step is the task's (0.02 s for
cart-pole, 0.05 s for the pendulum). Null is a value that does not exist, such as the dictionary's points of a learner
without one; NaN is the return of an episode in which a number was not finite."""


def page() -> str:
    """The whole page, in Markdown."""
    return (
        "\n\n".join(
            [
                INTRODUCTION,
                UNITS,
                "## Episodes",
                _table_in(gpcjax.load),
                "### What learners measure besides",
                "Null for all other learners. One of your own adds what its `measure` names.",
                _table(("column", "type", "learner", "what"), _measured()),
                "## Corrections",
                _table_in(gpcjax.load_corrections),
                "## Settings with several values",
                "Each setting that has several values in a sweep is a column of both tables, a float, null for "
                "learners without it: `error`, `delta`, `rate` (beside corrections `advice_rate`), the settings "
                "of learners and teachers of your own, and",
                _table(("column", "what"), ((f"`{option.name}`", option.text) for option in TUNING)),
                "## What was learned",
                "`gpcjax.load_policies` gives",
                _table_in(gpcjax.load_policies),
                "and `gpcjax.load_states` has `learner` and `state` in its place. In the file, `card` "
                "(JSON) and `arrays` (bytes) hold them packed; `kind` is `policy` or `state`.",
                "## Beside the rows",
                _table(("file", "what"), FILES),
            ]
        )
        + "\n"
    )


FILES = (
    (
        "`manifest.json`",
        "the specification, versions, machine, times, the returns of idle policy and oracles",
    ),
    (
        "`summary.csv`",
        "a row for each learner, error and setting: the table of the report, with its intervals",
    ),
    ("`differences.csv`", "differences between learners over runs of the same seed"),
    ("`report.html`, `curves.*`, `rates.*`", "the report and its figures"),
    ("`damaged/`", "files whose checksum was wrong; their runs were computed again"),
    ("`checkpoints/`", "runs that are under way; gone when all is done"),
)


def tabled(function) -> list[str]:
    """The first column of the table in a docstring, a name at a time."""
    rows = [line.strip("|").split("|") for line in _table_in(function).splitlines()[2:]]
    return [name.strip() for row in rows for name in row[0].split(",")]


def _table_in(function) -> str:
    """The table of a docstring."""
    return "\n".join(line for line in inspect.getdoc(function).splitlines() if line.startswith("|"))


def _measured():
    for name in built_in("learner"):
        for column in find("learner", name).columns:
            yield f"`{column.name}`", column.type, f"`{name}`", column.text


def _table(head, rows) -> str:
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])
