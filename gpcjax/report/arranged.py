"""The episodes of a store as one table: a line for each run, those of a group below each other by seed."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from gpcjax.recording import CUT
from gpcjax.sweep.coded import Coded
from gpcjax.sweep.counted import OK, Episodes


class Stopped(NamedTuple):
    """The runs that ended before their time, by their line: the episode that each reached, and its status there."""

    line: Int[np.ndarray, "stopped"]
    episode: Int[np.ndarray, "stopped"]
    status: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Arranged:
    """Runs in the order of their group, then seed.

    | Field         | Shape            | What                                                                     |
    |---------------|------------------|--------------------------------------------------------------------------|
    | `cell`        | [runs]           | the cell of each line                                                    |
    | `returns`     | [runs, episodes] | nan where a run has no such episode; after a stop those of the idle policy |
    | `corrections` | [runs, episodes] | 0 where a run has no such episode, and after a stop                      |
    | `whole`       | [runs]           | whether a run has all episodes, or stopped                               |
    | `stopped`     |                  | the runs that stopped                                                    |
    """

    cell: Int[np.ndarray, "runs"]
    returns: Float[np.ndarray, "runs episodes"]
    corrections: Float[np.ndarray, "runs episodes"]
    whole: Bool[np.ndarray, "runs"]
    stopped: Stopped


class Lines(NamedTuple):
    """The runs of one group: those that are counted; what stopped (seed, episode, why), what is not whole."""

    seeds: Int[np.ndarray, "runs"]
    returns: Float[np.ndarray, "runs episodes"]
    corrections: Float[np.ndarray, "runs episodes"]
    stopped: list[tuple[int, int, str]]
    unfinished: tuple[int, ...]
    totals: list[int]
    """Sums over the counted runs, in the order of `Episodes.totals`."""


def without_cut(episodes: Episodes) -> tuple[Episodes, int]:
    """The same without the episodes of a lesson that were ended before the task did, and how many these are.

    Those that are left are counted from 1 again; `totals` are of these anyway. Runs of which none is left are left out.
    """
    cut = np.array([status == CUT for status in episodes.status.values], bool)[episodes.status.codes]
    if not cut.any():
        return episodes, 0
    order = np.lexsort((episodes.episode, episodes.cell))
    before = np.cumsum(cut[order])  # of the cells before it, too
    first = np.searchsorted(episodes.cell[order], episodes.cell[order])
    earlier = np.empty(len(cut), np.int64)
    earlier[order] = before - np.concatenate([[0], before])[first]
    kept = ~cut
    left = replace(
        episodes,
        cell=episodes.cell[kept],
        episode=(episodes.episode - earlier)[kept].astype(np.int32),
        returns=episodes.returns[kept],
        corrections=episodes.corrections[kept],
        status=Coded(episodes.status.codes[kept], episodes.status.values),
    )
    return left.of_cells(np.bincount(left.cell, minlength=len(left.seeds)) > 0), int(cut.sum())


def broken(episodes: Episodes) -> Bool[np.ndarray, "rows"]:
    """The episodes in which a run stopped."""
    ok = np.array([status == OK for status in episodes.status.values])
    return ~ok[episodes.status.codes] | ~np.isfinite(episodes.returns)


def compared_length(episodes: Episodes, broken: Bool[np.ndarray, "rows"], specified: int | None) -> int:
    """How long runs are compared: what is specified, or as far as the longest run is that is still to be finished."""
    over = np.zeros(len(episodes.seeds), bool)
    over[episodes.cell[broken]] = True
    going_on = ~over[episodes.cell]
    if not going_on.any():
        return int(specified or episodes.episode.max())
    reached = int(episodes.episode[going_on].max())
    return min(specified, reached) if specified else reached


def arranged(
    episodes: Episodes,
    group: Int[np.ndarray, "cells"],
    broken: Bool[np.ndarray, "rows"],
    length: int,
    idle: float,
) -> Arranged:
    """All runs as far as `length`, in the order of the numbers of their groups; `idle` is the idle policy's return."""
    cell = np.lexsort((episodes.seeds, group))
    line = np.empty(len(cell), np.int64)
    line[cell] = np.arange(len(cell))
    stopped = _stopped(episodes, line, np.flatnonzero(broken))
    early = episodes.episode <= length
    place = line[episodes.cell[early]], episodes.episode[early] - 1
    returns, corrections = np.full((len(cell), length), np.nan), np.zeros((len(cell), length))
    there = np.zeros(returns.shape, dtype=bool)
    returns[place] = episodes.returns[early]
    corrections[place] = episodes.corrections[early]
    there[place] = True
    from_there = np.arange(1, length + 1) >= stopped.episode[:, None]
    after = np.arange(1, length + 1) > stopped.episode[:, None]
    returns[stopped.line] = np.where(from_there, idle, returns[stopped.line])
    corrections[stopped.line] = np.where(after, 0.0, corrections[stopped.line])
    there[stopped.line] |= from_there
    return Arranged(cell, returns, corrections, np.asarray(there.all(axis=1)), stopped)


def parted(
    episodes: Episodes, runs: Arranged, number: Int[np.ndarray, "runs"], groups: int, stops_count: bool
) -> Iterator[Lines]:
    """The runs of each group; `number` is that of the group of each line, and ascends.

    Runs that are not whole are not counted, and those that stopped only if `stops_count`. Where every run is counted
    the arrays are parts of the table, not copies.
    """
    broke = np.zeros(len(number), bool)
    broke[runs.stopped.line] = True
    kept = runs.whole & (stops_count | ~broke)
    seeds = episodes.seeds[runs.cell]
    returns, corrections, counted = runs.returns, runs.corrections, seeds
    if not kept.all():
        returns, corrections, counted = returns[kept], corrections[kept], seeds[kept]
    ends = np.arange(groups + 1)
    cuts = np.searchsorted(number[kept], ends)
    sums = [
        np.concatenate([[0], np.cumsum(total[runs.cell[kept]])])[cuts] for total in episodes.totals.values()
    ]
    totals = np.diff(sums, axis=1).T.tolist()
    line, episode, status = runs.stopped
    told = np.flatnonzero(runs.whole[line])
    stops = [(int(seeds[line[i]]), int(episode[i]), status[i]) for i in told]
    stop_cuts = np.searchsorted(number[line[told]], ends)
    going_on, going_cuts = seeds[~runs.whole].tolist(), np.searchsorted(number[~runs.whole], ends)
    for place in range(groups):
        mine = slice(cuts[place], cuts[place + 1])
        yield Lines(
            counted[mine],
            returns[mine],
            corrections[mine],
            stops[stop_cuts[place] : stop_cuts[place + 1]],
            tuple(going_on[going_cuts[place] : going_cuts[place + 1]]),
            totals[place],
        )


def _stopped(episodes: Episodes, line: Int[np.ndarray, "cells"], rows: Int[np.ndarray, "broken"]) -> Stopped:
    """Of the rows in which a run stopped the first of each run, by the lines."""
    rows = rows[np.lexsort((episodes.episode[rows], line[episodes.cell[rows]]))]
    lines, first = np.unique(line[episodes.cell[rows]], return_index=True)
    names = [_reason(status) for status in episodes.status.values]
    status = tuple(names[code] for code in episodes.status.codes[rows[first]])
    return Stopped(lines, episodes.episode[rows[first]].astype(np.int64), status)


def _reason(status: str) -> str:
    return "non-finite" if status == OK else status
