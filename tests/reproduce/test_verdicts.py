"""Four words for four things, how claims put them together, and what is left of them after Holm's correction."""

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from gpcjax.report.statistics import Interval
from gpcjax.reproduce.measures import Measure
from gpcjax.reproduce.verdicts import (
    ABOVE_ZERO,
    BELOW_ZERO,
    FEWEST,
    HOLDS,
    MIXED,
    NOT_SHOWN,
    NOT_TESTED,
    REFUTED,
    Claim,
    Claimed,
    corrected,
    counted,
    p_value,
)
from gpcjax.reproduce.verdicts import Test as Outcome
from gpcjax.reproduce.verdicts import test as judged

WITHIN = Claimed(-10.0, 10.0)


def outcome(verdict, condition="0%", runs=9):
    """A test that comes out so."""
    bounds = {HOLDS: (0.5, 1.5), REFUTED: (-1.5, -0.5), NOT_SHOWN: (-0.5, 1.5), NOT_TESTED: (np.nan, np.nan)}
    return Outcome(condition, Interval(1.0, *bounds[verdict]), runs, ABOVE_ZERO)


def claim(*verdicts, **options):
    tests = tuple(outcome(verdict, f"{i}0%") for i, verdict in enumerate(verdicts))
    return Claim("5", "It is so", "what tests it", tests, **options)


class TestOneTest:
    @pytest.mark.parametrize(
        ("lower", "upper", "claimed", "verdict"),
        [
            (0.1, 2.0, ABOVE_ZERO, HOLDS),
            (-2.0, -0.1, ABOVE_ZERO, REFUTED),
            (-87.0, 76.0, ABOVE_ZERO, NOT_SHOWN),
            (-87.0, 76.0, BELOW_ZERO, NOT_SHOWN),
            (0.0, 2.0, ABOVE_ZERO, NOT_SHOWN),
            (-2.0, -0.1, BELOW_ZERO, HOLDS),
            (-9.0, 9.0, WITHIN, HOLDS),
            (-9.0, 11.0, WITHIN, NOT_SHOWN),
            (-11.0, 11.0, WITHIN, NOT_SHOWN),
            (10.5, 11.0, WITHIN, REFUTED),
            (-12.0, -10.5, WITHIN, REFUTED),
            (np.nan, np.nan, ABOVE_ZERO, NOT_TESTED),
        ],
    )
    def test_the_whole_interval_decides(self, lower, upper, claimed, verdict):
        estimate = (lower + upper) / 2
        assert Outcome("", Interval(estimate, lower, upper), 9, claimed).verdict == verdict

    @pytest.mark.parametrize("runs", range(FEWEST))
    def test_too_few_runs_test_nothing_and_are_told(self, runs):
        made = judged("0%", Measure(np.arange(runs), np.linspace(1.0, 2.0, runs)), ABOVE_ZERO)
        assert made.verdict == NOT_TESTED
        assert made.told == f"not tested ({runs} run{'' if runs == 1 else 's'})"

    def test_enough_runs(self):
        made = judged("0%", Measure(np.arange(FEWEST), np.linspace(1.0, 2.0, FEWEST)), ABOVE_ZERO)
        assert (made.verdict, made.told, made.runs) == (HOLDS, "holds", FEWEST)

    def test_the_estimate_with_its_interval(self):
        assert outcome(HOLDS).shown == "1 [0, 2]"
        assert (
            Outcome("", Interval(0.123, 0.05, 0.25), 9, ABOVE_ZERO, decimals=2).shown == "0.12 [0.05, 0.25]"
        )


class TestClaim:
    @pytest.mark.parametrize("verdict", [HOLDS, REFUTED, NOT_SHOWN])
    def test_one_word_where_all_agree(self, verdict):
        made = claim(verdict, verdict)
        assert made.verdict == made.told == made.short == verdict

    def test_not_tested_says_how_few(self):
        few = Claim("5", "so", "how", (outcome(NOT_TESTED, runs=0), outcome(NOT_TESTED, runs=3)))
        assert few.verdict == NOT_TESTED and few.short == "not tested (0 to 3 runs)"
        assert Claim("5", "so", "how", (outcome(HOLDS, runs=3),)).short == "not tested (3 runs)"
        assert Claim("5", "so", "how", ()).short == "not tested (no runs)"

    def test_mixed_conditions_say_which_is_which(self):
        made = claim(HOLDS, REFUTED, NOT_SHOWN, HOLDS)
        assert made.verdict == MIXED
        assert made.told == "holds at 00%, 30%; not shown at 20%; refuted at 10%"

    @pytest.mark.parametrize("few", [REFUTED, NOT_SHOWN, NOT_TESTED])
    @pytest.mark.parametrize("many", [HOLDS, NOT_SHOWN, REFUTED])
    def test_the_short_form_is_never_empty(self, many, few):
        """Of every word that occurs, at least one condition or their number."""
        if many == few:
            return
        for number in range(1, 16):
            made = claim(*[many] * 12, *[few] * number)
            parts = made.short.split("; ")
            assert {part.partition(" at ")[0] for part in parts} == {many, few}
            assert all(part.partition(" at ")[2] for part in parts)
        assert "12 of 27" in made.short

    @pytest.mark.parametrize(
        ("holding", "refuted", "not_shown", "told"),
        [
            (7, 0, 2, "holds (in 7 of 9)"),
            (5, 4, 0, "holds (in 5 of 9)"),
            (4, 1, 4, "not shown (in 4 of 9)"),
            (2, 5, 2, "refuted (in 2 of 9)"),
            (2, 2, 0, "refuted (in 2 of 4)"),
        ],
    )
    def test_a_claim_of_most(self, holding, refuted, not_shown, told):
        made = claim(*[HOLDS] * holding, *[REFUTED] * refuted, *[NOT_SHOWN] * not_shown, most=True)
        assert made.short == told and made.verdict == told.partition(" (")[0]

    def test_the_count(self):
        made = [claim(HOLDS), claim(HOLDS, HOLDS), claim(REFUTED), claim(NOT_SHOWN), claim(HOLDS, REFUTED)]
        made += [Claim("5", "so", "how", ())]
        assert counted(made) == (
            "Of 6 claims 2 hold, 1 are refuted, 1 are not shown, 1 are not tested, and 1 are mixed: not the same under "
            "all conditions."
        )


class TestPValue:
    VALUES = np.random.default_rng(0).normal(0.5, 1.0, 20)

    @pytest.mark.parametrize("claimed", [ABOVE_ZERO, BELOW_ZERO, Claimed(lower=0.3), Claimed(upper=1.0)])
    def test_against_one_line_it_is_scipys_two_sided_t(self, claimed):
        (line,) = (bound for bound in claimed if np.isfinite(bound))
        expected = ttest_1samp(self.VALUES, line).pvalue
        assert p_value(self.VALUES, claimed) == pytest.approx(expected, rel=1e-10)

    def test_within_two_lines_both_have_to_be_rejected(self):
        low, high = (ttest_1samp(self.VALUES, line).pvalue for line in (-0.5, 2.0))
        assert p_value(self.VALUES, Claimed(-0.5, 2.0)) == pytest.approx(max(low, high), rel=1e-10)

    def test_outside_of_two_lines(self):
        beyond = self.VALUES + 5.0
        expected = ttest_1samp(beyond, 2.0).pvalue
        assert p_value(beyond, Claimed(-2.0, 2.0)) == pytest.approx(expected, rel=1e-10)

    def test_without_spread(self):
        assert p_value(np.ones(9), ABOVE_ZERO) == 0.0
        assert p_value(np.zeros(9), ABOVE_ZERO) == 1.0
        assert np.isnan(p_value(np.ones(1), ABOVE_ZERO))


class TestHolm:
    def test_the_family_is_all_tests_of_a_part(self):
        """A weak verdict survives alone and not among others; a strong one does."""
        random = np.random.default_rng(1)
        strong = Measure(np.arange(40), 5.0 + random.normal(size=40))
        noise = random.normal(size=40)
        weak = Measure(np.arange(40), noise - noise.mean() + 0.38 * noise.std(ddof=1))
        made = {name: Claim("5", name, "how", (judged("", values, ABOVE_ZERO),)) for name, values in
                {"strong": strong, "weak": weak}.items()}  # fmt: skip
        assert made["weak"].verdict == HOLDS and 0.01 < made["weak"].tests[0].p < 0.05
        (alone,) = corrected([made["weak"]])
        assert alone.corrected == HOLDS
        many = corrected([made["weak"], *[made["strong"]] * 4, *[claim(NOT_TESTED)] * 3])
        assert many[0].corrected == HOLDS  # the strong ones go first, and what is not tested does not count
        among = corrected([made["weak"]] * 5)
        assert among[0].corrected == NOT_SHOWN and among[0].verdict == HOLDS
        assert [one.corrected for one in corrected([made["strong"]] * 5)] == [HOLDS] * 5
