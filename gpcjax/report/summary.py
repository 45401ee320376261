"""The numbers of a study: a row for each group and each pair of algorithms, and which points of a grid are best."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gpcjax.report.groups import Group, Point, Study, unique
from gpcjax.report.statistics import (
    Interval,
    best_and_tied,
    mean_interval,
    median_interval,
    paired_difference,
)


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
class Summary:
    """What a report says in numbers.

    `rows` are in the order of `study.groups`. `missing` counts planned cells without any episode. `files` are those
    that were written.
    """

    study: Study
    rows: tuple[Row, ...]
    differences: tuple[Difference, ...]
    missing: int = 0
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

    @property
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
        return next(row for row in self.rows if row.group is group)

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
    return Summary(
        study=study,
        rows=tuple(
            row
            for members in _grids(study)
            for row in _rows(study, members, *best_and_tied([group.final for group in members]))
        ),
        differences=tuple(
            Difference(first, second, *paired_difference(first.area, second.area))
            for oracle, error in study.panels
            for one, other in itertools.combinations(study.algorithms, 2)
            for first in study.select(oracle, error, one)
            for second in study.select(oracle, error, other)
            if first.point.agrees(second.point)
        ),
        missing=max(0, int(study.manifest.get("cells") or 0) - found),
    )


def _grids(study: Study) -> list[tuple[Group, ...]]:
    """The points of each algorithm in each panel, in the order of the groups."""
    keys = unique((group.oracle, group.error, group.algo) for group in study.groups)
    return [study.select(*key) for key in keys]


def _rows(study: Study, groups: Sequence[Group], best: int | None, tied: np.ndarray) -> list[Row]:
    rows = []
    for index, group in enumerate(groups):
        closed = group.closed_after(study.idle, study.oracle(group.oracle)).values
        rows.append(
            Row(
                group=group,
                final=mean_interval(group.final.values[:, None]),
                area=mean_interval(group.area.values[:, None]),
                closed=median_interval(closed),
                never=int(np.isinf(closed).sum()),
                corrections=mean_interval(group.corrections_used.values[:, None]),
                best=index == best,
                tied=bool(tied[index]),
            )
        )
    return rows


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
