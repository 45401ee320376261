"""Claims hold where made-up results say so, and nowhere else."""

import numpy as np
import pytest

from gpcjax.reproduce.claims import claims
from gpcjax.reproduce.claims.across import across
from gpcjax.reproduce.parts import ABLATIONS
from gpcjax.reproduce.verdicts import ALIKE, CONVERGED, HOLDS, NOT_SHOWN, NOT_TESTED, REFUTED, corrected
from tests.reproduce.illustrated import illustrations
from tests.reproduce.studies import LEVELS, experiment, table

LANDER = {"gpc": 0.97, "gpc-ns": 0.97, "coach": 0.02}


def the(tested, text):
    """The one claim that says this."""
    (found,) = (claim for claim in tested if text in claim.text)
    return found


TOLD = {}
"""What was claimed about results that several tests look at."""


def of(part, **settings):
    env, name = {"lander": "lunarlander"}.get(part, part), repr((part, settings))
    if name not in TOLD:
        TOLD[name] = claims({part: experiment(env, **settings)})[part]
    return TOLD[name]


class TestFewRuns:
    @pytest.mark.parametrize("part", ["pendulum", "cartpole", "lander"])
    @pytest.mark.parametrize("seeds", [1, pytest.param(4, marks=pytest.mark.slow)])
    def test_nothing_is_shown_and_nothing_refuted(self, part, seeds):
        tested = of(part, seeds=seeds)
        assert {claim.verdict for claim in tested} == {NOT_TESTED}
        assert {test.runs for claim in tested for test in claim.tests} <= {0, seeds}


class TestOrder:
    TEXT = "GPC outperforms COACH at every error rate"

    @pytest.mark.parametrize(
        "part", ["pendulum", *(pytest.param(part, marks=pytest.mark.slow) for part in ("cartpole", "lander"))]
    )
    @pytest.mark.parametrize(
        ("gpc", "verdict"),
        [
            ([0.9, 0.9, 0.9], HOLDS),
            ([0.9, 0.9, 0.4], "holds at 0%, 10%; not shown at 20%"),
            ([0.9, 0.4, 0.3], "holds at 0%; not shown at 10%; refuted at 20%"),
            ([0.4, 0.4, 0.4], NOT_SHOWN),
            ([0.1, 0.1, 0.1], REFUTED),
        ],
    )
    def test_at_each_error_rate(self, part, gpc, verdict):
        assert the(of(part, levels=LEVELS | {"gpc": gpc}), self.TEXT).told == verdict

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

    def test_a_steeper_beginning_is_a_slope_beside_a_level(self):
        """Whoever is high at once and falls has the higher level and the lower slope."""
        text = "steeper learning curves than COACH at the beginning ({})"
        falling = of("pendulum", early={"gpc": 1.5, "gpc-ns": 1.5, "coach": 0.3})
        assert the(falling, text.format("level")).verdict == HOLDS
        assert the(falling, text.format("slope")).verdict == REFUTED
        rising = of("pendulum", early={"gpc": 0.1, "gpc-ns": 0.1, "coach": 0.8})
        assert the(rising, text.format("level")).verdict == REFUTED
        assert the(rising, text.format("slope")).verdict == HOLDS


class TestAlike:
    @pytest.mark.parametrize(
        ("difference", "verdict"),
        [
            (0.0, HOLDS),
            (0.03, HOLDS),
            pytest.param(-0.03, HOLDS, marks=pytest.mark.slow),
            pytest.param(0.08, REFUTED, marks=pytest.mark.slow),
            (-0.08, REFUTED),
            ([0.0, 0.08, 0.0], "holds at 0%, 20%; refuted at 10%"),
        ],
    )
    def test_within_the_margin_on_both_sides(self, difference, verdict):
        other = np.add(0.9, difference).tolist()
        tested = of("pendulum", levels=LEVELS | {"gpc-ns": other})
        assert the(tested, "GPC and GPC-NS behave alike").told == verdict
        tested = of("lander", levels=LANDER | {"gpc": 0.9, "gpc-ns": other})
        assert the(tested, "GPC and GPC-NS perform alike").told == verdict

    def test_the_whole_interval_has_to_be_within(self):
        """Not finding a difference is no finding that there is none."""
        tested = of("pendulum", levels=LEVELS, spread=3.0)
        claim = the(tested, "GPC and GPC-NS behave alike")
        margin = ALIKE * 1050
        assert claim.verdict == NOT_SHOWN
        assert all(test.value.lower < -margin or test.value.upper > margin for test in claim.tests)


def levels(gpc=0.9, ns=0.9, coach=0.4):
    return {"levels": {"gpc": gpc, "gpc-ns": ns, "coach": coach}}


def slopes(gpc=-1.0, ns=-1.0, coach=1.0):
    return {"slopes": {"gpc": gpc, "gpc-ns": ns, "coach": coach}}


# Part, words of the claim, settings with which it holds, and with which it is refuted.
BOTH_WAYS = [
    ("pendulum", "final performance is similar", levels(coach=0.88), levels()),
    ("pendulum", "advantage over COACH shrinks", levels(gpc=[0.9, 0.7, 0.5]), levels(gpc=[0.5, 0.7, 0.9])),
    ("pendulum", "only a slight advantage", levels(coach=0.87), levels(coach=0.93)),
    ("pendulum", "only a slight advantage", levels(coach=0.88), levels()),
    ("pendulum", "begin with coarser steps", {"slopes": {"gpc": 0.0, "gpc-ns": 0.0, "coach": -3.0}},
     {"slopes": {"gpc": -3.0, "gpc-ns": -3.0, "coach": 0.0}}),
    ("pendulum", "GPC's learning rate falls", slopes(), slopes(gpc=0.1)),
    ("pendulum", "first steps are small", slopes(), slopes(coach=-0.2)),
    (
        "pendulum",
        "the fall of the learning rate more gradual",
        slopes(gpc=[-1, -0.8, -0.5], ns=[-1, -0.8, -0.7]),
        slopes(gpc=[-0.5, -0.6, -0.7], ns=[-0.5, -0.6, -0.7]),
    ),
    ("cartpole", "GPC-NS is brittle to errors", levels(ns=[0.9, 0.7, 0.4]), levels(gpc=[0.9, 0.7, 0.4])),
    ("cartpole", "COACH is brittle", levels(coach=[0.9, 0.5, 0.1]), levels(coach=[0.9, 0.8, 0.7])),
    ("cartpole", "GPC is very robust", levels(gpc=0.95), levels(gpc=[0.95, 0.85, 0.7])),
    ("cartpole", "COACH attains convergence", levels(coach=[0.95, 0.1, 0.1]), levels()),
    ("cartpole", "GPC-NS approaches GPC without", levels(ns=[0.9, 0.1, 0.1]), levels(ns=[0.8, 0.9, 0.9])),
    ("cartpole", "ahead of GPC-NS at 20% error by much", levels(ns=[0.9, 0.9, 0.6]), levels(ns=0.75)),
    ("lander", "COACH attains no performance", levels(coach=0.02), levels(coach=0.12)),
    ("lander", "GPC converges at every", levels(gpc=0.97), levels(gpc=0.85)),
    # The same of another learner.
    ("lander", "GPC-NS converges at every", levels(ns=0.97), levels(ns=0.85)),
    ("pendulum", "GPC-NS's learning rate falls", slopes(), slopes(ns=0.1)),
]  # fmt: skip


@pytest.mark.parametrize(
    ("part", "text", "good", "bad"),
    [
        pytest.param(*row, id=row[1], marks=[pytest.mark.slow] if row in BOTH_WAYS[-2:] else [])
        for row in BOTH_WAYS
    ],
)
def test_both_ways(part, text, good, bad):
    assert the(of(part, **good), text).verdict == HOLDS
    assert the(of(part, **bad), text).verdict == REFUTED


@pytest.mark.parametrize(
    ("part", "text", "algo"),
    [
        ("cartpole", "COACH attains convergence", "coach"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (
                ("cartpole", "GPC is very robust", "gpc"),
                ("lander", "GPC converges at every", "gpc"),
                ("lander", "GPC-NS converges at every", "gpc-ns"),
            )
        ),
    ],
)
@pytest.mark.parametrize(
    ("level", "verdict", "remark"),
    [
        (0.97, HOLDS, "with 0.8 instead: holds; with 0.95 instead: holds"),
        (CONVERGED + 0.02, HOLDS, "with 0.8 instead: holds; with 0.95 instead: refuted"),
        (CONVERGED - 0.02, REFUTED, "with 0.8 instead: holds; with 0.95 instead: refuted"),
        (0.78, REFUTED, "with 0.8 instead: refuted; with 0.95 instead: refuted"),
    ],
)
def test_converged_means_the_same_everywhere(part, text, algo, level, verdict, remark):
    claim = the(of(part, levels=LEVELS | {algo: level}), text)
    assert CONVERGED == 0.9 and (claim.verdict, claim.remark) == (verdict, remark)


PRINTED = ABLATIONS["table5_4_printed"].name


class TestActive:
    def test_all_hold_where_the_order_is_the_published_one(self):
        tested = claims(table())["active"]
        assert {claim.verdict for claim in tested} == {HOLDS}

    def test_a_mean_rate_is_tested_where_the_static_rate_is_what_it_is_compared_with(self):
        tested = claims(table())["active"]
        compared = [variant.name for variant in ABLATIONS.values() if variant.static_rate == 0.04]
        assert len(compared) == 3 and PRINTED not in compared
        for claim in tested:
            expected = (
                compared
                if claim.text.startswith("The mean rate of")
                else [v.name for v in ABLATIONS.values()]
            )
            assert [test.condition for test in claim.tests] == expected

    @pytest.mark.parametrize(
        ("row", "change", "refuted"),
        [
            ("ii", {"levels": {"gpc": 0.5}}, {"Active learning alone beats the baseline"}),
            ("iii", {"levels": {"gpc": 0.5}}, {"The adaptive rate alone beats the baseline"}),
            ("iii", {"levels": {"gpc": 0.95}}, {"Both together are better than the adaptive rate alone"}),
            ("ii", {"used": 3.0}, {f"Both together need less feedback than active learning alone ({way})"
                                   for way in ("count", "rate")}),
            ("iv", {"used": 8.0}, {f"The adaptive rate needs less feedback than the baseline ({way})"
                                   for way in ("count", "rate")}),
            ("i", {"slopes": {"gpc": -0.9}}, {"The rate of i falls more slowly than that of iii"}),
            ("i", {"first_rate": 0.02}, {"The adaptive rate of i takes bigger steps than the static rate at first"}),
            ("iii", {"first_rate": 0.02}, {"The adaptive rate of iii takes bigger steps than the static rate "
                                           "at first"}),
            ("i", {"rate": 0.05}, {"The adaptive rate of i takes smaller steps than the static rate at last",
                                   *(f"The mean rate of i (0.0386 in the thesis) is below the static 0.04 ({way})"
                                     for way in ("mean of runs", "pooled"))}),
            ("i", {"chance": -0.5}, {"With both, the chance of advice and the learning rate go together"}),
        ],
    )  # fmt: skip
    def test_each_looks_at_its_own_rows(self, row, change, refuted):
        tested = claims(table(**{row: change}))["active"]
        assert {claim.text for claim in tested if claim.verdict != HOLDS} == refuted
        assert {claim.verdict for claim in tested if claim.verdict != HOLDS} == {REFUTED}

    def test_feedback_by_count_and_by_rate_are_two_things(self):
        """Who stays up twice as long has twice as many corrections at the same rate."""
        results = table(iv={"used": 8.0})
        for name in (name for name in results if name.endswith("_iii")):
            results[name].episodes["length"] = 400
        tested = claims(results)["active"]
        text = "The adaptive rate needs less feedback than the baseline ({})"
        assert the(tested, text.format("count")).verdict == REFUTED
        assert the(tested, text.format("rate")).verdict == HOLDS

    def test_a_pooled_rate_weighs_corrections_and_a_mean_of_runs_weighs_runs(self):
        results = table()
        for name, one in results.items():
            if name.endswith("_i"):
                busy = one.episodes["seed"] < 2
                one.episodes["mean_rate"] = np.where(busy, 0.1, 0.03)
                one.episodes["corrections"] = np.where(busy, 100, 1).astype(np.int32)
        tested = claims(results)["active"]
        pooled = the(tested, "The mean rate of i (0.0386 in the thesis) is below the static 0.04 (pooled)")
        runs = the(
            tested, "The mean rate of i (0.0386 in the thesis) is below the static 0.04 (mean of runs)"
        )
        frame = one_of(results, "_i").episodes
        weighed = (frame["mean_rate"] * frame["corrections"]).sum() / frame["corrections"].sum()
        assert runs.tests[0].value.estimate == pytest.approx((2 * 0.1 + 10 * 0.03) / 12, rel=1e-9)
        assert pooled.tests[0].value.estimate == pytest.approx(weighed, rel=0.05)
        assert weighed > 0.09

    def test_a_variant_of_the_table_is_a_condition(self):
        results = table()
        worse = table(ii={"levels": {"gpc": 0.5}})
        results["table5_4_fine_ii"] = worse["table5_4_fine_ii"]
        claim = the(claims(results)["active"], "Active learning alone beats the baseline")
        assert [test.verdict for test in claim.tests] == [HOLDS, REFUTED, HOLDS, HOLDS]
        assert claim.told.endswith(f"; refuted at {ABLATIONS['table5_4_fine'].name}")


def one_of(results, end):
    return next(one for name, one in results.items() if name.endswith(end))


class TestOracles:
    def test_the_order_for_each_oracle_and_delta(self):
        def at(oracle, delta):
            return {"coach": 0.95} if (oracle, delta) == ("lqr", 0.1) else {}

        oracles = ("gpc", "gpc-2", "lqr", "network")
        results = {"oracles_cartpole": experiment(oracles=oracles, deltas=(0.05, 0.1), at=at, seeds=6)}
        tested = claims(results)["oracles"]
        assert len(tested) == 2 * 3 * 3
        circle, others = (claim for claim in tested if "GPC outperforms COACH at 10% error" in claim.text)
        assert "that GPC itself taught (a circle)" in circle.text and circle.oracles == ("gpc", "gpc-2")
        assert [test.condition for test in circle.tests] == ["gpc 0.05", "gpc 0.1", "gpc-2 0.05", "gpc-2 0.1"]
        assert circle.verdict == HOLDS
        assert "that owe nothing to GPC" in others.text and others.oracles == ("lqr", "network")
        assert others.told == "holds at lqr 0.05, network 0.05, network 0.1; refuted at lqr 0.1"
        for kind in ("oracles that GPC", "oracles that owe"):
            claim = the(tested, f"GPC outperforms GPC-NS at 20% error: cart-pole, {kind}")
            assert claim.verdict not in (HOLDS, REFUTED)  # they are as good as each other

    def test_each_task_alone_and_both(self):
        one = {"oracles_pendulum": experiment("pendulum", oracles=("gpc", "energy"), deltas=(0.05,), seeds=6)}
        assert all("pendulum" in claim.text and claim.section == "5.1.1" for claim in claims(one)["oracles"])
        both = one | {"oracles_cartpole": experiment(oracles=("lqr",), deltas=(0.05,), seeds=6)}
        tested = claims(both)["oracles"]
        assert len(tested) == 3 * 3 * (2 + 1)
        assert {claim.text.split(": ")[1].split(",")[0] for claim in tested} == {"pendulum", "cart-pole"}


class TestAcross:
    def of(self, pendulum=LEVELS, cartpole=LEVELS, lander=LANDER):
        name = repr((pendulum, cartpole, lander))
        if name not in TOLD:
            of_each = zip(("pendulum", "cartpole", "lunarlander"), (pendulum, cartpole, lander), strict=True)
            TOLD[name] = corrected(across(*(experiment(env, levels) for env, levels in of_each)))
        return TOLD[name]

    def test_nobody_exceeds_gpc(self):
        """By the same rule as every claim: an interval across zero does not show it."""
        text = "No algorithm ever exceeds GPC"
        lower, lander = LEVELS | {"gpc-ns": 0.88}, LANDER | {"gpc-ns": 0.95}
        assert the(self.of(lower, lower, lander), text).verdict == HOLDS
        claim = the(self.of(LEVELS | {"gpc-ns": [0.88, 0.95, 0.9]}, lower, lander), text)
        assert {test.condition: test.verdict for test in claim.tests if test.verdict != HOLDS} == {
            "pendulum 10% GPC-NS": REFUTED,
            "pendulum 20% GPC-NS": NOT_SHOWN,
        }

    def test_the_majority_of_tasks(self):
        text = "GPC-NS outperforms COACH on the majority of the tasks"
        assert the(self.of(), text).short == "holds (in 3 of 3)"
        worse = LEVELS | {"coach": 0.97}
        assert the(self.of(pendulum=worse), text).short == "holds (in 2 of 3)"
        assert the(self.of(pendulum=worse, cartpole=worse), text).short == "refuted (in 1 of 3)"

    def test_robustness_as_what_is_lost_and_as_what_is_kept(self):
        """COACH has nothing to lose on the lander, and keeps nothing of it."""
        brittle = LEVELS | {"coach": [0.8, 0.5, 0.2]}
        lander = {"gpc": [0.97, 0.9, 0.7], "gpc-ns": 0.97, "coach": [0.1, 0.05, 0.02]}
        tested = self.of(brittle, brittle, lander)
        assert the(tested, "more robust to errors than COACH on every task (loss)").told == (
            "holds at pendulum, cart-pole; refuted at lander"
        )
        kept = the(tested, "more robust to errors than COACH on every task (what is kept)")
        assert kept.verdict == HOLDS
        expected = [1 - 0.2 / 0.8, 1 - 0.2 / 0.8, 0.7 / 0.97 - 0.2]
        assert [test.value.estimate for test in kept.tests] == pytest.approx(expected, abs=0.08)

    def test_the_largest_lead(self):
        """In parts of each task's own gap."""
        text = "largest on the lander"
        assert the(self.of(), text).verdict == HOLDS
        assert (
            the(self.of(pendulum=LEVELS | {"coach": -0.3}), text).told
            == "holds at cart-pole; refuted at pendulum"
        )
        claim = the(self.of(), text)
        assert [test.value.estimate for test in claim.tests] == pytest.approx([0.45, 0.45], abs=0.01)

    def test_near_gpc_in_most_experiments(self):
        text = "GPC-NS approaches GPC's final performance in most experiments"
        assert the(self.of(cartpole=LEVELS | {"gpc-ns": 0.83}), text).short == "holds (in 9 of 9)"
        far = LEVELS | {"gpc-ns": [0.9, 0.7, 0.6]}
        assert the(self.of(cartpole=far), text).short == "holds (in 7 of 9)"
        assert the(self.of(pendulum=far, cartpole=far), text).short == "holds (in 5 of 9)"
        farther = LEVELS | {"gpc-ns": [0.7, 0.7, 0.6]}
        assert the(self.of(pendulum=far, cartpole=farther), text).short == "refuted (in 4 of 9)"


class TestIllustrated:
    """Each claim about an illustration looks at its own numbers, over 30 seeds."""

    def test_all_hold_where_the_numbers_say_so(self):
        tested = claims({}, illustrations())["illustrations"]
        assert {claim.verdict for claim in tested} == {HOLDS}
        assert {test.runs for claim in tested for test in claim.tests} == {30}

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"behind": 0.1}, "with SPARS it follows the last one"),
            ({"consistent_gpc": -0.2}, "Consistent advice keeps the learning rate high"),
            ({"consistent_coach": -0.15}, "COACH's learning rate rises with consistent advice"),
            ({"rest": 0.3}, "Around the upright rest sigma_h is reduced"),
            ({"advised": 0.3}, "sigma_p is lower where advice was given"),
            ({"unconverged": -0.3}, "sigma_h marks states whose action has not converged"),
            ({"samples": -3.0}, "With a long l_h a wrong advice takes more right ones"),
        ],
    )
    def test_each_is_refuted_by_its_own_numbers(self, change, text):
        tested = claims({}, illustrations(**change))["illustrations"]
        assert [claim.text for claim in tested if claim.verdict != HOLDS] == [the(tested, text).text]
        assert the(tested, text).verdict == REFUTED

    def test_consistency_is_looked_at(self):
        """A rate that rises as much under advice that alternates does not rise with consistency."""
        tested = claims({}, illustrations(alternating_coach=0.5))["illustrations"]
        claim = the(tested, "COACH's learning rate rises with consistent advice")
        assert claim.told == "holds at first; refuted at alternating"


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
