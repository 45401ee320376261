"""What the thesis claims of its results, each claim with the statistic that tests it. Loads no jax."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from gpcjax.report import words
from gpcjax.report.groups import unique
from gpcjax.report.statistics import Interval, Scores, paired_difference
from gpcjax.reproduce.parts import ABLATIONS, ROWS
from gpcjax.reproduce.records import Illustrations
from gpcjax.reproduce.results import EARLY, Experiment, Results, early, scaled
from gpcjax.reproduce.verdicts import (
    ALIKE,
    Claim,
    Test,
    above,
    alike,
    area_of,
    average,
    change_of_difference,
    closed,
    each_error,
    exactly,
    mean,
    mean_test,
    minus,
    outperforms,
    test,
)


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
                test(name, exactly(value), 1, lambda i: i.estimate < 1e-3, 5)
                for name, value in zip(("appending", "SPARS"), behind.tolist(), strict=True)
            ),
        ),
        Claim(
            "5.1.1",
            "Around the upright rest sigma_h is reduced, so that refinements are small",
            "mean sigma_h of the taught policy's actions within 0.4 rad and 1.5 rad/s of it, less that elsewhere",
            (
                test(
                    "40 episodes",
                    exactly(float(sigma[upright].mean() - sigma[~upright].mean())),
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
                test(
                    words.algorithm(str(algo)),
                    exactly(float(samples[1] - samples[0])),
                    1,
                    lambda i: i.estimate > 0,
                )
                for algo, samples in zip(erroneous.algorithms, erroneous.samples, strict=True)
            ),
        ),
    ]


def _pendulum(experiment: Experiment) -> list[Claim]:
    area, margin = area_of(experiment), ALIKE * experiment.gap
    errors = experiment.study.errors
    loss = change_of_difference(experiment, errors)
    last = errors[-1]
    return [
        *outperforms("5.1.1", experiment, "gpc", "coach"),
        *outperforms("5.1.1", experiment, "gpc-ns", "coach"),
        alike(
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
            each_error(
                experiment,
                lambda e: above(early(experiment.group("gpc", e)), early(experiment.group("coach", e))),
            ),
        ),
        alike(
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
            (test(f"0% against {words.percent(last)}", *loss, lambda i: i.lower > 0),),
        ),
        Claim(
            "5.1.1",
            f"At {words.percent(last)} error GPC has only a slight advantage over COACH",
            f"GPC - COACH in area, between 0 and {words.percent(ALIKE)} of the gap from idle to oracle "
            f"({margin:.0f})",
            (
                test(
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
        return minus(window(algo, error, 1, 20), window(algo, error, 101, 150))

    errors, last = experiment.study.errors, experiment.study.errors[-1]
    statistic = (
        "log10 of the mean rate of corrections 1 to 20 less that of 101 to 150, within runs that have so many"
    )
    claims = [
        Claim(
            "5.1.1",
            f"{words.algorithm(algo)}'s learning rate falls",
            statistic,
            tuple(test(words.percent(e), *mean(fall(algo, e)), lambda i: i.lower > 0, 2) for e in errors),
        )
        for algo in ("gpc", "gpc-ns")
    ]
    rise = [minus(window("coach", e, 41, 60), window("coach", e, 1, 10)) for e in errors]
    claims.append(
        Claim(
            "5.1.1",
            "COACH's first steps are small, and its learning rate rises with consistent advice",
            "log10 of the mean rate of corrections 41 to 60 less that of 1 to 10",
            tuple(
                test(words.percent(e), *mean(each), lambda i: i.lower > 0, 2)
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
                test(
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
        return minus(final(algo, errors[0]), final(algo, last))

    return [
        *outperforms("5.1.2", experiment, "gpc", "coach"),
        *outperforms("5.1.2", experiment, "gpc-ns", "coach"),
        Claim(
            "5.1.2",
            "GPC and GPC-NS have a steeper initial learning curve than COACH",
            f"difference to COACH in mean return of the first {EARLY} episodes",
            tuple(
                above(
                    early(experiment.group(algo, e)),
                    early(experiment.group("coach", e)),
                    f"{words.algorithm(algo)} {words.percent(e)}",
                )
                for algo in ("gpc", "gpc-ns")
                for e in errors
            ),
        ),
        alike(
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
                test(
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
                test(
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
                test(words.percent(e), *mean(closed(experiment, "gpc", e)), lambda i: i.lower > 0.8, 2)
                for e in errors[1:]
            ),
        ),
        Claim(
            "5.3",
            "COACH attains convergence without errors",
            "COACH's final return less that of the idle policy, in parts of the gap to the oracle; above 0.8",
            (test("0%", *mean(closed(experiment, "coach", errors[0])), lambda i: i.lower > 0.8, 2),),
        ),
        Claim(
            "5.1.2",
            f"GPC stays ahead of GPC-NS at {words.percent(last)} error by much",
            f"GPC - GPC-NS in final return, above a fifth of the gap from idle to oracle ({0.2 * gap:.0f})",
            (
                test(
                    words.percent(last),
                    *paired_difference(final("gpc", last), final("gpc-ns", last)),
                    lambda i: i.lower > 0.2 * gap,
                ),
            ),
        ),
    ]


def _lander(experiment: Experiment) -> list[Claim]:
    """GPC-NS takes so long there that a reproduction may not have it yet."""
    gained = "final return less that of the idle policy, in parts of the gap to the oracle"

    def gains(text: str, algo: str, bound: str, holds: Callable[[Interval], bool]) -> Claim:
        return Claim(
            "5.1.3",
            text,
            f"{words.algorithm(algo)}: {gained}; {bound}",
            each_error(experiment, lambda e: mean_test(closed(experiment, algo, e), holds, 2)),
        )

    def converges(algo: str) -> Claim:
        text = f"{words.algorithm(algo)} converges at every error rate"
        return gains(text, algo, "above 0.9", lambda i: i.lower > 0.9)

    claims = [
        *outperforms("5.1.3", experiment, "gpc", "coach"),
        gains("COACH attains no performance", "coach", "below 0.1", lambda i: i.upper < 0.1),
        converges("gpc"),
    ]
    if "gpc-ns" not in experiment.study.algorithms:
        return claims
    similar = alike(
        "5.1.3",
        "GPC and GPC-NS perform alike",
        experiment,
        "gpc",
        "gpc-ns",
        lambda group: group.final,
        "final return",
    )
    return [*claims, *outperforms("5.1.3", experiment, "gpc-ns", "coach"), similar, converges("gpc-ns")]


def _active(*experiments: Experiment) -> list[Claim]:
    """Table 5.4, in each of its variants: with some of them the order of its rows is another."""
    size = len(ROWS)
    variants = {
        name: Table(*experiments[size * place : size * (place + 1)])
        for place, (name, _) in enumerate(ABLATIONS.values())
    }

    def area(first: str, second: str) -> tuple[Test, ...]:
        return tuple(
            above(getattr(table, first).only.area, getattr(table, second).only.area, condition)
            for condition, table in variants.items()
        )

    def fewer(first: str, second: str) -> tuple[Test, ...]:
        return tuple(
            test(
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
            test(condition, *mean(_mean_rate(getattr(table, row))), lambda i: i.upper < 0.04, 4)
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
                test(
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
                tests.append(above(groups[0].area, groups[1].area, condition))
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
        area = area_of(experiment)
        return scaled(minus(area("gpc", error), area("coach", error)), experiment.gap)

    def never_exceeded(name: str, experiment: Experiment, other: str) -> Iterable[Test]:
        area = area_of(experiment)
        for error in experiment.study.errors:
            interval, pairs = paired_difference(area(other, error), area("gpc", error))
            condition = f"{name} {words.percent(error)} {words.algorithm(other)}"
            yield Test(condition, interval, pairs, not interval.lower > 0)

    def near(name: str, experiment: Experiment) -> Iterable[Test]:
        for error in experiment.study.errors:
            groups = [experiment.group(algo, error) for algo in ("gpc-ns", "gpc")]
            difference = scaled(minus(groups[0].final, groups[1].final), experiment.gap)
            yield mean_test(difference, lambda i: i.lower > -2 * ALIKE, 2, f"{name} {words.percent(error)}")

    return [
        Claim(
            "5.4.1",
            "No algorithm ever exceeds GPC",
            "the other's area less GPC's, not above zero",
            tuple(
                test
                for name, experiment in domains.items()
                for other in ("gpc-ns", "coach")
                if other in experiment.study.algorithms
                for test in never_exceeded(name, experiment, other)
            ),
        ),
        Claim(
            "5.4.1",
            "GPC's lead over COACH is largest on the lander, the most complex task",
            "(GPC - COACH) in area, in parts of each task's gap, on the lander less that elsewhere; means over the "
            "error rates",
            tuple(
                test(
                    name,
                    *paired_difference(
                        average([margin(lander, e) for e in lander.study.errors]),
                        average([margin(domains[name], e) for e in domains[name].study.errors]),
                    ),
                    lambda i: i.lower > 0,
                    2,
                )
                for name in ("pendulum", "cart-pole")
            ),
        ),
        Claim(
            "6.1",
            "GPC-NS approaches GPC's final performance (in most experiments, says the thesis)",
            f"GPC-NS - GPC in final return, in parts of the gap; above {-2 * ALIKE:g}",
            tuple(
                test
                for name, experiment in domains.items()
                if "gpc-ns" in experiment.study.algorithms
                for test in near(name, experiment)
            ),
        ),
    ]
