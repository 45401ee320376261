"""Makes every number and picture of README.md and docs/ from a finished reproduction (`make publish`).

    python -m docs.publish [FOLDER]     FOLDER is that of `make reproduce`, runs/reproduction if not given

What is made is written between marks (`<!-- results -->` ... `<!-- /results -->`) or as whole files, and
`docs/published.json` keeps what it was made of: the specification of each experiment, the machine and versions that ran
it, a checksum of every text and file, and `drawn`, a fingerprint of what this version of the program makes of fixed
data. `tests/test_published.py` compares these with the checkout: a specification, a statistic or a sentence that has
changed since, and a text that was edited by hand, are stale until somebody publishes again.
"""

import hashlib
import json
import re
import shutil
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gpcjax.report import markdown
from gpcjax.report.figures import curves, style
from gpcjax.report.tables import difference_sheets, reading, result_sheets
from gpcjax.reproduce import page
from gpcjax.reproduce.claims import claims
from gpcjax.reproduce.parts import PARTS, SWEEPS
from gpcjax.reproduce.results import Experiment
from gpcjax.reproduce.run import draw, results_of
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.plan import specification_hash
from gpcjax.sweep.spec import make_spec, read_toml

ROOT = Path(__file__).parents[1]
README, RECORD = ROOT / "README.md", ROOT / "docs" / "published.json"
PAGES = ROOT / "docs" / "reproduction"

THESIS = ROOT / "docs" / "thesis.md"
BLOCKS = {
    README: ("caption", "verdicts"),
    THESIS: ("verdicts", "claims"),
    ROOT / "docs" / "results.md": ("results",),
}
"""What is written into which page, each between its marks."""

OF_A_WHOLE = ("verdicts", "claims")
"""Blocks that only a reproduction of which nothing is missing can make."""

NAMES = {"cartpole": "Cart-pole", "pendulum": "Pendulum", "lander": "Lunar lander"}


def publish(folder: Path) -> None:
    """Writes the pages' blocks, docs/cartpole.png, the record of them, and docs/reproduction if nothing is missing."""
    results = results_of(folder)
    if "cartpole" not in results:
        raise SystemExit(
            f"{folder}: there is no finished reproduction of the cart-pole, run make reproduce first"
        )
    for place, names in BLOCKS.items():
        text = place.read_text()
        lacking = [
            name for name in names if not re.search(rf"<!-- {name} -->\n.*<!-- /{name} -->", text, re.DOTALL)
        ]
        if lacking:
            raise SystemExit(f"{place.name} has no marks for {', '.join(lacking)}")
    missing = [name for name in specifications() if name not in results]
    if missing:
        print(f"docs/reproduction and the claims stay: {', '.join(missing)} not run yet", file=sys.stderr)
    else:
        _pages(folder)
    picture = curves.learning_curves(results["cartpole"].summary)
    write_atomic(ROOT / "docs" / "cartpole.png", style.image(picture.figure, "png"))
    write_blocks(
        {
            "caption": f"{picture.caption} The first command below draws it.\n",
            "results": _results(results),
            "verdicts": verdicts(),
            "claims": (PAGES / "claims.md").read_text(),
        }
    )
    write_atomic(RECORD, json.dumps(_record(results), indent=1) + "\n")


def write_blocks(blocks: Mapping[str, str]) -> None:
    """Writes these between their marks, on every page that has them."""
    for place, names in BLOCKS.items():
        text = place.read_text()
        for name in names:
            if name in blocks:
                text = re.sub(
                    rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)",
                    lambda marks, block=blocks[name]: marks[1] + block + marks[2],
                    text,
                    flags=re.DOTALL,
                )
        write_atomic(place, text)


def verdicts() -> str:
    """How many claims hold, and which do not under any condition: as docs/reproduction has it."""
    counted = re.search(r"^Of \d+ claims .*$", (PAGES / "README.md").read_text(), re.MULTILINE)
    if counted is None:
        raise SystemExit("docs/reproduction/README.md does not say how many claims hold")
    rows = [line.strip("| ").split(" | ") for line in (PAGES / "claims.md").read_text().splitlines()[2:]]
    lines = [counted[0], ""]
    for verdict in ("refuted", "not shown"):
        lines += [
            f"- {verdict}: {text} ({section})"
            for section, text, found, *_ in rows
            if found == f"**{verdict}**"
        ]
    return "\n".join(lines) + "\n"


def _pages(folder: Path) -> None:
    draw(folder, quick=False)
    PAGES.mkdir(exist_ok=True)
    shutil.rmtree(PAGES / "figures", ignore_errors=True)
    shutil.copytree(folder / "figures", PAGES / "figures", ignore=shutil.ignore_patterns("*.pdf", ".*"))
    for source, target in (
        ("report.md", "README.md"),
        ("claims.csv", "claims.csv"),
        ("claims.md", "claims.md"),
    ):
        shutil.copyfile(folder / source, PAGES / target)


def published_files(whole: bool) -> dict[str, str]:
    """SHA-256 of what is made here, by its path; of a page of `BLOCKS`, of the text between each pair of marks.

    Without a `whole` reproduction docs/reproduction and the claims are not made, and stay as they are.
    """
    pages = sorted(path for path in PAGES.rglob("*") if path.is_file()) if whole else []
    files = [ROOT / "docs" / "cartpole.png", *pages]
    sums = {str(path.relative_to(ROOT)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    for place in BLOCKS:
        for name, block in re.findall(r"<!-- (\w+) -->\n(.*?)<!-- /\1 -->", place.read_text(), re.DOTALL):
            if whole or name not in OF_A_WHOLE:
                sums[f"{place.relative_to(ROOT)}: {name}"] = hashlib.sha256(block.encode()).hexdigest()
    return sums


def specifications() -> dict[str, str]:
    """The hash of each experiment as the checkout has it; of one that takes its rates from another's, of its file."""
    hashes = {}
    for name in (name for part in PARTS.values() for name in part.experiments):
        given = read_toml(SWEEPS / f"{name}.toml")
        if given.pop("rate_from", None) is None:
            hashes[name] = specification_hash(make_spec(given))
        else:
            hashes[name] = hashlib.sha256((SWEEPS / f"{name}.toml").read_bytes()).hexdigest()[:12]
    return hashes


def fingerprint(results: Mapping[str, Experiment]) -> str:
    """What this version makes of these experiments: tables, claims and the captions of their curves."""
    texts = [page.csv_of(claims(results))]
    for experiment in results.values():
        summary = experiment.summary
        texts += map(repr, result_sheets(summary) + difference_sheets(summary))
        texts += [*reading(summary), curves.learning_curves(summary).caption]
    # To six digits: the last ones are those of the processor, which is not what has become stale.
    rounded = re.sub(r"\d+\.\d+(e[-+]\d+)?", lambda number: f"{float(number[0]):.6g}", "\n".join(texts))
    return hashlib.sha256(rounded.encode()).hexdigest()[:12]


def fixed_data() -> dict[str, Experiment]:
    """Experiments made of formulas, for `fingerprint`."""
    from tests.reproduce import studies

    return {"cartpole": studies.experiment(), "pendulum": studies.experiment("pendulum")}


def _record(results: Mapping[str, Experiment]) -> dict[str, Any]:
    now = specifications()
    run = {name: results[name].study.manifest for name in now if name in results}
    return {
        "experiments": {name: now[name] for name in run},
        "missing": [name for name in now if name not in run],
        "machines": _distinct(manifest["machine"] for manifest in run.values()),
        "versions": _distinct(manifest["versions"] for manifest in run.values()),
        "drawn": fingerprint(fixed_data()),
        "files": published_files(whole=len(run) == len(now)),
    }


def _distinct(records: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    found: list[Mapping[str, Any]] = []
    for record in records:
        if record not in found:
            found.append(record)
    return found


def _results(results: Mapping[str, Experiment]) -> str:
    """Tables of the three tasks, and how to read them."""
    lines = []
    for part, name in NAMES.items():
        if part not in results:
            continue
        summary, specification = results[part].summary, results[part].study.manifest["specification"]
        (sheet,), differences = result_sheets(summary), difference_sheets(summary)
        lines += [f"**{name}**, {specification['episodes']} episodes, {sheet.title.partition(', ')[2]}:", ""]
        lines += [markdown.table(sheet), *map(markdown.table, differences)]
    return "\n".join([*lines, *reading(results["cartpole"].summary)]) + "\n"


if __name__ == "__main__":
    publish(Path(sys.argv[1]).expanduser() if sys.argv[1:] else Path("runs", "reproduction"))
