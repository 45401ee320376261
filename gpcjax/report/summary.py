"""The numbers of a study: a row for each group and each pair of algorithms, and which points of a grid are best."""

import itertools
from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gpcjax.report.groups import Group, Point, Study
from gpcjax.report.statistics import (
    Interval,
    Scores,
    best_and_tied,
    mean_intervals,
    median_intervals,
    paired_differences,
)

MOST_PAIRS = 100_000
"""Of points of two algorithms with one oracle and error rate."""


@dataclass(frozen=True)
class Row:
    """The numbers of one group. `tied` with the best point of its grid is also the best one itself."""

    group: Group
    final: Interval
    """Mean of the final return."""
    area: Interval
    """Mean area under the learning curve."""
    closed: Interval
    """Median of the first episode that closes the gap to the oracle."""
    never: int
    """Runs that have no such episode."""
    corrections: Interval
    """Mean number of corrections of a run."""
    best: bool
    tied: bool


@dataclass(frozen=True)
class Difference:
    """The area of `first` minus that of `second`, mean over the `pairs` of runs with the same seed."""

    first: Group
    second: Group
    area: Interval
    pairs: int

    @property
    def point(self) -> Point:
        """The settings of both."""
        return Point(tuple((dict(self.second.point.values) | dict(self.first.point.values)).items()))


@dataclass(frozen=True)
class ImageFile:
    """A figure of a report: a file, which a notebook shows as what it is."""

    path: Path

    def _repr_png_(self) -> bytes:
        return self.path.read_bytes()


@dataclass(frozen=True, repr=False)
class Summary:
    """What a report says in numbers.

    `rows` are in the order of `study.groups`. `missing` counts planned cells without any episode, `unpaired` the pairs
    of points that `pairs_of` leaves out. `files` are those that were written. In a notebook it shows itself, with its
    figures.
    """

    study: Study
    rows: tuple[Row, ...]
    differences: tuple[Difference, ...]
    missing: int = 0
    unpaired: int = 0
    files: tuple[Path, ...] = ()

    @property
    def stopped(self) -> int:
        """Runs that ended before their time."""
        return sum(len(group.stopped) for group in self.study.groups)

    @property
    def uncounted(self) -> int:
        """Those of them that are in no number, as the store does not say what the idle policy returns."""
        return sum(len(group.uncounted) for group in self.study.groups)

    @property
    def unfinished(self) -> int:
        """Runs whose episodes are not all there yet."""
        return sum(len(group.unfinished) for group in self.study.groups)

    @cached_property
    def leading(self) -> tuple[Row, ...]:
        """One row for each algorithm in each panel: its best point, or the first if no run can be compared."""
        chosen: dict[tuple[str, float, str], Row] = {}
        for row in self.rows:
            key = row.group.oracle, row.group.error, row.group.algo
            if row.best or key not in chosen:
                chosen[key] = row
        return tuple(chosen.values())

    def of(self, group: Group) -> Row:
        """The numbers of `group`."""
        return self._row_of[group]

    @cached_property
    def _row_of(self) -> dict[Group, Row]:
        return {row.group: row for row in self.rows}

    @property
    def figures(self) -> dict[str, "ImageFile"]:
        """The figures that were drawn, by their names: `curves`, `rates`, and `heatmap` of a grid."""
        return {path.stem: ImageFile(path) for path in self.files if path.suffix == ".png"}

    def __repr__(self) -> str:
        runs = sum(group.runs for group in self.study.groups)
        folder = f", {self.files[0].parent}" if self.files else ""
        return f"<report on {self.study.env}: {len(self.rows)} groups, {runs} runs{folder}>"

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        from gpcjax.report.inline import summary_inline

        return summary_inline(self)

    def table(self) -> pd.DataFrame:
        """What summary.csv holds: tidy, an estimate `x` with its interval in `x_lower` and `x_upper`."""
        return pd.DataFrame([_row_columns(self.study, row) for row in self.rows])

    def difference_table(self) -> pd.DataFrame:
        """What differences.csv holds, in the same form."""
        rows = [_difference_columns(self.study, difference) for difference in self.differences]
        return pd.DataFrame(
            rows, columns=list(rows[0]) if rows else ["env", "oracle", "error", "first", "second"]
        )


def summarise(study: Study) -> Summary:
    """All numbers of `study`."""
    found = sum(group.runs + len(group.uncounted) + len(group.unfinished) for group in study.groups)
    found += study.cut_runs
    rows = _rows(study)
    differences, unpaired = _differences(study, {row.group for row in rows if row.best})
    return Summary(
        study=study,
        rows=rows,
        differences=differences,
        missing=max(0, int(study.manifest.get("cells") or 0) - found),
        unpaired=unpaired,
    )


def _rows(study: Study) -> tuple[Row, ...]:
    """The numbers of each group, in their order: of all groups at once, for what they have in common."""
    groups = study.groups
    finals = [group.final for group in groups]
    closed = [group.closed_after(study.idle, study.oracle(group.oracle)).values for group in groups]
    columns = (
        mean_intervals([final.values for final in finals]),
        mean_intervals([group.area.values for group in groups]),
        median_intervals(closed),
        [int(np.isinf(times).sum()) for times in closed],
        mean_intervals([group.corrections_used.values for group in groups]),
        *_best_and_tied(groups, finals),
    )
    return tuple(itertools.starmap(Row, zip(groups, *columns, strict=True)))


def _best_and_tied(groups: Sequence[Group], finals: Sequence[Scores]) -> tuple[list[bool], list[bool]]:
    """Whether each group is the best point of its algorithm in its panel, and whether it is tied with that."""
    grids: dict[tuple[str, float, str], list[int]] = {}
    for place, group in enumerate(groups):
        grids.setdefault((group.oracle, group.error, group.algo), []).append(place)
    best, tied = np.zeros((2, len(groups)), bool)
    for places in grids.values():
        which, these = best_and_tied([finals[place] for place in places])
        tied[places] = these
        if which is not None:
            best[places[which]] = True
    return best.tolist(), tied.tolist()


def _differences(study: Study, best: Set[Group]) -> tuple[tuple[Difference, ...], int]:
    """Of each two algorithms in each panel, and how many pairs of points were left out."""
    found = [
        pairs_of(study.select(oracle, error, one), study.select(oracle, error, other), best)
        for oracle, error in study.panels
        for one, other in itertools.combinations(study.algorithms, 2)
    ]
    pairs = [pair for those, _ in found for pair in those]
    areas = {group: group.area for group in dict.fromkeys(itertools.chain.from_iterable(pairs))}
    numbers = paired_differences([(areas[first], areas[second]) for first, second in pairs])
    differences = tuple(Difference(*pair, *number) for pair, number in zip(pairs, numbers, strict=True))
    return differences, sum(left_out for _, left_out in found)


def pairs_of(
    firsts: Sequence[Group], seconds: Sequence[Group], best: Set[Group]
) -> tuple[list[tuple[Group, Group]], int]:
    """The points of two algorithms that agree in the settings that both have, in the order of the first, then second.

    Where two algorithms share few settings, points of the one meet many of the other. Of more than `MOST_PAIRS` pairs
    there are those alone of which one is the best point of its algorithm; the second number is how many are left out.
    """
    kinds: dict[tuple[str, ...], list[int]] = {}
    for place, group in enumerate(seconds):
        kinds.setdefault(group.point.names, []).append(place)
    partners: dict[tuple[tuple[str, ...], tuple[str, ...]], dict[tuple[float, ...], list[int]]] = {}
    met: list[list[int]] = []
    for group in firsts:
        mine, lists = dict(group.point.values), []
        for names, places in kinds.items():
            shared = tuple(name for name in names if name in mine)
            if (names, shared) not in partners:
                partners[names, shared] = _by_values(seconds, places, shared)
            lists.append(partners[names, shared].get(tuple(mine[name] for name in shared), []))
        met.append(lists[0] if len(lists) == 1 else sorted(itertools.chain(*lists)))
    count = sum(map(len, met))
    if count > MOST_PAIRS:
        leaders = [place for place, group in enumerate(seconds) if group in best]
        met = [
            places
            if first in best
            else [place for place in leaders if seconds[place].point.agrees(first.point)]
            for first, places in zip(firsts, met, strict=True)
        ]
    pairs = [(first, seconds[place]) for first, places in zip(firsts, met, strict=True) for place in places]
    return pairs, count - len(pairs)


def _by_values(
    groups: Sequence[Group], places: Sequence[int], names: Sequence[str]
) -> dict[tuple[float, ...], list[int]]:
    """The places by the values of these settings."""
    found: dict[tuple[float, ...], list[int]] = {}
    for place in places:
        values = dict(groups[place].point.values)
        found.setdefault(tuple(values[name] for name in names), []).append(place)
    return found


def _row_columns(study: Study, row: Row) -> dict[str, Any]:
    group, oracle = row.group, study.oracle(row.group.oracle)
    return {
        "env": study.env,
        "oracle": group.oracle,
        "error": group.error,
        "algo": group.algo,
        **{name: group.point.get(name) for name in study.varying},
        "runs": group.runs,
        "stopped": len(group.stopped),
        "unfinished": len(group.unfinished),
        **group.limits._asdict(),
        **_interval_columns("final_return", row.final),
        **_interval_columns("area", row.area),
        **_interval_columns("episodes_to_90", row.closed),
        "never": row.never,
        **_interval_columns("corrections", row.corrections),
        "oracle_return": oracle.mean,
        "oracle_std": oracle.std,
        "idle_return": study.idle.mean,
        "idle_std": study.idle.std,
        "best": row.best,
        "tied": row.tied,
    }


def _difference_columns(study: Study, difference: Difference) -> dict[str, Any]:
    return {
        "env": study.env,
        "oracle": difference.first.oracle,
        "error": difference.first.error,
        "first": difference.first.algo,
        "second": difference.second.algo,
        **{name: difference.point.get(name) for name in study.varying},
        "pairs": difference.pairs,
        **_interval_columns("area_difference", difference.area),
        "excludes_zero": difference.area.excludes_zero,
    }


def _interval_columns(name: str, interval: Interval) -> dict[str, float]:
    return {name: interval.estimate, f"{name}_lower": interval.lower, f"{name}_upper": interval.upper}
