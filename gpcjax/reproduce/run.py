"""Runs the experiments of a reproduction, as far as they are not done, and draws what it shows. Loads no jax."""

import functools
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from gpcjax.report import html, markdown
from gpcjax.report.document import Picture, Sheet
from gpcjax.report.figures import style
from gpcjax.report.figures.painted import painted
from gpcjax.report.figures.style import Drawing
from gpcjax.report.files import write_files
from gpcjax.report.tables import result_sheets
from gpcjax.reproduce import figures, page, records, sketched_errors, sketched_planes, sketches
from gpcjax.reproduce.claims import claims
from gpcjax.reproduce.parts import ABLATIONS, DEPENDENCE, PARTS, ROWS, check
from gpcjax.reproduce.records import Illustrations
from gpcjax.reproduce.results import Experiment, joined, read
from gpcjax.reproduce.verdicts import Claim, counted
from gpcjax.sweep.estimate import seconds_left
from gpcjax.sweep.executors import Errands, Processes
from gpcjax.sweep.given import Given
from gpcjax.sweep.manifest import is_complete
from gpcjax.sweep.plan import count, plan, program_of
from gpcjax.sweep.runfolder import check_sweep, make_writable
from gpcjax.sweep.schedule import offered_rates
from gpcjax.sweep.several import run_several
from gpcjax.sweep.spec import SweepSpec, make_spec, read_toml
from gpcjax.sweep.works import works_of

ILLUSTRATIONS = "illustrations.npz"
_MEND = "make room and give the right to write"


def reproduce(sweeps: Path, out: Path, only: Sequence[str], quick: bool, jobs: int) -> Path:
    """Runs what is missing of these parts, and draws all parts that are there; gives the report.

    Says on the standard error, a line each: what an experiment costs before it runs, and at the end how many claims met
    which verdict.

    Args:
        sweeps: where the TOML files are.
        out: what runs and report are written to, a run folder for each experiment.
        only: names of `PARTS`.
        quick: with the small settings of each file.
        jobs: processes at once.

    Raises:
        UserError: see `check`.
        Failure: a worker or the process of the illustrations failed; what was finished is kept.
    """
    experiments = check(sweeps, out, only, quick)
    make_writable(out)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    errands: list[tuple[str, tuple[Any, ...]]] = []
    if "illustrations" in only and records.stored(out / ILLUSTRATIONS) is None:
        console.print(PARTS["illustrations"].title, style="bold")
        console.print("illustrations: computed once, about a minute")
        errands.append(("gpcjax.reproduce.illustrations:compute", (out / ILLUSTRATIONS,)))
    place, left = 0, {name: part for part in only for name in PARTS[part].experiments}
    with Processes(jobs) as executor:  # they import once, and keep what they have compiled
        while left or errands:
            asked: list[tuple[SweepSpec, Path]] = []
            heading = None
            for name, part in (_ready(sweeps, left, quick) or dict(left)).items():
                if part != heading:
                    heading = part
                    console.print(PARTS[part].title, style="bold")
                spec = _spec(sweeps / f"{name}.toml", out, quick)
                check_sweep(out / name, spec, grows=False)
                place += 1
                console.print(f"{name}, {place} of {experiments}: {_cost(spec, out / name, jobs)}")
                asked.append((spec, out / name))
                del left[name]
            run_several("reproduction", asked, executor, Errands(errands))
            errands = []
    report, tested = _drawn(out, quick)
    console.print(counted([claim for each in tested.values() for claim in each]))
    return report


def draw(out: Path, quick: bool) -> Path:
    """Writes figures, claims and the page from what `out` holds; gives the page."""
    return _drawn(out, quick)[0]


def _drawn(out: Path, quick: bool) -> tuple[Path, dict[str, list[Claim]]]:
    results = results_of(out)
    shown = records.stored(out / ILLUSTRATIONS)
    tested, drawn = claims(results, shown), _figures(results, shown)
    pictures: dict[str, list[Picture]] = {}
    images = painted([drawing.figure for drawing in drawn.values()])
    for ((part, name), drawing), image in zip(drawn.items(), images, strict=True):
        pictures.setdefault(part, []).append(style.pictured(drawing, f"figures/{name}.png", image.svg))
        make_writable(out / "figures")
        named = {f"{name}.{kind}": content for kind, content in image.files.items()}
        write_files(out / "figures", named, _MEND)
    stored = {name: results[name] for part in PARTS.values() for name in part.experiments if name in results}
    commands = ["make reproduce" + (" QUICK=1" if quick else "")]
    whole = page.page(tested, pictures, _sheets(results), stored, commands, quick)
    brief = page.page(tested, pictures, {}, stored, commands, quick, brief=True)
    files = {
        "claims.csv": page.csv_of(tested),
        "claims.md": markdown.table(page.claims_table(tested)),
        "report.md": markdown.render(brief),
        "report.html": html.render(whole),
    }
    *_, report = write_files(out, files, _MEND)
    return report, tested


def _cost(spec: SweepSpec, out: Path, jobs: int) -> str:
    """Runs and episodes of an experiment, and about how long they take."""
    size = f"{count(spec):,} runs of {spec.episodes} episodes"
    if is_complete(out):
        return f"{size}, done"
    sizes = Counter(map(program_of, plan(spec)))
    seconds = seconds_left(list(works_of(sizes).values()), jobs)
    about = f"{max(10, 10 * round(seconds / 10))} s" if seconds < 90 else f"{round(seconds / 60)} min"
    return f"{size}, about {about} where nothing is done yet"


def _ready(sweeps: Path, left: Mapping[str, str], quick: bool) -> dict[str, str]:
    """Of the experiments that are left those that take no rates from another one of them, and their parts."""
    given = {name: read_toml(sweeps / f"{name}.toml", quick).get("rate_from") for name in left}
    return {
        name: part
        for name, part in left.items()
        if (source := given[name]) is None or Path(source.value).name not in left
    }


def _spec(path: Path, out: Path, quick: bool) -> SweepSpec:
    given = read_toml(path, quick)
    source = given.pop("rate_from", None)
    if source is not None:
        rates = offered_rates(out / Path(source.value).name)
        given["rate_schedule"] = Given(rates, source.source)
    return make_spec(given)


def results_of(out: Path) -> dict[str, Experiment]:
    """Every experiment that is complete, by its name; and those that make a part, by the name of the part."""
    results = {}
    for part, content in PARTS.items():
        found = {name: read(out / name) for name in content.experiments}
        present = {name: each for name, each in found.items() if each is not None}
        results |= present
        if present and part in ("pendulum", "cartpole"):
            (results[part],) = present.values()
        if part == "lander" and content.experiments[0] in present:
            results[part] = functools.reduce(joined, present.values())
    return results


def _figures(
    results: Mapping[str, Experiment], shown: Illustrations | None
) -> dict[tuple[str, str], Drawing]:
    """By part and name of the file."""
    drawn: dict[tuple[str, str], Drawing] = {}
    if shown is not None:
        drawn |= {("illustrations", name): drawing for name, drawing in _illustrations(shown).items()}
    for part, number in (("pendulum", "5.1"), ("cartpole", "5.4"), ("lander", "5.5")):
        if part in results:
            name = f"fig{number.replace('.', '_')}_returns"
            drawn[part, name] = figures.returns(results[part], number)
    if "pendulum" in results:
        drawn["pendulum", "fig5_2_learning_rates"] = figures.rates(results["pendulum"])
    for stem, variant in ABLATIONS.items():
        rows = {row: results[f"{stem}_{row}"] for row in ROWS if f"{stem}_{row}" in results}
        if len(rows) == len(ROWS):
            name = stem.removeprefix("table5_4")
            drawn["active", f"fig5_7_ablation{name}"] = figures.ablation(rows, variant)
            drawn["active", f"fig5_8_ablation_rates{name}"] = figures.ablation_rates(rows, variant)
    for name, (task, _) in DEPENDENCE.items():
        if name in results:
            drawn["oracles", name] = figures.dependence(results[name], task)
    return drawn


def _illustrations(shown: Illustrations) -> dict[str, Drawing]:
    return {
        "fig2_2_hyperparameters": sketches.hyperparameters(shown.hyperparameters),
        "fig3_2_three_corrections": sketches.situations(shown.situations),
        "fig3_3_learning_rate": sketched_planes.early_plane(shown.early),
        "fig3_4_sparsification": sketches.sparsification(shown.sparsification),
        "fig5_3_state_space": sketched_planes.late_plane(shown.late),
        "fig5_9_erroneous_advice": sketched_errors.erroneous(shown.erroneous),
    }


def _sheets(results: Mapping[str, Experiment]) -> dict[str, Sequence[Sheet]]:
    return {
        part: result_sheets(results[part].summary)
        for part in ("pendulum", "cartpole", "lander")
        if part in results
    }
