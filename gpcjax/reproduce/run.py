"""Runs the experiments of a reproduction, as far as they are not done, and draws what it shows. Loads no jax."""

import csv
import functools
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console

from gpcjax.errors import Failure
from gpcjax.report import style
from gpcjax.report.html import Picture
from gpcjax.report.tables import Sheet, result_sheets
from gpcjax.reproduce import figures, page, records, sketches
from gpcjax.reproduce.claims import claims
from gpcjax.reproduce.parts import ABLATIONS, PARTS, ROWS, check
from gpcjax.reproduce.records import Illustrations
from gpcjax.reproduce.results import Experiment, joined, read
from gpcjax.reproduce.verdicts import Claim
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.executors import run_alone
from gpcjax.sweep.run import run
from gpcjax.sweep.runfolder import check_sweep, make_writable
from gpcjax.sweep.schedule import offered_rates
from gpcjax.sweep.spec import Given, SweepSpec, make_spec, read_toml

ILLUSTRATIONS = "illustrations.npz"


def reproduce(sweeps: Path, out: Path, only: Sequence[str], quick: bool, jobs: int) -> Path:
    """Runs what is missing of these parts, and draws all parts that are there; gives the report.

    Args:
        sweeps: where the TOML files are.
        out: what runs and report are written to, a run folder for each experiment.
        only: names of `PARTS`.
        quick: with the small settings of each file.
        jobs: processes at once.

    Raises:
        UserError: see `check`.
        Failure: a worker failed; what was finished is kept.
    """
    check(sweeps, out, only, quick)
    make_writable(out)
    console = Console(stderr=True)
    for part in only:
        console.print(PARTS[part].title, style="bold")
        if part == "illustrations" and not (out / ILLUSTRATIONS).exists():
            _illustrate(out / ILLUSTRATIONS)
        for name in PARTS[part].experiments:
            spec = _spec(sweeps / f"{name}.toml", out, quick)
            check_sweep(out / name, spec)
            make_writable(out / name)
            run(spec, out / name, jobs)
    return draw(out, quick)


def draw(out: Path, quick: bool) -> Path:
    """Writes figures, claims and the page from what `out` holds."""
    results = _results(out)
    shown = records.read(out / ILLUSTRATIONS) if (out / ILLUSTRATIONS).exists() else None
    tested, drawn = claims(results, shown), _figures(results, shown)
    pictures: dict[str, list[Picture]] = {}
    for (part, name), (figure, alternative, caption) in drawn.items():
        svg = style.image(figure, "svg")
        pictures.setdefault(part, []).append(Picture(svg, figure.get_figwidth(), alternative, caption))
        make_writable(out / "figures")
        for kind in ("png", "pdf"):
            write_atomic(out / "figures" / f"{name}.{kind}", style.image(figure, kind))
    stored = {name: results[name] for part in PARTS.values() for name in part.experiments if name in results}
    command = "make reproduce" + (" QUICK=1" if quick else "")
    write_atomic(out / "claims.csv", _csv(tested))
    write_atomic(out / "claims.md", page.markdown(tested))
    captions: dict[str, dict[str, str]] = {}
    for (part, name), (_, _, caption) in drawn.items():
        captions.setdefault(part, {})[name] = caption
    write_atomic(out / "report.md", page.markdown_report(tested, captions, stored, [command]))
    report = out / "report.html"
    write_atomic(report, page.page(tested, pictures, _sheets(results), stored, [command], quick))
    return report


def _illustrate(path: Path) -> None:
    if run_alone("gpcjax.reproduce.illustrations", str(path)):
        raise Failure("the illustrations could not be computed")


def _spec(path: Path, out: Path, quick: bool) -> SweepSpec:
    given = read_toml(path, quick)
    source = given.pop("rate_from", None)
    if source is not None:
        rates = offered_rates(out / Path(source.value).name)
        given["rate_schedule"] = Given(rates, source.where)
    return make_spec(given)


def _results(out: Path) -> dict[str, Experiment]:
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
) -> dict[tuple[str, str], tuple[Figure, str, str]]:
    """By part and name of the file: the figure, what it shows in a few words, and its caption."""
    drawn: dict[tuple[str, str], tuple[Figure, str, str]] = {}
    if shown is not None:
        drawn |= {("illustrations", name): figure for name, figure in _illustrations(shown)}
    for part, number in (("pendulum", "5.1"), ("cartpole", "5.4"), ("lander", "5.5")):
        if part in results:
            experiment = results[part]
            drawn[part, f"fig{number.replace('.', '_')}_returns"] = (
                figures.returns(experiment),
                f"Fig. {number}",
                f"Fig. {number}: return against episode at each error rate ({_runs(experiment)}). Strong lines: "
                "walking mean of 3 episodes of the mean over runs, with its 95 % interval; faint lines: the mean "
                "itself. Dashed: the oracle, with one standard deviation; dotted: the idle policy.",
            )
    if "pendulum" in results:
        drawn["pendulum", "fig5_2_learning_rates"] = (
            figures.rates(results["pendulum"]),
            "Fig. 5.2",
            f"Fig. 5.2: learning rate of the first 150 corrections ({_runs(results['pendulum'])}): walking mean of "
            "3 of the mean over runs, with its 95 % interval, over the mean itself; below, normalised as in the "
            "paper's Fig. 6, each by its largest value. A line ends where fewer than half of the runs have so many "
            "corrections.",
        )
    for stem, (_, setting) in ABLATIONS.items():
        rows = {row: results[f"{stem}_{row}"] for row in ROWS if f"{stem}_{row}" in results}
        if len(rows) == len(ROWS):
            what = f"the rows of Table 5.4 with {setting}; cart-pole, 10 % error ({_runs(rows['i'])} each)"
            name = stem.removeprefix("table5_4")
            drawn["active", f"fig5_7_ablation{name}"] = (
                figures.ablation(rows),
                "Fig. 5.7",
                f"Fig. 5.7: {what}. Return and feedback of each episode, walking means of 3 with 95 % intervals "
                "over the raw means; and the chance of advice that the teacher offered, which in iii and iv is "
                "that of i and ii.",
            )
            drawn["active", f"fig5_8_ablation_rates{name}"] = (
                figures.ablation_rates(rows),
                "Fig. 5.8",
                f"Fig. 5.8: learning rate of each correction, {what}. Walking means of 3 with 95 % intervals over "
                "the raw means.",
            )
    if "oracles_cartpole" in results:
        drawn["oracles", "oracles_cartpole"] = (
            figures.dependence(results["oracles_cartpole"]),
            "Dependence on oracle and delta",
            "Cart-pole: differences in area on the same seeds, mean with 95 % interval "
            f"({_runs(results['oracles_cartpole'])} each), for four oracles and four distances delta within which "
            "they are silent.",
        )
    return drawn


def _illustrations(shown: Illustrations) -> Iterable[tuple[str, tuple[Figure, str, str]]]:
    yield (
        "fig2_2_hyperparameters",
        (
            sketches.hyperparameters(shown.hyperparameters),
            "Fig. 2.2",
            "Fig. 2.2: the same points with guessed hyperparameters and with those of largest marginal likelihood.",
        ),
    )
    yield (
        "fig3_2_three_corrections",
        (
            sketches.situations(shown.situations),
            "Fig. 3.2",
            "Fig. 3.2: a policy over one state dimension and the uncertainty of its human model, through two "
            "corrections at x = 0 and a step without any.",
        ),
    )
    yield (
        "fig3_3_learning_rate",
        (
            sketches.early_plane(shown.early),
            "Fig. 3.3",
            "Fig. 3.3: policy and learning rate over the pendulum's state space after five episodes of advice.",
        ),
    )
    yield (
        "fig3_4_sparsification",
        (
            sketches.sparsification(shown.sparsification),
            "Fig. 3.4",
            "Fig. 3.4: the action at one state under repeated advice, with plain appending, which averages all "
            "targets, and with SPARS, which follows them.",
        ),
    )
    yield (
        "fig5_3_state_space",
        (
            sketches.late_plane(shown.late),
            "Fig. 5.3",
            "Fig. 5.3: policy, its uncertainty and that of the human model over the pendulum's state space, after "
            "40 episodes without errors.",
        ),
    )
    yield (
        "fig5_9_erroneous_advice",
        (
            sketches.erroneous(shown.erroneous),
            "Fig. 5.9",
            "Fig. 5.9: one wrong advice among right ones, with a short and a long length-scale of the human model. "
            "Right: how many right ones it takes until the action is back, over length-scales. That a long one "
            "needs more shows for GPC-NS, and not for GPC.",
        ),
    )


def _sheets(results: Mapping[str, Experiment]) -> dict[str, Sequence[Sheet]]:
    return {
        part: result_sheets(results[part].summary)
        for part in ("pendulum", "cartpole", "lander")
        if part in results
    }


def _runs(experiment: Experiment) -> str:
    runs = sorted({group.runs for group in experiment.study.groups})
    return f"{runs[0]} runs" if len(runs) == 1 else f"{runs[0]} to {runs[-1]} runs"


def _csv(tested: Mapping[str, Sequence[Claim]]) -> str:
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(
        ("part", "section", "claim", "statistic", "condition", "estimate", "lower", "upper", "n", "holds")
    )
    for part, each in tested.items():
        for claim in each:
            for test in claim.tests:
                head = part, claim.section, claim.text, claim.statistic, test.condition
                rows.writerow((*head, *test.value, test.runs, str(test.verdict).lower()))
    return stream.getvalue()
