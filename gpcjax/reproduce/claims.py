"""What the thesis claims of its results, each claim with the statistic that tests it. Loads no jax.

A claim is tested under one condition or several (an error rate each, most often). A test holds where the 95 % interval
of its statistic lies wholly on the claimed side; "alike" means within a margin, wholly. Differences are between runs of
the same seed. Nothing is corrected for the number of tests.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gpcjax.report import words
from gpcjax.report.groups import Group, unique
from gpcjax.report.statistics import Interval, Scores, mean_interval, paired_difference
from gpcjax.reproduce.parts import ABLATIONS, ROWS
from gpcjax.reproduce.records import Illustrations
from gpcjax.reproduce.results import EARLY, Experiment, Results, early, scaled

ALIKE = 0.05
"""Two returns are alike within this part of the gap from idle to oracle."""

HOLDS, FAILS = "holds", "does not hold"


@dataclass(frozen=True)
class Test:
    """A statistic under one condition: `verdict` is whether the claim holds there."""

    condition: str
    value: Interval
    runs: int
    verdict: bool
    decimals: int = 0

    @property
    def shown(self) -> str:
        """The estimate with its interval."""
        return words.interval(self.value, self.decimals)


@dataclass(frozen=True)
class Claim:
    """One claim: where it stands, what it says, what tests it."""

    section: str
    text: str
    statistic: str
    tests: tuple[Test, ...]

    @property
    def verdict(self) -> str:
        """Holds, holds under some of the conditions, or does not hold."""
        holding = [test.condition for test in self.tests if test.verdict]
        if len(holding) == len(self.tests):
            return HOLDS
        return f"{HOLDS} at {', '.join(holding)}" if holding else FAILS


def claims(results: Results, illustrations: Illustrations | None = None) -> dict[str, list[Claim]]:
    """The claims of each part whose experiments are there, and those that the illustrations speak of."""
    makers: dict[str, tuple[Callable[..., list[Claim]], tuple[str, ...]]] = {
        "pendulum": (_pendulum, ("pendulum",)),
        "cartpole": (_cartpole, ("cartpole",)),
        "lander": (_lander, ("lander",)),
        "active": (_active, tuple(f"{name}_{row}" for name in ABLATIONS for row in ROWS)),
        "oracles": (_oracles, ("oracles_cartpole",)),
        "all": (_across, ("pendulum", "cartpole", "lander")),
    }
    tested = {} if illustrations is None else {"illustrations": _illustrated(illustrations)}
    return tested | {
        part: make(*(results[name] for name in names))
        for part, (make, names) in makers.items()
        if all(name in results for name in names)
    }


def _illustrated(shown: Illustrations) -> list[Claim]:
    """What single, deterministic examples show: there is no interval."""
    sparse, late, erroneous = shown.sparsification, shown.late, shown.erroneous
    average = sparse.target[0].cumsum() / np.arange(1, sparse.target.shape[1] + 1)
    behind = np.abs(sparse.after - np.stack([average, sparse.target[1]])).max(axis=1)
    upright = (late.theta[None] / 0.4) ** 2 + (late.theta_dot[:, None] / 1.5) ** 2 < 1
    sigma = late.sigma_human
    return [
        Claim(
            "3.4.3",
            "Appended points make the action the average of all targets; with SPARS it follows the last one",
            "largest distance of the action from that, over twelve corrections at one state; below 0.001",
            tuple(
                _test(name, _exactly(value), 1, lambda i: i.estimate < 1e-3, 5)
                for name, value in zip(("appending", "SPARS"), behind.tolist(), strict=True)
            ),
        ),
        Claim(
            "5.1.1",
            "Around the upright rest sigma_h is reduced, so that refinements are small",
            "mean sigma_h of the taught policy's actions within 0.4 rad and 1.5 rad/s of it, less that elsewhere",
            (
                _test(
                    "40 episodes",
                    _exactly(float(sigma[upright].mean() - sigma[~upright].mean())),
                    1,
                    lambda i: i.estimate < 0,
                    3,
                ),
            ),
        ),
        Claim(
            "5.4.1",
            "With a long l_h a wrong advice takes more right ones to compensate",
            f"right advices until the action is back, l_h = {erroneous.length_scales[1]:g} less "
            f"{erroneous.length_scales[0]:g}, the {erroneous.wrong}rd advice wrong",
            tuple(
                _test(
                    words.algorithm(str(algo)),
                    _exactly(float(samples[1] - samples[0])),
                    1,
                    lambda i: i.estimate > 0,
                )
                for algo, samples in zip(erroneous.algorithms, erroneous.samples, strict=True)
            ),
        ),
    ]


def _exactly(value: float) -> Interval:
    return Interval(value, np.nan, np.nan)


def _pendulum(experiment: Experiment) -> list[Claim]:
    area, margin = _area(experiment), ALIKE * experiment.gap
    errors = experiment.study.errors
    loss = _change_of_difference(experiment, errors)
    last = errors[-1]
    return [
        *_outperforms("5.1.1", experiment, "gpc", "coach"),
        *_outperforms("5.1.1", experiment, "gpc-ns", "coach"),
        _alike(
            "5.1.1",
            "GPC and GPC-NS behave alike",
            experiment,
            "gpc",
            "gpc-ns",
            lambda group: group.area,
            "area",
        ),
        Claim(
            "5.1.1",
            "GPC's learning curve is steeper than COACH's at the beginning",
            f"GPC - COACH, mean return of the first {EARLY} episodes",
            _each(
                experiment,
                lambda e: _above(early(experiment.group("gpc", e)), early(experiment.group("coach", e))),
            ),
        ),
        _alike(
            "5.1.1",
            "GPC's and COACH's final performance is similar",
            experiment,
            "gpc",
            "coach",
            lambda group: group.final,
            "final return",
        ),
        Claim(
            "5.1.1",
            "GPC's advantage over COACH shrinks with erroneous advice",
            f"(GPC - COACH) in area without errors less that at {words.percent(last)}",
            (_test(f"0% against {words.percent(last)}", *loss, lambda i: i.lower > 0),),
        ),
        Claim(
            "5.1.1",
            f"At {words.percent(last)} error GPC has only a slight advantage over COACH",
            f"GPC - COACH in area, between 0 and {words.percent(ALIKE)} of the gap from idle to oracle "
            f"({margin:.0f})",
            (
                _test(
                    words.percent(last),
                    *paired_difference(area("gpc", last), area("coach", last)),
                    lambda i: i.lower > 0 and i.upper < margin,
                ),
            ),
        ),
        *_rate_claims(experiment),
    ]


def _rate_claims(experiment: Experiment) -> list[Claim]:
    """Fig. 5.2: learning rates over the first corrections."""

    def window(algo: str, error: float, first: int, last: int) -> Scores:
        group = experiment.group(algo, error)
        rates = experiment.rates(group)[:, first - 1 : last]
        known = ~np.isnan(rates).any(axis=1)
        return Scores(group.seeds[known], np.log10(rates[known].mean(axis=1)))

    def fall(algo: str, error: float) -> Scores:
        return _minus(window(algo, error, 1, 20), window(algo, error, 101, 150))

    errors, last = experiment.study.errors, experiment.study.errors[-1]
    statistic = (
        "log10 of the mean rate of corrections 1 to 20 less that of 101 to 150, within runs that have so many"
    )
    claims = [
        Claim(
            "5.1.1",
            f"{words.algorithm(algo)}'s learning rate falls",
            statistic,
            tuple(_test(words.percent(e), *_mean(fall(algo, e)), lambda i: i.lower > 0, 2) for e in errors),
        )
        for algo in ("gpc", "gpc-ns")
    ]
    rise = [_minus(window("coach", e, 41, 60), window("coach", e, 1, 10)) for e in errors]
    claims.append(
        Claim(
            "5.1.1",
            "COACH's first steps are small, and its learning rate rises with consistent advice",
            "log10 of the mean rate of corrections 41 to 60 less that of 1 to 10",
            tuple(
                _test(words.percent(e), *_mean(each), lambda i: i.lower > 0, 2)
                for e, each in zip(errors, rise, strict=True)
            ),
        )
    )
    claims.append(
        Claim(
            "5.1.1",
            "Errors make the fall of the learning rate more gradual",
            f"that fall without errors less the fall at {words.percent(last)}",
            tuple(
                _test(
                    words.algorithm(algo),
                    *paired_difference(fall(algo, errors[0]), fall(algo, last)),
                    lambda i: i.lower > 0,
                    2,
                )
                for algo in ("gpc", "gpc-ns")
            ),
        )
    )
    return claims


def _cartpole(experiment: Experiment) -> list[Claim]:
    errors, gap = experiment.study.errors, experiment.gap
    last = errors[-1]

    def final(algo: str, error: float) -> Scores:
        return experiment.group(algo, error).final

    def loss(algo: str) -> Scores:
        return _minus(final(algo, errors[0]), final(algo, last))

    return [
        *_outperforms("5.1.2", experiment, "gpc", "coach"),
        *_outperforms("5.1.2", experiment, "gpc-ns", "coach"),
        Claim(
            "5.1.2",
            "GPC and GPC-NS have a steeper initial learning curve than COACH",
            f"difference to COACH in mean return of the first {EARLY} episodes",
            tuple(
                _above(
                    early(experiment.group(algo, e)),
                    early(experiment.group("coach", e)),
                    f"{words.algorithm(algo)} {words.percent(e)}",
                )
                for algo in ("gpc", "gpc-ns")
                for e in errors
            ),
        ),
        _alike(
            "5.1.2",
            "GPC-NS approaches GPC without errors",
            experiment,
            "gpc",
            "gpc-ns",
            lambda group: group.final,
            "final return",
            errors[:1],
        ),
        Claim(
            "5.1.2",
            "GPC-NS is brittle to errors where GPC is robust",
            f"GPC-NS' loss of final return from 0% to {words.percent(last)} error, less GPC's",
            (
                _test(
                    words.percent(last),
                    *paired_difference(loss("gpc-ns"), loss("gpc")),
                    lambda i: i.lower > 0,
                ),
            ),
        ),
        Claim(
            "5.1.2",
            "COACH is brittle to errors",
            f"COACH's loss of final return from 0% to {words.percent(last)} error, more than half of what it has",
            (
                _test(
                    words.percent(last),
                    *paired_difference(final("coach", errors[0]), final("coach", last)),
                    lambda i: i.lower > 0.5 * float(final("coach", errors[0]).values.mean()),
                ),
            ),
        ),
        Claim(
            "5.1.2",
            "GPC is very robust to errors",
            "GPC's final return less that of the idle policy, in parts of the gap to the oracle; above 0.8",
            tuple(
                _test(words.percent(e), *_mean(_closed(experiment, "gpc", e)), lambda i: i.lower > 0.8, 2)
                for e in errors[1:]
            ),
        ),
        Claim(
            "5.3",
            "COACH attains convergence without errors",
            "COACH's final return less that of the idle policy, in parts of the gap to the oracle; above 0.8",
            (_test("0%", *_mean(_closed(experiment, "coach", errors[0])), lambda i: i.lower > 0.8, 2),),
        ),
        Claim(
            "5.1.2",
            f"GPC stays ahead of GPC-NS at {words.percent(last)} error by much",
            f"GPC - GPC-NS in final return, above a fifth of the gap from idle to oracle ({0.2 * gap:.0f})",
            (
                _test(
                    words.percent(last),
                    *paired_difference(final("gpc", last), final("gpc-ns", last)),
                    lambda i: i.lower > 0.2 * gap,
                ),
            ),
        ),
    ]


def _lander(experiment: Experiment) -> list[Claim]:
    closed = "final return less that of the idle policy, in parts of the gap to the oracle"
    return [
        *_outperforms("5.1.3", experiment, "gpc", "coach"),
        *_outperforms("5.1.3", experiment, "gpc-ns", "coach"),
        Claim(
            "5.1.3",
            "COACH attains no performance",
            f"COACH's {closed}; below 0.1",
            _each(
                experiment, lambda e: _mean_test(_closed(experiment, "coach", e), lambda i: i.upper < 0.1, 2)
            ),
        ),
        _alike(
            "5.1.3",
            "GPC and GPC-NS perform alike",
            experiment,
            "gpc",
            "gpc-ns",
            lambda group: group.final,
            "final return",
        ),
        Claim(
            "5.1.3",
            "GPC converges at every error rate",
            f"GPC's {closed}; above 0.9",
            _each(
                experiment, lambda e: _mean_test(_closed(experiment, "gpc", e), lambda i: i.lower > 0.9, 2)
            ),
        ),
        Claim(
            "5.1.3",
            "GPC-NS converges at every error rate",
            f"GPC-NS' {closed}; above 0.9",
            _each(
                experiment, lambda e: _mean_test(_closed(experiment, "gpc-ns", e), lambda i: i.lower > 0.9, 2)
            ),
        ),
    ]


def _active(*experiments: Experiment) -> list[Claim]:
    """Table 5.4, in each of its variants: with some of them the order of its rows is another."""
    size = len(ROWS)
    variants = {
        name: Table(*experiments[size * place : size * (place + 1)])
        for place, (name, _) in enumerate(ABLATIONS.values())
    }

    def area(first: str, second: str) -> tuple[Test, ...]:
        return tuple(
            _above(getattr(table, first).only.area, getattr(table, second).only.area, condition)
            for condition, table in variants.items()
        )

    def fewer(first: str, second: str) -> tuple[Test, ...]:
        return tuple(
            _test(
                condition,
                *paired_difference(
                    getattr(table, first).only.corrections_used, getattr(table, second).only.corrections_used
                ),
                lambda i: i.upper < 0,
            )
            for condition, table in variants.items()
        )

    def rates(row: str) -> tuple[Test, ...]:
        return tuple(
            _test(condition, *_mean(_mean_rate(getattr(table, row))), lambda i: i.upper < 0.04, 4)
            for condition, table in variants.items()
        )

    used = "difference in the corrections of a run"
    return [
        Claim("5.3", "Active learning alone beats the baseline", "ii - iv in area", area("ii", "iv")),
        Claim("5.3", "The adaptive rate alone beats the baseline", "iii - iv in area", area("iii", "iv")),
        *(
            Claim("5.3", f"Both together are better than {name}", f"i - {row} in area", area("i", row))
            for row, name in OTHERS.items()
        ),
        *(
            Claim(
                "5.3", f"Both together need less feedback than {name}", f"i - {row}, {used}", fewer("i", row)
            )
            for row, name in OTHERS.items()
        ),
        Claim(
            "5.3",
            "The adaptive rate needs less feedback than the baseline",
            f"iii - iv, {used}",
            fewer("iii", "iv"),
        ),
        *(
            Claim(
                "5.3",
                f"The mean rate of {row} ({value} in the thesis) is below the static 0.04",
                "mean learning rate of a run's corrections, mean over runs",
                rates(row),
            )
            for row, value in (("i", 0.0386), ("iii", 0.0374))
        ),
        Claim(
            "5.3",
            "The rate of i falls more slowly than that of iii",
            "log10 of the mean rate of corrections 1 to 10 over that of 21 to 40, iii less i",
            tuple(
                _test(
                    condition, *paired_difference(_fall(table.iii), _fall(table.i)), lambda i: i.lower > 0, 2
                )
                for condition, table in variants.items()
            ),
        ),
    ]


class Table(NamedTuple):
    """The rows of Table 5.4."""

    i: Experiment
    ii: Experiment
    iii: Experiment
    iv: Experiment


OTHERS = {"ii": "active learning alone", "iii": "the adaptive rate alone", "iv": "the baseline"}


def _mean_rate(experiment: Experiment) -> Scores:
    """Mean learning rate over all corrections of a run."""
    group = experiment.only
    counts = experiment.rows(group, "corrections")
    sums = np.nansum(experiment.rows(group, "mean_rate") * counts, axis=1)
    known = counts.sum(axis=1) > 0
    return Scores(group.seeds[known], sums[known] / counts.sum(axis=1)[known])


def _fall(experiment: Experiment) -> Scores:
    """How far the learning rate falls over the first 40 corrections, as a logarithm; of runs that have so many."""
    group, rates = experiment.only, experiment.rates(experiment.only)[:, :40]
    known = ~np.isnan(rates).any(axis=1)
    return Scores(
        group.seeds[known], np.log10(rates[known, :10].mean(axis=1) / rates[known, 20:].mean(axis=1))
    )


def _oracles(experiment: Experiment) -> list[Claim]:
    """The cart-pole's order again, for each oracle and each distance within which it is silent."""
    study = experiment.study
    deltas = unique(group.point.get("delta") for group in study.groups)

    def order(first: str, second: str, error: float) -> Claim:
        tests = []
        for oracle in study.oracles:
            for delta in deltas:
                groups = [experiment.group(algo, error, oracle, delta) for algo in (first, second)]
                condition = oracle if delta is None else f"{oracle} {delta:g}"
                tests.append(_above(groups[0].area, groups[1].area, condition))
        names = f"{words.algorithm(first)} outperforms {words.algorithm(second)}"
        where = "oracle and delta" if deltas != (None,) else "oracle"
        return Claim(
            "5.1.2",
            f"{names} at {words.percent(error)} error, whatever the {where}",
            f"{words.algorithm(first)} - {words.algorithm(second)} in area",
            tuple(tests),
        )

    pairs = (("gpc", "coach"), ("gpc-ns", "coach"), ("gpc", "gpc-ns"))
    return [order(*pair, error) for pair in pairs for error in study.errors]


def _across(pendulum: Experiment, cartpole: Experiment, lander: Experiment) -> list[Claim]:
    domains = {"pendulum": pendulum, "cart-pole": cartpole, "lander": lander}

    def margin(experiment: Experiment, error: float) -> Scores:
        area = _area(experiment)
        return scaled(_minus(area("gpc", error), area("coach", error)), experiment.gap)

    def never_exceeded(name: str, experiment: Experiment, other: str) -> Iterable[Test]:
        area = _area(experiment)
        for error in experiment.study.errors:
            interval, pairs = paired_difference(area(other, error), area("gpc", error))
            condition = f"{name} {words.percent(error)} {words.algorithm(other)}"
            yield Test(condition, interval, pairs, not interval.lower > 0)

    def near(name: str, experiment: Experiment) -> Iterable[Test]:
        for error in experiment.study.errors:
            groups = [experiment.group(algo, error) for algo in ("gpc-ns", "gpc")]
            difference = scaled(_minus(groups[0].final, groups[1].final), experiment.gap)
            yield _mean_test(difference, lambda i: i.lower > -2 * ALIKE, 2, f"{name} {words.percent(error)}")

    return [
        Claim(
            "5.4.1",
            "No algorithm ever exceeds GPC",
            "the other's area less GPC's, not above zero",
            tuple(
                test
                for name, experiment in domains.items()
                for other in ("gpc-ns", "coach")
                for test in never_exceeded(name, experiment, other)
            ),
        ),
        Claim(
            "5.4.1",
            "GPC's lead over COACH is largest on the lander, the most complex task",
            "(GPC - COACH) in area, in parts of each task's gap, on the lander less that elsewhere; means over the "
            "error rates",
            tuple(
                _test(
                    f"against {name}",
                    *paired_difference(
                        _average([margin(lander, e) for e in lander.study.errors]),
                        _average([margin(domains[name], e) for e in domains[name].study.errors]),
                    ),
                    lambda i: i.lower > 0,
                    2,
                )
                for name in ("pendulum", "cart-pole")
            ),
        ),
        Claim(
            "6.1",
            "GPC-NS approaches GPC's final performance in most experiments",
            f"GPC-NS - GPC in final return, in parts of the gap; above {-2 * ALIKE:g}",
            tuple(test for name, experiment in domains.items() for test in near(name, experiment)),
        ),
    ]


def _outperforms(section: str, experiment: Experiment, first: str, second: str) -> list[Claim]:
    area = _area(experiment)
    return [
        Claim(
            section,
            f"{words.algorithm(first)} outperforms {words.algorithm(second)} at every error rate",
            f"{words.algorithm(first)} - {words.algorithm(second)} in area",
            _each(experiment, lambda e: _above(area(first, e), area(second, e))),
        )
    ]


def _alike(
    section: str,
    text: str,
    experiment: Experiment,
    first: str,
    second: str,
    scores: Callable[[Group], Scores],
    name: str,
    errors: Sequence[float] | None = None,
) -> Claim:
    margin = ALIKE * experiment.gap
    tests = []
    for error in experiment.study.errors if errors is None else errors:
        pair = (scores(experiment.group(algo, error)) for algo in (first, second))
        interval, pairs = paired_difference(*pair)
        verdict = -margin < interval.lower and interval.upper < margin
        tests.append(Test(words.percent(error), interval, pairs, verdict))
    statistic = (
        f"{words.algorithm(first)} - {words.algorithm(second)} in {name}, within {words.percent(ALIKE)} of the gap "
        f"from idle to oracle (±{margin:.0f})"
    )
    return Claim(section, text, statistic, tuple(tests))


def _area(experiment: Experiment) -> Callable[[str, float], Scores]:
    return lambda algo, error: experiment.group(algo, error).area


def _closed(experiment: Experiment, algo: str, error: float) -> Scores:
    final = experiment.group(algo, error).final
    return Scores(final.seeds, (final.values - experiment.study.idle.mean) / experiment.gap)


def _change_of_difference(experiment: Experiment, errors: Sequence[float]) -> tuple[Interval, int]:
    area = _area(experiment)
    first, last = (_minus(area("gpc", e), area("coach", e)) for e in (errors[0], errors[-1]))
    return paired_difference(first, last)


def _each(experiment: Experiment, make: Callable[[float], Test]) -> tuple[Test, ...]:
    return tuple(
        Test(words.percent(e), test.value, test.runs, test.verdict, test.decimals)
        for e in experiment.study.errors
        for test in (make(e),)
    )


def _above(first: Scores, second: Scores, condition: str = "") -> Test:
    return _test(condition, *paired_difference(first, second), lambda i: i.lower > 0)


def _mean_test(scores: Scores, holds: Callable[[Interval], bool], decimals: int, condition: str = "") -> Test:
    return _test(condition, *_mean(scores), holds, decimals)


def _test(
    condition: str, value: Interval, runs: int, holds: Callable[[Interval], bool], decimals: int = 0
) -> Test:
    return Test(condition, value, runs, bool(holds(value)), decimals)


def _mean(scores: Scores) -> tuple[Interval, int]:
    return mean_interval(scores.values[:, None]), len(scores.values)


def _minus(first: Scores, second: Scores) -> Scores:
    seeds, mine, theirs = np.intersect1d(first.seeds, second.seeds, assume_unique=True, return_indices=True)
    return Scores(seeds, first.values[mine] - second.values[theirs])


def _average(scores: Sequence[Scores]) -> Scores:
    seeds = scores[0].seeds
    for each in scores[1:]:
        seeds = np.intersect1d(seeds, each.seeds, assume_unique=True)
    values = [each.values[np.searchsorted(each.seeds, seeds)] for each in scores]
    return Scores(seeds, np.mean(values, axis=0))
