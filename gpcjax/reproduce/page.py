"""The report of a reproduction: one HTML page that needs nothing else, and its claims as Markdown. Loads no jax."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape

from gpcjax.report import html
from gpcjax.report.html import Picture
from gpcjax.report.tables import Sheet
from gpcjax.reproduce.parts import CHANGES, PARTS, Part
from gpcjax.reproduce.results import Experiment, Results
from gpcjax.reproduce.verdicts import FAILS, HOLDS, Claim

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
        html.paragraph(_counted(every)),
        html.table(_verdicts(claims)),
        *(html.paragraph(line) for line in READING),
    ]
    for name, part in {**PARTS, "all": ACROSS}.items():
        if name in pictures or claims.get(name):
            body.append(f"<h2>{escape(part.title)}</h2>")
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
    head = "section", "claim", "verdict", "estimate [95 % interval]", "n"
    return _markdown_table(
        head,
        [
            (claim.section, claim.text, _emphasised(claim), _estimates(claim), _numbers(claim))
            for claim in _all(claims)
        ],
    )


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
        _counted(list(_all(claims))),
        *READING,
        _markdown_table(
            ("section", "claim", "verdict", "statistic", "estimate [95 % interval]", "n"),
            [
                (
                    claim.section,
                    claim.text,
                    _emphasised(claim),
                    claim.statistic,
                    _estimates(claim),
                    _numbers(claim),
                )
                for claim in _all(claims)
            ],
        ),
    ]
    for part, figures in captions.items():
        parts.append(f"## {PARTS[part].title}")
        parts += [f"![{name}](figures/{name}.png)\n\n{caption}" for name, caption in figures.items()]
    parts += [
        "## What differs from the thesis",
        "\n".join(f"- **{name}**: {text}" for name, text in CHANGES.items()),
        "## What was run",
        "\n".join(f"    {command}" for command in commands),
        _markdown_table(runs.columns, runs.rows),
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
    return claim.verdict if claim.verdict == HOLDS else f"**{_shortened(claim)}**"


def _estimates(claim: Claim) -> str:
    if len(claim.tests) > MOST_TESTS:
        lowest, highest = (choose(claim.tests, key=lambda test: test.value.estimate) for choose in (min, max))
        return f"from {lowest.shown} ({lowest.condition}) to {highest.shown} ({highest.condition})"
    return "; ".join(_estimate(test.condition, test.shown, len(claim.tests)) for test in claim.tests)


READING = (
    "A claim holds where the 95 % bootstrap interval of its statistic lies wholly on the claimed side, under each "
    "of the conditions that are named; with fewer runs intervals are wider, and fewer claims can be shown to hold. "
    "Differences are between runs of the same seed, which have the same starts and the same draws of the teacher. "
    "Final return: mean of a run's last five episodes. Area: mean return of an episode. n: runs, or pairs of runs.",
    "Nothing is corrected for the number of tests.",
)

MOST_TESTS = 6
"""Conditions of a claim that a line of the Markdown shows; the page shows all."""


def _shortened(claim: Claim) -> str:
    if len(claim.tests) <= MOST_TESTS or claim.verdict == FAILS:
        return claim.verdict
    failing = [test.condition for test in claim.tests if not test.verdict]
    holding = [test.condition for test in claim.tests if test.verdict]
    if len(failing) < len(holding):
        return f"{HOLDS} but at {', '.join(failing)}"
    return f"{HOLDS} at {', '.join(holding)}"


def _estimate(condition: str, shown: str, tests: int) -> str:
    return shown if tests == 1 else f"{condition}: {shown}"


def _numbers(claim: Claim) -> str:
    runs = sorted({test.runs for test in claim.tests})
    return str(runs[0]) if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"


def _counted(claims: Sequence[Claim]) -> str:
    whole = sum(claim.verdict == HOLDS for claim in claims)
    none = sum(claim.verdict == FAILS for claim in claims)
    partly = len(claims) - whole - none
    return f"Of {len(claims)} claims {whole} hold, {partly} hold under some conditions, {none} do not hold."


def _verdicts(claims: Mapping[str, Sequence[Claim]]) -> Sheet:
    rows, breaks = [], []
    for each in claims.values():
        rows += [(claim.section, claim.text, _shortened(claim)) for claim in each]
        breaks.append(len(rows) - 1)
    return Sheet("verdicts", ("section", "claim", "verdict"), tuple(rows), frozenset(breaks))


def _tests(claims: Sequence[Claim]) -> Sheet:
    rows, breaks = [], []
    for claim in claims:
        for position, test in enumerate(claim.tests):
            first = position == 0
            rows.append(
                (
                    claim.text if first else "",
                    claim.statistic if first else "",
                    test.condition,
                    test.shown,
                    str(test.runs),
                    "yes" if test.verdict else "no",
                )
            )
        breaks.append(len(rows) - 1)
    columns = ("claim", "statistic", "condition", "estimate", "n", "holds")
    return Sheet("what tests each claim", columns, tuple(rows), frozenset(breaks))


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
    return Sheet("runs; those that stopped early are in no number", columns, tuple(rows))


def _machine(results: Mapping[str, Experiment]) -> Iterable[str]:
    for experiment in list(results.values())[:1]:
        yield html.facts("Machine", experiment.study.manifest["machine"])
        yield html.facts("Versions", experiment.study.manifest["versions"])


def _warning(quick: bool) -> str:
    if not quick:
        return ""
    text = "A quick reproduction: a few short runs of each experiment, to see that all works. Its verdicts mean little."
    return f'<div class="warning"><p>{escape(text)}</p></div>'
