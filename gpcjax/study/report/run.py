"""From a study's folder to its report: read, count, draw, write, and put all of it into place at once. Loads no jax.

It needs no lock: a study may be going on. Whoever is deleted while it is made is not in what stays.
"""

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

import pyarrow.parquet as pq

from gpcjax.errors import UserError
from gpcjax.report import html, markdown
from gpcjax.report.document import Picture
from gpcjax.study.participant import CARD
from gpcjax.study.register import ANALYSIS
from gpcjax.study.report.asked import asked_of
from gpcjax.study.report.columns import dictionary
from gpcjax.study.report.frames import tables_of
from gpcjax.study.report.held import Held, read_held
from gpcjax.study.report.made import MADE, state_of
from gpcjax.study.report.naming import algorithms_of, names_of
from gpcjax.study.report.numbers import Numbers, numbers_of
from gpcjax.study.report.page import document
from gpcjax.study.report.stores import write_stores
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.layout import Say

NEW, OLD = f".{ANALYSIS}-new", f".{ANALYSIS}-old"
REPORT, PAGE, TEXT, DICTIONARY, FIGURES = "report", "report.html", "report.md", "dictionary.md", "figures"


def draw(out: Path, say: Say) -> list[Path]:
    """Makes OUT/analysis anew; gives the paths of its page, its text and its tables.

    Args:
        out: a study's folder.
        say: takes a line about what is left out.

    Raises:
        UserError: there is no study, nobody has come yet, or something cannot be written.
    """
    before = state_of(out)
    held = read_held(out, say)
    if not held.people:
        raise UserError(f"{out}: nobody has come yet, there is nothing to report on")
    new, old, final = out / NEW, out / OLD, out / ANALYSIS
    try:
        for left in (new, old):
            shutil.rmtree(left, ignore_errors=True)
        new.mkdir()
        _write(held, new)
        write_atomic(new / MADE, json.dumps({"of": before}) + "\n")
        if final.exists():
            final.rename(old)
        new.rename(final)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise UserError(
            f"{error.filename or out}: cannot be written ({error.strerror}), make room and give the right to write"
        ) from None
    finally:
        shutil.rmtree(new, ignore_errors=True)
    # Who is deleted goes first, and then what was made of the data: after this either is seen by the other.
    if any(not (one.folder / CARD).exists() for one in held.people):
        shutil.rmtree(final)
        raise UserError(f"{out}: a participant was deleted while the report was made, make it again")
    return [
        final / name
        for name in (PAGE, TEXT, DICTIONARY, *sorted(each.name for each in final.glob("*.parquet")))
    ]


def _write(held: Held, analysis: Path) -> None:
    stores = write_stores(held, analysis)
    for name, table in tables_of(held).items():
        pq.write_table(table, analysis / f"{name}.parquet")
    numbers = numbers_of(held)
    asked = asked_of(held, names_of(held))
    (analysis / FIGURES).mkdir()
    pictures = list(_pictures(held, numbers, analysis))
    page = document(held, numbers, asked, pictures, stores)
    (analysis / DICTIONARY).write_text(dictionary(), encoding="utf-8")
    (analysis / TEXT).write_text(markdown.render(page), encoding="utf-8")
    (analysis / PAGE).write_text(html.render(page), encoding="utf-8")


def _pictures(held: Held, numbers: Numbers, analysis: Path) -> Iterable[Picture]:
    """Draws each figure, writes it as PNG and PDF, and gives it for the page."""
    if not numbers.taught:
        return
    from gpcjax.report.figures import style  # matplotlib takes longer to import than all else to compute
    from gpcjax.report.figures.painted import painted
    from gpcjax.study.report import figures

    name_of, algorithms = names_of(held), algorithms_of(held)
    looks = figures.looks_of(list(dict.fromkeys(each.treatment for each in numbers.taught)), algorithms)
    drawings: Mapping[str, style.Drawing] = {
        "curves": figures.learning_curves(numbers, looks, name_of),
        "advice": figures.advice(numbers, looks, name_of),
        **{
            f"participants-{place}": figures.participants(numbers, task, looks, name_of)
            for place, task in enumerate(dict.fromkeys(each.task for each in numbers.taught), 1)
        },
    }
    images = painted([drawing.figure for drawing in drawings.values()])
    for (name, drawing), image in zip(drawings.items(), images, strict=True):
        for kind, content in image.files.items():
            (analysis / FIGURES / f"{name}.{kind}").write_bytes(content)
        yield style.pictured(drawing, f"{FIGURES}/{name}.png", image.svg)
