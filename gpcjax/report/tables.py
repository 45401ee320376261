"""The tables of a report, and the sentences that go with them."""

import math
from collections import Counter
from collections.abc import Sequence

from gpcjax.report import words
from gpcjax.report.document import Kind, Sheet
from gpcjax.report.groups import CLOSED_GAP, FINAL_EPISODES, Group, Study, unique
from gpcjax.report.statistics import MANY_RUNS
from gpcjax.report.summary import Difference, Row, Summary

MOST_ROWS = 60
"""Longer tables of differences are left to the files."""

MOST_LEADING = 300
"""Rows of a table of results, limits or best points: of more the first."""

MOST_STOPPED = 30
"""Rows whose stopped runs are listed."""

CLOSED = f"{100 * CLOSED_GAP:.0f}%"

KINDS: dict[str, Kind] = {"error": "word", "algo": "word", "difference": "word"}
"""Of the columns that hold no numbers."""


def result_sheets(summary: Summary) -> list[Sheet]:
    """Algorithm by error rate, a sheet for each oracle; of a grid the best points."""
    return [
        _results(summary.study, oracle, _leading(summary, oracle), grid=False) for oracle in _oracles(summary)
    ]


def grid_sheets(summary: Summary) -> list[Sheet]:
    """The same for every point of a grid."""
    return [
        _results(
            summary.study, oracle, [row for row in summary.rows if row.group.oracle == oracle], grid=True
        )
        for oracle in _oracles(summary)
    ]


def point_sheets(summary: Summary) -> list[Sheet]:
    """The best point of each algorithm that has several, and how many are tied with it; a sheet for each oracle."""
    sheets = []
    for oracle in _oracles(summary):
        best = [row for row in _leading(summary, oracle) if row.best]
        decimals = words.places([row.final.estimate for row in best])
        rows, errors = [], []
        for row in best:
            points = [
                summary.of(group) for group in summary.study.select(oracle, row.group.error, row.group.algo)
            ]
            if len(points) > 1:
                tied = sum(point.tied for point in points)
                final = words.interval(row.final, decimals)
                rows.append((*_head(row.group, summary.study.varying), final, str(tied), str(len(points))))
                errors.append(row.group.error)
        if rows:
            columns = ("error", "algo", *_symbols(summary.study), "final return", "tied", "points")
            sheets.append(
                Sheet(
                    f"best points of the grid, oracle {oracle}", columns, tuple(rows), _breaks(errors), KINDS
                )
            )
    return sheets


def difference_sheets(summary: Summary) -> list[Sheet]:
    """Paired differences in area, a sheet for each oracle."""
    sheets = []
    for oracle in _oracles(summary):
        shown = [difference for difference in summary.differences if difference.first.oracle == oracle]
        if shown:
            columns = ("error", "difference", *_symbols(summary.study), "in area", "pairs")
            decimals = words.places([bound for difference in shown for bound in difference.area])
            rows = tuple(_difference(difference, summary.study, decimals) for difference in shown)
            breaks = _breaks([difference.first.error for difference in shown])
            sheets.append(Sheet(f"paired differences, oracle {oracle}", columns, rows, breaks, KINDS))
    return sheets


def warnings(summary: Summary) -> list[str]:
    """Runs that stopped or are not in the numbers, and why: a sentence each."""
    study, lines = summary.study, []
    if summary.stopped:
        reasons = Counter(stop.status for group in study.groups for stop in group.stopped)
        causes = ", ".join(f"{words.STATUS_TEXTS.get(status, status)}: {n}" for status, n in reasons.items())
        if summary.uncounted:
            fate = f"{_are(summary.uncounted)} in no number below: the store lacks the idle policy's return."
        else:
            fate = (
                "count as a robot that does nothing: from the episode in which one stopped on, it has the mean "
                f"return of the idle policy ({words.number(study.idle.mean, words.places([study.idle.mean]))})."
            )
        lines.append(f"{_runs(summary.stopped)} stopped ({causes}) and {fate}")
        lines += [f"  {line}" for line in stopped_lines(study)]
    full = sum(group.limits.met_full for group in study.groups)
    if full:
        policy = study.manifest.get("specification", {}).get("on_full", "error")
        lines.append(
            f"{full:,} corrections met a full dictionary (on_full {policy}) in runs that are in the numbers."
        )
    if summary.unfinished:
        is_in = f"{_has(summary.unfinished)} not finished and {_are(summary.unfinished)}"
        lines.append(f"{_runs(summary.unfinished)} {is_in} in no number below.")
    if summary.missing:
        lines.append(f"{_runs(summary.missing)} of the specification {_has(summary.missing)} no episode yet.")
    if (summary.unfinished or summary.missing) and not study.is_taught:
        lines.append("The same sweep again runs what is missing.")
    if study.cut:
        lines.append(f"{words.cut_short(study.cut)} {_are(study.cut)} in no number below.")
    if study.cut_runs:
        lines.append(f"{_runs(study.cut_runs)} {_has(study.cut_runs)} no other episode.")
    specified = study.manifest.get("specification", {}).get("episodes")
    if specified and not study.cut and study.episodes < specified:
        lines.append(f"No run is complete: these are the first {study.episodes} of {specified} episodes.")
    return lines


def stopped_lines(study: Study, most: int = 8) -> list[str]:
    """Where runs stopped, a line a group with at most `most` seeds; of many groups the first."""
    lines = []
    groups = [group for group in study.groups if group.stopped]
    for group in groups[:MOST_STOPPED]:
        shown = [f"{stop.seed} (episode {stop.episode})" for stop in group.stopped[:most]]
        rest = len(group.stopped) - len(shown)
        seeds = ", ".join(shown) + (f" and {rest} more" if rest else "")
        lines.append(f"{_name(group, study)}: seed {seeds}")
    if len(groups) > MOST_STOPPED:
        lines.append(f"and runs of {len(groups) - MOST_STOPPED:,} more rows, see summary.csv")
    return lines


def reading(summary: Summary) -> list[str]:
    """How to read the results."""
    lines = [
        f"Final return: mean of a run's last {FINAL_EPISODES} episodes. Area: mean return of an episode. Of both the "
        f"mean over runs; in brackets its 95% interval ({_interval_kind(summary)}).",
        f"To {CLOSED}: median first episode whose return closes {CLOSED} of the gap between idle (a = 0) and oracle; "
        "never: runs without one. Corr.: corrections used, mean over runs. Oracle, idle: mean ± standard deviation.",
    ]
    if summary.study.varying:
        lines.append(
            "Of a grid each algorithm shows its point with the highest mean final return; tied: points not "
            "significantly worse on the same seeds, that one included. All points are in summary.csv."
        )
    if any(len(_all_leading(summary, oracle)) > MOST_LEADING for oracle in _oracles(summary)):
        lines.append(f"A table has {MOST_LEADING} rows at most. All are in summary.csv.")
    clipped = [
        group.limits.clipped / group.limits.steps for group in summary.study.groups if group.limits.clipped
    ]
    if clipped:
        lines.append(
            f"Actions outside [-1, 1] were clipped at up to {float(f'{100 * max(clipped):.2g}'):g}% of a row's steps; "
            "all counts are in summary.csv."
        )
    runs = max(group.runs for group in summary.study.groups)
    if runs == 1:
        lines.append("One run has no interval: give more seeds.")
    elif 1 < runs < 10:
        lines.append(
            "Fewer than ten runs say little of rare outcomes, and so do their intervals: give more seeds."
        )
    return lines


def _interval_kind(summary: Summary) -> str:
    counts = {min(group.runs, MANY_RUNS) for group in summary.study.groups if group.runs}
    if counts == {MANY_RUNS}:
        return "Student's t"
    many = f"; Student's t from {MANY_RUNS:,} runs on" if MANY_RUNS in counts else ""
    return f"studentised bootstrap over seeds{many}"


def limits_sheets(summary: Summary) -> list[Sheet]:
    """Steps, clipped actions and full dictionaries of the same runs as `result_sheets`; a sheet for each oracle."""
    columns = ("error", "algo", *_symbols(summary.study), "runs", "steps", "clipped", "met full", "stopped")
    sheets = []
    for oracle in _oracles(summary):
        groups = [row.group for row in _leading(summary, oracle)]
        rows = tuple(
            (
                *_head(group, summary.study.varying),
                str(group.runs),
                f"{group.limits.steps:,}",
                f"{100 * group.limits.clipped / max(group.limits.steps, 1):.2f}%",
                f"{group.limits.met_full:,}",
                str(len(group.stopped)),
            )
            for group in groups
        )
        sheets.append(
            Sheet(f"steps, oracle {oracle}", columns, rows, _breaks([group.error for group in groups]), KINDS)
        )
    return sheets


def reading_differences(summary: Summary) -> list[str]:
    """How to read the differences."""
    lines = [
        "Differences: first minus second on the same seeds, mean and interval; * where that excludes zero."
    ]
    if summary.unpaired:
        lines.append(
            f"Of {summary.unpaired + len(summary.differences):,} pairs of points these are the "
            f"{len(summary.differences):,} with a best point."
        )
    return lines


def _results(study: Study, oracle: str, shown: Sequence[Row], grid: bool) -> Sheet:
    baseline, varying = study.oracle(oracle), study.varying if grid else ()
    final = words.places([*(row.final.estimate for row in shown), baseline.mean])
    area = words.places([row.area.estimate for row in shown])
    corrections = words.places([row.corrections.estimate for row in shown])
    columns = ("error", "algo", *(map(words.plain_symbol, varying)), *(("tied",) if grid else ()))
    columns += ("final return", "area", f"to {CLOSED}", "never", "corr.", "runs")
    columns += ("stopped",) if any(group.stopped for group in study.groups) else ()
    rows = [
        (
            *_head(row.group, varying),
            *(("best" if row.best else "tied" if row.tied else "",) if grid else ()),
            words.interval(row.final, final),
            words.interval(row.area, area),
            words.number(row.closed.estimate, 0 if row.closed.estimate % 1 == 0 else 1),
            words.ABSENT if math.isnan(row.closed.estimate) else str(row.never),
            words.number(row.corrections.estimate, corrections),
            str(row.group.runs),
            *((str(len(row.group.stopped)),) if columns[-1] == "stopped" else ()),
        )
        for row in shown
    ]
    blocks = [row.group.error for row in shown] if len(study.algorithms) > 1 else [0.0] * len(shown)
    for name, policy in (("oracle", baseline), ("idle", study.idle)):
        if policy.n:
            cells = [""] * len(columns)
            cells[1] = name  # by place: a setting may be called as one of our columns
            cells[2 + len(varying) + bool(grid)] = words.plus_minus(policy.mean, policy.std, final)
            rows.append(tuple(cells))
    return Sheet(f"{study.env}, oracle {oracle}", columns, tuple(rows), _breaks(blocks), KINDS)


def _difference(difference: Difference, study: Study, decimals: int) -> tuple[str, ...]:
    names = f"{words.algorithm(difference.first.algo)} - {words.algorithm(difference.second.algo)}"
    values = (words.value(difference.point.get(name)) for name in study.varying)
    star = " *" if difference.area.excludes_zero else "  "
    interval = words.interval(difference.area, decimals) + star
    return words.percent(difference.first.error), names, *values, interval, str(difference.pairs)


def _oracles(summary: Summary) -> tuple[str, ...]:
    return unique(group.oracle for group in summary.study.groups)


def _all_leading(summary: Summary, oracle: str) -> list[Row]:
    return [row for row in summary.leading if row.group.oracle == oracle]


def _leading(summary: Summary, oracle: str) -> list[Row]:
    """What a table shows, which stays readable."""
    return _all_leading(summary, oracle)[:MOST_LEADING]


def _head(group: Group, varying: Sequence[str]) -> tuple[str, ...]:
    values = (words.value(group.point.get(name)) for name in varying)
    return words.percent(group.error), words.algorithm(group.algo), *values


def _symbols(study: Study) -> tuple[str, ...]:
    return tuple(map(words.plain_symbol, study.varying))


def _breaks(blocks: Sequence[float]) -> frozenset[int]:
    last = len(blocks) - 1
    return frozenset(i for i in range(len(blocks)) if i == last or blocks[i] != blocks[i + 1])


def _name(group: Group, study: Study) -> str:
    point = words.point(group)
    oracle = f", oracle {group.oracle}" if len(study.oracles) > 1 else ""
    return f"{words.algorithm(group.algo)}, {words.percent(group.error)} error{oracle}{', ' + point if point else ''}"


def _runs(number: int) -> str:
    return f"{number} run{'' if number == 1 else 's'}"


def _are(number: int) -> str:
    return "is" if number == 1 else "are"


def _has(number: int) -> str:
    return "has" if number == 1 else "have"
