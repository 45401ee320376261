"""What the report of a reproduction says, as a document, and its tests as CSV. Loads no jax."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from gpcjax.report import words
from gpcjax.report.content import facts
from gpcjax.report.document import (
    Block,
    Code,
    Definitions,
    Document,
    Heading,
    Kind,
    Paragraph,
    Picture,
    Sheet,
    Warnings,
)
from gpcjax.reproduce.parts import CHANGES, CIRCLE, PARTS, Part, taught_by_gpc
from gpcjax.reproduce.results import Results
from gpcjax.reproduce.verdicts import HOLDS, NOT_TESTED, Claim, Test, counted

LEAD = (
    "D. Wout, Policy Learning with Human Teachers: every experiment that needs no person, its figures, and what "
    "becomes of each claim about the results."
)
BESIDE = "Made by the command below, with its figures. Every test of every claim is a line of claims.csv."
QUICK = "A quick reproduction: a few short runs of each experiment, to see that all works. Its verdicts mean little."

ACROSS = Part("Across the tasks (5.4 and 6)", ())


KINDS: dict[str, Kind] = {
    **{name: "word" for name in ("section", "condition", "experiment")},
    **{name: "prose" for name in ("claim", "statistic", "verdict", "after Holm", "oracle")},
}
"""Of the columns that hold no numbers."""


def page(
    claims: Mapping[str, Sequence[Claim]],
    pictures: Mapping[str, Sequence[Picture]],
    sheets: Mapping[str, Sequence[Sheet]],
    results: Results,
    commands: Sequence[str],
    quick: bool = False,
    brief: bool = False,
) -> Document:
    """The whole report. `claims`, `pictures` and `sheets` are by part; `results` by the name of their experiment.

    A `brief` one, for a file that people read as text, has a line for each claim with its estimates, and no tables of
    the parts; else each part has a table of every test.
    """
    blocks: list[Block] = [Paragraph(LEAD, lead=True)]
    blocks += [Paragraph(BESIDE)] if brief else []
    blocks += [Warnings((QUICK,))] if quick else []
    blocks += [
        Heading("Claims"),
        Paragraph(counted(list(_all(claims)))),
        *(() if brief else (_verdicts(claims),)),
        *map(Paragraph, READING),
        *((claims_table(claims, ("statistic",)),) if brief else ()),
    ]
    for name, part in {**PARTS, "all": ACROSS}.items():
        if pictures.get(name) or (claims.get(name) and not brief):
            blocks += [Heading(part.title), *map(Paragraph, _taught(claims.get(name, ())))]
            blocks += pictures.get(name, ())
            if not brief:
                blocks += sheets.get(name, ())
                blocks += [_tests(claims[name])] if claims.get(name) else []
    blocks += [
        Heading("What differs from the thesis"),
        Definitions(CHANGES),
        Heading("What was run"),
        Code(tuple(commands)),
        _runs(results),
        *_not_run(results),
        *_machine(results, brief),
    ]
    return Document("The thesis, reproduced", tuple(blocks))


def claims_table(claims: Mapping[str, Sequence[Claim]], more: Sequence[str] = ()) -> Sheet:
    """A row for each claim; `more` are columns that not every table has room for: "statistic".

    A verdict that is not the claimed one stands out.
    """
    columns = ("section", "claim", "verdict", "after Holm", *more, "estimate [95 % interval]", "n", "oracle")
    rows = [
        {
            "section": claim.section,
            "claim": claim.text,
            "verdict": claim.short,
            "after Holm": _after_holm(claim),
            "statistic": _statistic(claim),
            "estimate [95 % interval]": _estimates(claim),
            "n": _numbers(claim),
            "oracle": _oracles(claim),
        }
        for claim in _all(claims)
    ]
    place = columns.index("verdict")
    strong = [(row, place) for row, claim in enumerate(_all(claims)) if claim.verdict != HOLDS]
    cells = tuple(tuple(row[name] for name in columns) for row in rows)
    return Sheet("", columns, cells, kinds=KINDS, strong=frozenset(strong))


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


def _all(claims: Mapping[str, Sequence[Claim]]) -> Iterable[Claim]:
    return (claim for each in claims.values() for claim in each)


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
"""Conditions of a claim whose estimates a line of the brief report shows; the other shows all."""


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
    return Sheet("verdicts", columns, tuple(rows), frozenset(breaks), KINDS)


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
    return Sheet("what tests each claim", columns, tuple(rows), frozenset(breaks), KINDS)


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
    return Sheet("runs; those that stopped count as idle from then on", columns, tuple(rows), kinds=KINDS)


def _not_run(results: Results) -> Iterator[Block]:
    missing = [name for part in PARTS.values() for name in part.experiments if name not in results]
    if missing:
        yield Paragraph(f"Not run: {', '.join(missing)}.")


def _machine(results: Results, brief: bool) -> Iterator[Block]:
    """Of the first experiment. What is published names no kernel of a machine."""
    for experiment in list(results.values())[:1]:
        machine = experiment.study.manifest["machine"]
        yield from facts(
            "Machine", {name: machine[name] for name in machine if name != "platform" or not brief}
        )
        yield from facts("Versions", experiment.study.manifest["versions"])
