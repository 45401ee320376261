"""How a claim is tested: a mean over runs with its interval under one condition or several, and the verdict in words.

| Word         | The 95 % interval                                   |
|--------------|-----------------------------------------------------|
| "holds"      | lies wholly on the claimed side                     |
| "refuted"    | lies wholly on another side                         |
| "not shown"  | lies across the line: the runs tell neither         |
| "not tested" | there is none, or of fewer than `FEWEST` runs       |

Differences are between runs of the same seed. Beside the plain verdicts stand those after Holm's correction, whose
family is all tests of a part of the report. Loads no jax.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gpcjax.report import words
from gpcjax.report.distributions import student_tail
from gpcjax.report.groups import CLOSED_GAP
from gpcjax.report.statistics import LEVEL, Interval, holm, mean_interval
from gpcjax.reproduce.measures import Measure

ALIKE = 0.05
"""Two returns are alike within this part of the gap from idle to oracle."""

CONVERGED = CLOSED_GAP
"""Converged is a final return that closes this part of the gap from idle to oracle, on every task."""

FEWEST = 5
"""With fewer runs an interval of a mean means nothing."""

MOST_NAMED = 4
"""Conditions that a short verdict names; more are counted."""


class Verdict(StrEnum):
    """What becomes of a claim."""

    HOLDS = "holds"
    REFUTED = "refuted"
    NOT_SHOWN = "not shown"
    NOT_TESTED = "not tested"
    MIXED = "mixed"
    """Of a claim alone: not the same under all of its conditions."""


HOLDS, REFUTED, NOT_SHOWN, NOT_TESTED, MIXED = Verdict
_OF_A_TEST = (HOLDS, NOT_SHOWN, REFUTED, NOT_TESTED)


class Claimed(NamedTuple):
    """What a claim says of a mean: that it lies strictly between these."""

    lower: float = -np.inf
    upper: float = np.inf


ABOVE_ZERO, BELOW_ZERO = Claimed(lower=0.0), Claimed(upper=0.0)


@dataclass(frozen=True)
class Test:
    """A mean over `runs` under one condition. `p` is of the verdict that it leans to (`p_value`), `adjusted` Holm's."""

    condition: str
    value: Interval
    runs: int
    claimed: Claimed
    p: float = np.nan
    decimals: int = 0
    adjusted: float = np.nan

    @property
    def verdict(self) -> Verdict:
        """Of the plain interval."""
        _, lower, upper = self.value
        if self.runs < FEWEST or np.isnan(lower) or np.isnan(upper):
            return NOT_TESTED
        if lower > self.claimed.lower and upper < self.claimed.upper:
            return HOLDS
        return REFUTED if upper < self.claimed.lower or lower > self.claimed.upper else NOT_SHOWN

    @property
    def corrected(self) -> Verdict:
        """The verdict after Holm's correction: what does not survive it is not shown."""
        decided = self.verdict in (HOLDS, REFUTED)
        return NOT_SHOWN if decided and not self.adjusted <= 1 - LEVEL else self.verdict

    @property
    def shown(self) -> str:
        """The estimate with its interval."""
        return words.interval(self.value, self.decimals)

    @property
    def told(self) -> str:
        """The verdict, with the number of runs where they are too few."""
        if self.verdict != NOT_TESTED:
            return self.verdict
        return f"{NOT_TESTED} ({self.runs} run{'' if self.runs == 1 else 's'})"


@dataclass(frozen=True)
class Claim:
    """One claim: where it stands, what it says, what tests it.

    Fields:
        section: of the thesis.
        text: what it says.
        statistic: what is measured, and which side of which line is claimed.
        tests: one for each condition.
        oracles: who taught in the runs behind it; empty where no oracle did.
        most: it is claimed of most conditions, not of each.
        remark: what else has to be known to read the verdict.
    """

    section: str
    text: str
    statistic: str
    tests: tuple[Test, ...]
    oracles: tuple[str, ...] = ()
    most: bool = False
    remark: str = ""

    @property
    def verdict(self) -> Verdict:
        """One word for all of its conditions."""
        return self._word([test.verdict for test in self.tests])

    @property
    def told(self) -> str:
        """The verdict, with the conditions under which it is this and that."""
        return self._told({test.condition: test.verdict for test in self.tests}, len(self.tests))

    @property
    def short(self) -> str:
        """The same, with many conditions counted."""
        return self._told({test.condition: test.verdict for test in self.tests}, MOST_NAMED)

    @property
    def corrected(self) -> str:
        """The short verdict after Holm's correction."""
        return self._told({test.condition: test.corrected for test in self.tests}, MOST_NAMED)

    def _word(self, verdicts: Sequence[Verdict]) -> Verdict:
        if self.most:
            return _of_most(verdicts)
        found = set(verdicts) or {NOT_TESTED}
        return found.pop() if len(found) == 1 else MIXED

    def _told(self, verdicts: Mapping[str, Verdict], most_named: int) -> str:
        word = self._word(list(verdicts.values()))
        if self.most:
            count = sum(verdict == HOLDS for verdict in verdicts.values())
            return f"{word} (in {count} of {len(verdicts)})"
        if word == NOT_TESTED:
            runs = sorted({test.runs for test in self.tests})
            return f"{word} ({' to '.join(map(str, runs[:1] + runs[1:][-1:])) if runs else 'no'} runs)"
        if word != MIXED:
            return word
        parts = []
        for each in _OF_A_TEST:
            conditions = [condition for condition, verdict in verdicts.items() if verdict == each]
            if conditions:
                named = (
                    ", ".join(conditions)
                    if len(conditions) <= most_named
                    else f"{len(conditions)} of {len(verdicts)}"
                )
                parts.append(f"{each} at {named}")
        return "; ".join(parts)


def _of_most(verdicts: Sequence[Verdict]) -> Verdict:
    if not verdicts or set(verdicts) == {NOT_TESTED}:
        return NOT_TESTED
    if 2 * verdicts.count(HOLDS) > len(verdicts):
        return HOLDS
    return REFUTED if 2 * verdicts.count(REFUTED) >= len(verdicts) else NOT_SHOWN


def test(condition: str, values: Measure, claimed: Claimed, decimals: int = 0) -> Test:
    """Whether the mean of `values` lies where it is claimed to."""
    return Test(
        condition,
        mean_interval(values.values[:, None]),
        values.runs,
        claimed,
        p_value(values.values, claimed),
        decimals,
    )


def p_value(values: Float[np.ndarray, " runs"], claimed: Claimed) -> float:
    """Two-sided p of Student's t for the verdict that the mean leans to; nan with fewer than two runs.

    For "holds" that is twice the larger of the one-sided p against each bound of what is claimed (both have to be
    rejected), for "refuted" twice that against the bound that the mean is beyond. The bootstrap behind the intervals
    cannot tell a p below one in its resamples, which is too coarse for a family of a hundred tests: hence t.
    """
    if len(values) < 2:
        return np.nan
    mean, error = values.mean(), values.std(ddof=1) / np.sqrt(len(values))

    def beyond(line: float, sign: int) -> float:
        """One-sided p that the mean is beyond `line`, above it for sign 1 and below for -1."""
        distance = sign * (mean - line)
        if np.isinf(line) or error == 0:
            return 0.0 if distance > 0 else 1.0
        return student_tail(distance / error, len(values) - 1)

    holds = max(beyond(claimed.lower, 1), beyond(claimed.upper, -1))
    refuted = min(beyond(claimed.lower, -1), beyond(claimed.upper, 1))
    return min(1.0, 2 * min(holds, refuted))


def corrected(claims: Sequence[Claim]) -> list[Claim]:
    """The claims of a part, with Holm's p of all their tests as one family; what is not tested counts for nothing."""
    family = [test.p for claim in claims for test in claim.tests if test.verdict != NOT_TESTED]
    adjusted = iter(holm(family))
    return [
        replace(
            claim,
            tests=tuple(
                each if each.verdict == NOT_TESTED else replace(each, adjusted=next(adjusted))
                for each in claim.tests
            ),
        )
        for claim in claims
    ]


def counted(claims: Sequence[Claim]) -> str:
    """How many claims met which verdict, in a sentence."""
    number = {word: sum(claim.verdict == word for claim in claims) for word in Verdict}
    return (
        f"Of {len(claims)} claims {number[HOLDS]} hold, {number[REFUTED]} are refuted, {number[NOT_SHOWN]} are not "
        f"shown, {number[NOT_TESTED]} are not tested, and {number[MIXED]} are mixed: not the same under all conditions."
    )
