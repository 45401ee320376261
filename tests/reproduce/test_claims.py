"""Claims hold where made-up results say so, and nowhere else."""

import numpy as np
import pytest

from gpcjax.report.statistics import Interval
from gpcjax.reproduce.claims import claims
from gpcjax.reproduce.verdicts import ALIKE, FAILS, HOLDS, Claim
from gpcjax.reproduce.verdicts import Test as Outcome
from tests.reproduce.studies import LEVELS, experiment, table

LANDER = {"gpc": 0.97, "gpc-ns": 0.97, "coach": 0.02}


def the(tested, text):
    """The one claim that says this."""
    (found,) = (claim for claim in tested if text in claim.text)
    return found


def of(part, **settings):
    env = {"lander": "lunarlander"}.get(part, part)
    return claims({part: experiment(env, **settings)})[part]


class TestVerdict:
    def claim(self, *verdicts):
        tests = [Outcome(f"{i}0%", Interval(1.0, 0.5, 1.5), 9, verdict) for i, verdict in enumerate(verdicts)]
        return Claim("5", "It is so", "what tests it", tuple(tests))

    def test_words(self):
        assert self.claim(True, True).verdict == HOLDS == "holds"
        assert self.claim(False, False).verdict == FAILS == "does not hold"
        assert self.claim(True, False, True).verdict == "holds at 00%, 20%"

    def test_the_estimate_with_its_interval(self):
        (test,) = self.claim(True).tests
        assert test.shown == "1 [0, 2]"
        assert Outcome("", Interval(0.123, 0.05, 0.25), 9, True, 2).shown == "0.12 [0.05, 0.25]"

    def test_one_run_has_no_interval_and_shows_nothing(self):
        """Every test fails but the ones that say what is not so, which then need not hold either."""
        for part in ("pendulum", "cartpole", "lander"):
            tested = of(part, seeds=1)
            assert all(claim.verdict == FAILS for claim in tested)
            assert {test.runs for claim in tested for test in claim.tests} <= {0, 1}


class TestOrder:
    TEXT = "GPC outperforms COACH at every error rate"

    @pytest.mark.parametrize("part", ["pendulum", "cartpole", "lander"])
    @pytest.mark.parametrize(
        ("gpc", "verdict"),
        [
            ([0.9, 0.9, 0.9], HOLDS),
            ([0.9, 0.9, 0.4], "holds at 0%, 10%"),
            ([0.9, 0.4, 0.3], "holds at 0%"),
            ([0.4, 0.4, 0.3], FAILS),
            ([0.1, 0.1, 0.1], FAILS),
        ],
    )
    def test_at_each_error_rate(self, part, gpc, verdict):
        assert the(of(part, levels=LEVELS | {"gpc": gpc}), self.TEXT).verdict == verdict

    def test_the_statistic(self):
        """The mean difference in area, in units of the return, over all pairs of runs."""
        claim = the(of("cartpole", levels=LEVELS | {"gpc": [0.9, 0.65, 0.4]}), self.TEXT)
        estimates = [test.value.estimate / 2460 for test in claim.tests]
        assert estimates == pytest.approx([0.5, 0.25, 0.0], abs=0.005)
        assert [test.condition for test in claim.tests] == ["0%", "10%", "20%"]
        assert {test.runs for test in claim.tests} == {12}
        assert all(test.value.lower < test.value.estimate < test.value.upper for test in claim.tests)

    def test_runs_are_compared_with_those_of_their_seed(self):
        """A small lead shows although runs differ by ten times as much."""
        levels = LEVELS | {"gpc": 0.42}
        claim = the(of("cartpole", levels=levels, spread=0.2), self.TEXT)
        assert claim.verdict == HOLDS

    def test_a_steeper_beginning(self):
        text = "GPC's learning curve is steeper than COACH's at the beginning"
        assert the(of("pendulum", early={"coach": 0.1}), text).verdict == HOLDS
        assert the(of("pendulum", early={"coach": 1.9}), text).verdict == FAILS


class TestAlike:
    @pytest.mark.parametrize(
        ("difference", "verdict"),
        [
            (0.0, HOLDS),
            (0.03, HOLDS),
            (-0.03, HOLDS),
            (0.08, FAILS),
            (-0.08, FAILS),
            ([0.0, 0.08, 0.0], "holds at 0%, 20%"),
        ],
    )
    def test_within_the_margin_on_both_sides(self, difference, verdict):
        other = np.add(0.9, difference).tolist()
        tested = of("pendulum", levels=LEVELS | {"gpc-ns": other})
        assert the(tested, "GPC and GPC-NS behave alike").verdict == verdict
        tested = of("lander", levels=LANDER | {"gpc": 0.9, "gpc-ns": other})
        assert the(tested, "GPC and GPC-NS perform alike").verdict == verdict

    def test_the_whole_interval_has_to_be_within(self):
        """Not finding a difference is no finding that there is none."""
        tested = of("pendulum", levels=LEVELS, spread=3.0)
        claim = the(tested, "GPC and GPC-NS behave alike")
        margin = ALIKE * 1050
        assert claim.verdict == FAILS
        assert any(test.value.lower < -margin or test.value.upper > margin for test in claim.tests)


def levels(gpc=0.9, ns=0.9, coach=0.4):
    return {"levels": {"gpc": gpc, "gpc-ns": ns, "coach": coach}}


def slopes(gpc=-1.0, ns=-1.0, coach=1.0):
    return {"slopes": {"gpc": gpc, "gpc-ns": ns, "coach": coach}}


# Part, words of the claim, settings with which it holds, and with which it does not.
BOTH_WAYS = [
    ("pendulum", "final performance is similar", levels(coach=0.88), levels()),
    ("pendulum", "advantage over COACH shrinks", levels(gpc=[0.9, 0.7, 0.5]), levels()),
    ("pendulum", "only a slight advantage", levels(coach=0.87), levels(coach=0.9)),
    ("pendulum", "only a slight advantage", levels(coach=0.88), levels()),
    ("pendulum", "GPC's learning rate falls", slopes(), slopes(gpc=0.1)),
    ("pendulum", "GPC-NS's learning rate falls", slopes(), slopes(ns=0.0)),
    ("pendulum", "rises with consistent advice", slopes(), slopes(coach=-0.2)),
    (
        "pendulum",
        "the fall of the learning rate more gradual",
        slopes(gpc=[-1, -0.8, -0.5], ns=[-1, -0.8, -0.7]),
        slopes(ns=[-0.5, -0.6, -0.7]),
    ),
    ("cartpole", "GPC-NS is brittle to errors", levels(ns=[0.9, 0.7, 0.4]), levels(gpc=[0.9, 0.7, 0.4])),
    ("cartpole", "COACH is brittle", levels(coach=[0.9, 0.5, 0.1]), levels(coach=[0.9, 0.8, 0.7])),
    ("cartpole", "GPC is very robust", levels(), levels(gpc=[0.9, 0.75, 0.7])),
    ("cartpole", "COACH attains convergence", levels(coach=[0.9, 0.1, 0.1]), levels()),
    ("cartpole", "GPC-NS approaches GPC without", levels(ns=[0.9, 0.1, 0.1]), levels(ns=[0.8, 0.9, 0.9])),
    ("cartpole", "ahead of GPC-NS at 20% error by much", levels(ns=[0.9, 0.9, 0.6]), levels(ns=0.75)),
    ("cartpole", "steeper initial learning curve", levels(), {"early": {"coach": 1.9}}),
    ("lander", "COACH attains no performance", levels(coach=0.02), levels(coach=0.12)),
    ("lander", "GPC converges at every", levels(gpc=0.97), levels(gpc=0.85)),
    ("lander", "GPC-NS converges at every", levels(ns=0.97), levels(ns=0.85)),
]


@pytest.mark.parametrize(("part", "text", "good", "bad"), BOTH_WAYS, ids=[row[1] for row in BOTH_WAYS])
def test_both_ways(part, text, good, bad):
    assert the(of(part, **good), text).verdict == HOLDS
    assert the(of(part, **bad), text).verdict == FAILS


class TestActive:
    def test_all_hold_where_the_order_is_the_published_one(self):
        tested = claims(table())["active"]
        assert {claim.verdict for claim in tested} == {HOLDS}
        assert {len(claim.tests) for claim in tested} == {3}

    @pytest.mark.parametrize(
        ("row", "change", "fail"),
        [
            ("ii", {"levels": {"gpc": 0.5}}, {"Active learning alone beats the baseline"}),
            ("iii", {"levels": {"gpc": 0.5}}, {"The adaptive rate alone beats the baseline"}),
            ("iii", {"levels": {"gpc": 0.95}}, {"Both together are better than the adaptive rate alone"}),
            ("ii", {"used": 3.0}, {"Both together need less feedback than active learning alone"}),
            ("iv", {"used": 8.0}, {"The adaptive rate needs less feedback than the baseline"}),
            ("i", {"rate": 0.05}, {"The mean rate of i (0.0386 in the thesis) is below the static 0.04"}),
            ("i", {"slopes": {"gpc": -0.9}}, {"The rate of i falls more slowly than that of iii"}),
        ],
    )
    def test_each_looks_at_its_own_rows(self, row, change, fail):
        tested = claims(table(**{row: change}))["active"]
        assert {claim.text for claim in tested if claim.verdict != HOLDS} == fail

    def test_a_variant_of_the_table_is_a_condition(self):
        results = table()
        worse = table(ii={"levels": {"gpc": 0.5}})
        results["table5_4_fine_ii"] = worse["table5_4_fine_ii"]
        claim = the(claims(results)["active"], "Active learning alone beats the baseline")
        first, fine, printed = (test.condition for test in claim.tests)
        assert [test.verdict for test in claim.tests] == [True, False, True]
        assert claim.verdict == f"holds at {first}, {printed}" and fine not in claim.verdict


def test_the_order_for_each_oracle_and_delta():
    def at(oracle, delta):
        return {"coach": 0.95} if (oracle, delta) == ("lqr", 0.1) else {}

    results = {"oracles_cartpole": experiment(oracles=("gpc", "lqr"), deltas=(0.05, 0.1), at=at, seeds=6)}
    tested = claims(results)["oracles"]
    claim = the(tested, "GPC outperforms COACH at 10% error")
    assert [test.condition for test in claim.tests] == ["gpc 0.05", "gpc 0.1", "lqr 0.05", "lqr 0.1"]
    assert claim.verdict == "holds at gpc 0.05, gpc 0.1, lqr 0.05"
    assert the(tested, "GPC outperforms GPC-NS at 20% error").verdict == FAILS
    assert len(tested) == 3 * 3


class TestAcross:
    def of(self, pendulum=LEVELS, cartpole=LEVELS, lander=LANDER):
        return claims({
            "pendulum": experiment("pendulum", pendulum),
            "cartpole": experiment("cartpole", cartpole),
            "lander": experiment("lunarlander", lander),
        })["all"]  # fmt: skip

    def test_nobody_exceeds_gpc(self):
        text = "No algorithm ever exceeds GPC"
        lower, lander = LEVELS | {"gpc-ns": 0.88}, LANDER | {"gpc-ns": 0.95}
        assert the(self.of(lower, lower, lander), text).verdict == HOLDS
        claim = the(self.of(LEVELS | {"gpc-ns": [0.88, 0.95, 0.88]}, lower, lander), text)
        assert [test.condition for test in claim.tests if not test.verdict] == ["pendulum 10% GPC-NS"]

    def test_the_largest_lead(self):
        """In parts of each task's own gap."""
        text = "largest on the lander"
        assert the(self.of(), text).verdict == HOLDS
        assert the(self.of(pendulum=LEVELS | {"coach": -0.3}), text).verdict == "holds at cart-pole"
        claim = the(self.of(), text)
        assert [test.value.estimate for test in claim.tests] == pytest.approx([0.45, 0.45], abs=0.01)

    def test_near_gpc(self):
        text = "GPC-NS approaches GPC's final performance"
        assert the(self.of(cartpole=LEVELS | {"gpc-ns": 0.83}), text).verdict == HOLDS
        claim = the(self.of(cartpole=LEVELS | {"gpc-ns": [0.9, 0.7, 0.9]}), text)
        assert [test.condition for test in claim.tests if not test.verdict] == ["cart-pole 10%"]


class TestMissing:
    def test_nothing_claims_nothing(self):
        assert claims({}) == {}

    def test_a_part_alone(self):
        assert set(claims({"pendulum": experiment("pendulum", seeds=3)})) == {"pendulum"}

    def test_a_table_needs_all_its_rows(self):
        results = table()
        assert set(claims(results)) == {"active"}
        del results["table5_4_fine_iii"]
        assert claims(results) == {}

    def test_what_is_said_of_all_tasks_needs_all(self):
        small = {"pendulum": experiment("pendulum", seeds=3), "cartpole": experiment(seeds=3)}
        assert set(claims(small)) == {"pendulum", "cartpole"}
