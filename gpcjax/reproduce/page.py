"""The report of a reproduction: one HTML page that needs nothing else, and its claims as Markdown. Loads no jax."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from gpcjax.report import html, words
from gpcjax.report.html import Picture
from gpcjax.report.tables import Sheet
from gpcjax.reproduce.parts import CHANGES, CIRCLE, PARTS, Part, taught_by_gpc
from gpcjax.reproduce.results import Experiment, Results
from gpcjax.reproduce.verdicts import HOLDS, NOT_TESTED, Claim, Test, counted

ACROSS = Part("Across the tasks (5.4 and 6)", ())


def page(
    claims: Mapping[str, Sequence[Claim]],
    pictures: Mapping[str, Sequence[Picture]],
    sheets: Mapping[str, Sequence[Sheet]],
    results: Results,
    commands: Sequence[str],
    quick: bool,
) -> str:
    """The whole document. `claims`, `pictures` and `sheets` are by part; `results` by the name of their experiment."""
    every = [claim for each in claims.values() for claim in each]
    body = [
        "<h1>The thesis, reproduced</h1>",
        '<p class="lead">D. Wout, Policy Learning with Human Teachers: every experiment that needs no person, its '
        "figures, and what becomes of each claim about the results.</p>",
        _warning(quick),
        "<h2>Claims</h2>",
        html.paragraph(counted(every)),
        html.table(_verdicts(claims)),
        *(html.paragraph(line) for line in READING),
    ]
    for name, part in {**PARTS, "all": ACROSS}.items():
        if name in pictures or claims.get(name):
            body.append(f"<h2>{escape(part.title)}</h2>")
            body += [html.paragraph(line) for line in _taught(claims.get(name, ()))]
            body += [html.picture(picture) for picture in pictures.get(name, ())]
            body += [html.table(sheet) for sheet in sheets.get(name, ())]
            if claims.get(name):
                body.append(html.table(_tests(claims[name])))
    body += [
        "<h2>What differs from the thesis</h2>",
        html.definitions(CHANGES),
        "<h2>What was run</h2>",
        *(f"<p><code>{escape(command)}</code></p>" for command in commands),
        html.table(_runs(results)),
        *_machine(results),
    ]
    return html.document("The thesis, reproduced", body)


def markdown(claims: Mapping[str, Sequence[Claim]]) -> str:
    """The claims as a table for a README, a row each."""
    return _claims_table(claims, ())


def _claims_table(claims: Mapping[str, Sequence[Claim]], more: Sequence[str]) -> str:
    """A row for each claim; `more` are columns that not every table has room for: "statistic"."""
    columns = ("section", "claim", "verdict", "after Holm", *more, "estimate [95 % interval]", "n", "oracle")
    rows = [
        {
            "section": claim.section,
            "claim": claim.text,
            "verdict": _emphasised(claim),
            "after Holm": _after_holm(claim),
            "statistic": _statistic(claim),
            "estimate [95 % interval]": _estimates(claim),
            "n": _numbers(claim),
            "oracle": _oracles(claim),
        }
        for claim in _all(claims)
    ]
    return _markdown_table(columns, [[row[name] for name in columns] for row in rows])


def csv_of(claims: Mapping[str, Sequence[Claim]]) -> str:
    """A line for each test. `p` is of Student's t, `p_holm` after Holm's correction over the part."""
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    names = ("condition", "estimate", "lower", "upper", "n", "claimed_above", "claimed_below")
    rows.writerow(
        ("part", "section", "claim", "statistic", "oracle", *names, "p", "p_holm", "verdict", "verdict_holm")
    )
    for part, each in claims.items():
        for claim in each:
            head = part, claim.section, claim.text, claim.statistic, " ".join(claim.oracles)
            for one in claim.tests:
                bounds = (bound if np.isfinite(bound) else "" for bound in one.claimed)
                tested = one.p, one.adjusted, str(one.verdict), str(one.corrected)
                rows.writerow((*head, one.condition, *one.value, one.runs, *bounds, *tested))
    return stream.getvalue()


def markdown_report(
    claims: Mapping[str, Sequence[Claim]],
    captions: Mapping[str, Mapping[str, str]],
    results: Results,
    commands: Sequence[str],
) -> str:
    """The report as Markdown: `captions` are by part and name of the figure, which lies beside as figures/NAME.png."""
    runs = _runs(results)
    manifests = [experiment.study.manifest for experiment in results.values()]
    parts = [
        "# The thesis, reproduced",
        "What `make reproduce` makes of every experiment in D. Wout, *Policy Learning with Human Teachers*, that "
        "needs no person. This page, its figures and `claims.csv` are its output.",
        "## Claims",
        counted(list(_all(claims))),
        *READING,
        _claims_table(claims, ("statistic",)),
    ]
    for part, figures in captions.items():
        parts.append(f"## {PARTS[part].title}")
        parts += _taught(claims.get(part, ()))
        parts += [f"![{name}](figures/{name}.png)\n\n{caption}" for name, caption in figures.items()]
    parts += [
        "## What differs from the thesis",
        "\n".join(f"- **{name}**: {text}" for name, text in CHANGES.items()),
        "## What was run",
        "\n".join(f"    {command}" for command in commands),
        _markdown_table(runs.columns, runs.rows),
        "\n".join(
            f"- not run: {name}"
            for part in PARTS.values()
            for name in part.experiments
            if name not in results
        ),
        "\n".join(
            f"- {title}: "
            + "; ".join(f"{name} {value}" for name, value in manifests[0][key].items() if name != "platform")
            for title, key in (("Machine", "machine"), ("Versions", "versions"))
            if manifests
        ),
    ]
    return "\n\n".join(part.rstrip() for part in parts if part) + "\n"


def _markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def _all(claims: Mapping[str, Sequence[Claim]]) -> Iterable[Claim]:
    return (claim for each in claims.values() for claim in each)


def _emphasised(claim: Claim) -> str:
    return claim.short if claim.verdict == HOLDS else f"**{claim.short}**"


def _after_holm(claim: Claim) -> str:
    return "the same" if claim.corrected == claim.short else claim.corrected


def _statistic(claim: Claim) -> str:
    return f"{claim.statistic} ({claim.remark})" if claim.remark else claim.statistic


def _oracles(claim: Claim) -> str:
    return (
        ", ".join(f"{name} ({CIRCLE})" if taught_by_gpc(name) else name for name in claim.oracles) or "none"
    )


def _taught(claims: Sequence[Claim]) -> Iterable[str]:
    """Next to the results of a part: which of its oracles GPC itself taught, and which owe nothing to it."""
    oracles = tuple(dict.fromkeys(name for claim in claims for name in claim.oracles))
    circle = [name for name in oracles if taught_by_gpc(name)]
    if circle:
        yield (
            f"Oracles that GPC itself taught: {', '.join(circle)}. That is {CIRCLE}: a learner of the same kind is "
            "taught by what GPC has learned, which may suit it better than others."
        )
    others = [name for name in oracles if not taught_by_gpc(name)]
    if others:
        yield f"Oracles that owe nothing to GPC: {', '.join(others)}."


def _estimates(claim: Claim) -> str:
    if len(claim.tests) > MOST_TESTS:
        tested = [test for test in claim.tests if test.verdict != NOT_TESTED] or claim.tests
        lowest, highest = (choose(tested, key=lambda test: test.value.estimate) for choose in (min, max))
        return f"from {lowest.shown} ({lowest.condition}) to {highest.shown} ({highest.condition})"
    return "; ".join(_estimate(test, len(claim.tests)) for test in claim.tests)


READING = (
    "A claim holds where the 95 % interval of its statistic lies wholly on the claimed side; it is refuted where the "
    "interval lies wholly on another side, not shown where it lies across the line, and not tested where there are "
    "fewer than five runs. A claim with several conditions has one verdict where all agree; a claim of most of them "
    "holds where more than half do. With fewer runs intervals are wider, and less can be shown either way. "
    "Differences are between runs of the same seed, which have the same starts and the same draws of the teacher. "
    "Final return: mean of a run's last five episodes. Area: mean return of an episode. Converged: a final return that "
    "closes 90 % of the gap from the idle policy to the oracle. n: runs, or pairs of runs.",
    "The plain verdicts are not corrected for the number of tests. After Holm: what the verdict is if, of all tests of "
    "the same part of this report, those count alone that Holm's correction leaves significant at 5 %; its p are of "
    "Student's t on the same numbers, since a bootstrap cannot tell p as small as it takes.",
)

MOST_TESTS = 6
"""Conditions of a claim whose estimates a line of the Markdown shows; the page shows all."""


def _estimate(test: Test, tests: int) -> str:
    return test.shown if tests == 1 else f"{test.condition}: {test.shown}"


def _numbers(claim: Claim) -> str:
    runs = sorted({test.runs for test in claim.tests}) or [0]
    return str(runs[0]) if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"


def _verdicts(claims: Mapping[str, Sequence[Claim]]) -> Sheet:
    rows, breaks = [], []
    for each in claims.values():
        rows += [
            (claim.section, claim.text, claim.short, _after_holm(claim), _oracles(claim)) for claim in each
        ]
        breaks.append(len(rows) - 1)
    columns = ("section", "claim", "verdict", "after Holm", "oracle")
    return Sheet("verdicts", columns, tuple(rows), frozenset(breaks))


def _tests(claims: Sequence[Claim]) -> Sheet:
    rows, breaks = [], []
    for claim in claims:
        for position, test in enumerate(claim.tests):
            first = position == 0
            rows.append(
                (
                    claim.text if first else "",
                    _statistic(claim) if first else "",
                    test.condition,
                    test.shown,
                    str(test.runs),
                    test.told,
                    _p(test.p),
                    _p(test.adjusted),
                )
            )
        breaks.append(len(rows) - 1)
    columns = ("claim", "statistic", "condition", "estimate", "n", "verdict", "p", "p (Holm)")
    return Sheet("what tests each claim", columns, tuple(rows), frozenset(breaks))


def _p(value: float) -> str:
    if np.isnan(value):
        return words.ABSENT
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _runs(results: Results) -> Sheet:
    rows = []
    for name, experiment in results.items():
        manifest = experiment.study.manifest
        rows.append(
            (
                name,
                f"{manifest['cells']:,}",
                f"{experiment.study.episodes}",
                f"{sum(len(group.stopped) for group in experiment.study.groups)}",
                f"{manifest['env_steps']:,}",
                f"{manifest['wall_time_s']:,.0f}",
                str(manifest["hash"]),
            )
        )
    columns = ("experiment", "runs", "episodes", "stopped", "steps", "wall time (s)", "hash")
    return Sheet("runs; those that stopped count as idle from then on", columns, tuple(rows))


def _machine(results: Mapping[str, Experiment]) -> Iterable[str]:
    for experiment in list(results.values())[:1]:
        yield html.facts("Machine", experiment.study.manifest["machine"])
        yield html.facts("Versions", experiment.study.manifest["versions"])


def _warning(quick: bool) -> str:
    if not quick:
        return ""
    text = "A quick reproduction: a few short runs of each experiment, to see that all works. Its verdicts mean little."
    return f'<div class="warning"><p>{escape(text)}</p></div>'
