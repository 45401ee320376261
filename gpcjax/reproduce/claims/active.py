"""Claims of 5.3, Table 5.4: active learning (AL) and the adaptive learning rate (ALR), and what 5.4.2 says of them."""

from collections.abc import Callable
from typing import NamedTuple

from gpcjax.report.groups import FINAL_EPISODES
from gpcjax.reproduce.claims.common import taught_by
from gpcjax.reproduce.measures import Measure
from gpcjax.reproduce.parts import ABLATIONS, COMPARED_RATE, ROWS, Ablation
from gpcjax.reproduce.results import Experiment, Runs
from gpcjax.reproduce.verdicts import ABOVE_ZERO, BELOW_ZERO, Claim, Claimed, Test, test

SECTION = "5.3"

OTHERS = {"ii": "active learning alone", "iii": "the adaptive rate alone", "iv": "the baseline"}

PUBLISHED = {"i": 0.0386, "iii": 0.0374}
"""Average learning rates that the thesis reports."""


class Table(NamedTuple):
    """The rows of a variant of Table 5.4: what can be measured of their runs."""

    ablation: Ablation
    i: Runs
    ii: Runs
    iii: Runs
    iv: Runs

    def row(self, name: str) -> Runs:
        """By its number in the thesis."""
        return getattr(self, name)


def active(*experiments: Experiment) -> list[Claim]:
    """Each claim in each variant of the table, which is its condition: with some of them its rows change order."""
    size = len(ROWS)
    tables = [
        Table(ablation, *(each.only_runs for each in experiments[size * place : size * (place + 1)]))
        for place, ablation in enumerate(ABLATIONS.values())
    ]
    made = [*_areas(tables), *_feedback(tables), *_mean_rates(tables), *_courses(tables)]
    oracles = taught_by(*experiments)
    return [Claim(SECTION, text, statistic, tests, oracles) for text, statistic, tests in made]


Made = list[tuple[str, str, tuple[Test, ...]]]
"""Text, statistic and tests of claims."""


def _each(
    tables: list[Table], values: Callable[[Table], Measure], claimed: Claimed, decimals: int = 0
) -> tuple[Test, ...]:
    """A test for each variant, which is its condition."""
    return tuple(test(each.ablation.name, values(each), claimed, decimals) for each in tables)


def _areas(tables: list[Table]) -> Made:
    orders = [
        ("Active learning alone beats the baseline", "ii", "iv"),
        ("The adaptive rate alone beats the baseline", "iii", "iv"),
        *((f"Both together are better than {name}", "i", row) for row, name in OTHERS.items()),
    ]
    return [
        (
            text,
            f"{first} - {second} in area, above 0",
            _each(tables, lambda t, a=first, b=second: t.row(a).area - t.row(b).area, ABOVE_ZERO),
        )
        for text, first, second in orders
    ]


def _feedback(tables: list[Table]) -> Made:
    """By count, and as corrections a step: the paper's Fig. 9b shows the rate. Who stays up longer has more steps."""
    orders = [
        *((f"Both together need less feedback than {name}", "i", row) for row, name in OTHERS.items()),
        ("The adaptive rate needs less feedback than the baseline", "iii", "iv"),
    ]
    ways: list[tuple[str, str, Callable[[Runs], Measure], int]] = [
        ("count", "corrections of a run", lambda runs: runs.corrections, 0),
        ("rate", "corrections a step", lambda runs: runs.feedback, 4),
    ]
    return [
        (
            f"{text} ({way})",
            f"{first} - {second} in the {what}, below 0",
            _each(
                tables,
                lambda t, a=first, b=second, of=values: of(t.row(a)) - of(t.row(b)),
                BELOW_ZERO,
                decimals,
            ),
        )
        for text, first, second in orders
        for way, what, values, decimals in ways
    ]


def _mean_rates(tables: list[Table]) -> Made:
    """Where the static rate is what the thesis compares with; elsewhere they are far below it, or it is no claim."""
    compared = [each for each in tables if each.ablation.static_rate == COMPARED_RATE]
    ways: list[tuple[str, str, Callable[[Runs], Measure]]] = [
        (
            "mean of runs",
            "mean learning rate of a run's corrections, mean over runs",
            lambda runs: runs.mean_rate,
        ),
        (
            "pooled",
            "mean learning rate of the corrections of all runs together",
            lambda runs: runs.pooled_rate,
        ),
    ]
    return [
        (
            f"The mean rate of {row} ({value} in the thesis) is below the static {COMPARED_RATE:g} ({way})",
            f"{what}, below {COMPARED_RATE:g}, where that is the static rate",
            _each(compared, lambda t, row=row, of=values: of(t.row(row)), Claimed(upper=COMPARED_RATE), 4),
        )
        for row, value in PUBLISHED.items()
        for way, what, values in ways
    ]


def _courses(tables: list[Table]) -> Made:
    """Of learning rates over the teaching, Fig. 5.8."""

    def fall(runs: Runs) -> Measure:
        return runs.rate(1, 10).log10() - runs.rate(21, 40).log10()

    made: Made = [
        (
            "The rate of i falls more slowly than that of iii",
            "log10 of the mean rate of corrections 1 to 10 over that of 21 to 40, iii less i; above 0",
            _each(tables, lambda t: fall(t.iii) - fall(t.i), ABOVE_ZERO, 2),
        )
    ]
    for row in PUBLISHED:
        made += [
            (
                f"The adaptive rate of {row} takes bigger steps than the static rate at first",
                "mean rate of corrections 1 to 10, less r_c; above 0",
                _each(
                    tables,
                    lambda t, row=row: t.row(row).rate(1, 10) - t.ablation.static_rate,
                    ABOVE_ZERO,
                    3,
                ),
            ),
            (
                f"The adaptive rate of {row} takes smaller steps than the static rate at last",
                f"mean rate of the corrections of the last {FINAL_EPISODES} episodes, less r_c; below 0",
                _each(
                    tables,
                    lambda t, row=row: t.row(row).late_rate - t.ablation.static_rate,
                    BELOW_ZERO,
                    3,
                ),
            ),
        ]
    made.append(
        (
            "With both, the chance of advice and the learning rate go together",
            "rank correlation over the episodes of a run of i, chance of advice with mean learning rate; above 0",
            _each(tables, lambda t: t.i.chance_with_rate, ABOVE_ZERO, 2),
        )
    )
    return made
