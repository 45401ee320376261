"""Commands that show what run folders hold."""

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from gpcjax.sweep.options import OPTIONS, parse
from gpcjax.sweep.runfolder import check_report


def report(out: Path, as_json: bool, anew: bool = True) -> int:
    """`gpcjax report`, and the end of a sweep; what was drawn before of the same rows stays, unless `anew`."""
    check_report(out)
    from gpcjax.report.run import draw
    from gpcjax.report.terminal import render

    summary = draw(out, anew=anew)
    if as_json:
        table = json.loads(summary.table().to_json(orient="records") or "[]")
        print(
            json.dumps(
                {"event": "report", "out": str(out), "files": [*map(str, summary.files)], "rows": table}
            )
        )
        return 0
    return print_report(render(summary), out, summary.files)


def print_report(rendered: object, out: Path, files: Sequence[Path]) -> int:
    """A report at its end: what it says, and the files that hold it."""
    from rich.console import Console

    from gpcjax.report.words import printable

    width = None if sys.stdout.isatty() else 160  # a file or pipe is no narrow terminal
    Console(width=width).print(rendered)
    print(printable(f"{out}: {', '.join(path.name for path in files)}", sys.stdout.encoding))
    return 0


def compare(arguments: argparse.Namespace) -> int:
    """`gpcjax compare`."""
    given = None if arguments.out is None else parse(OPTIONS["out"], arguments.out, "--out")
    folders = [Path(os.path.expanduser(folder)) for folder in arguments.folder]
    for each in folders:
        check_report(each)
    from gpcjax.report.compare import compare, usual_out
    from gpcjax.report.compare_page import terminal

    comparison = compare(*folders, by=arguments.by)
    names = [folder.name for folder in comparison.folders]
    out = usual_out(names) if given is None else Path(os.path.expanduser(given))
    return print_report(terminal(comparison), out, comparison.save(out))


def runs(below: Path, as_json: bool) -> int:
    """`gpcjax runs`."""
    from gpcjax.sweep.listing import run_folders

    folders = list(run_folders(below))
    if as_json:
        for folder in folders:
            print(json.dumps(folder.as_json()))
    elif folders:
        from gpcjax.report import folders as told
        from gpcjax.report.terminal import show_sheet

        show_sheet(told.sheet(folders, below))
    else:
        print(f"{below}: it holds no run folders")
    return 0


def show_folder(out: Path, as_json: bool) -> int:
    """`gpcjax show`."""
    from gpcjax.sweep.listing import looked_into

    folder, held = looked_into(out)
    if as_json:
        print(json.dumps(folder.as_json() | dataclasses.asdict(held)))
        return 0
    from gpcjax.report import folders as told
    from gpcjax.report.terminal import show_facts

    show_facts(str(out), told.facts(folder, held))
    return 0
