"""The rows of a store as groups of runs that differ in their seed only: the arrays that statistics and figures take."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gpcjax.errors import UserError
from gpcjax.registry import built_in
from gpcjax.report.arranged import Lines, arranged, broken, compared_length, parted, without_cut
from gpcjax.report.statistics import Scores, first_crossing
from gpcjax.sweep.coded import Coded, joint
from gpcjax.sweep.counted import Episodes
from gpcjax.sweep.labels import remember
from gpcjax.sweep.sofar import FINAL_EPISODES as FINAL_EPISODES

T = TypeVar("T")

CLOSED_GAP = 0.9
"""The part of the gap between the idle policy and the oracle that a run has to close."""


class Baseline(NamedTuple):
    """Return of a policy that does not learn, over `n` starts; nan and 0 if the store does not say."""

    mean: float = np.nan
    std: float = np.nan
    n: int = 0


class Stop(NamedTuple):
    """A run that ended before its time: the episode it reached and why."""

    seed: int
    episode: int
    status: str


class Limits(NamedTuple):
    """Steps, those of them whose action was outside [-1, 1] and clipped, and corrections that met a full dictionary."""

    steps: int
    clipped: int
    met_full: int


@dataclass(frozen=True)
class Point:
    """Values of the settings that vary; a setting that does not concern the algorithm is left out."""

    values: tuple[tuple[str, float], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The settings that concern the algorithm."""
        return tuple(name for name, _ in self.values)

    def get(self, name: str) -> float | None:
        return dict(self.values).get(name)

    def agrees(self, other: "Point") -> bool:
        """Whether the settings that concern both have the same values."""
        mine, theirs = dict(self.values), dict(other.values)
        return all(mine[name] == theirs[name] for name in mine.keys() & theirs.keys())


@dataclass(frozen=True, eq=False)
class Group:
    """The runs of one algorithm with one oracle, error rate and point.

    `seeds`, `returns` and `corrections` (in each episode) hold the runs that are counted: those that are finished, and
    those that stopped. A teaching that broke down leaves a robot that does nothing: from the episode in which a run
    stopped on (no matter how far it got in it), its return is the mean of the idle policy's, and after it there are no
    corrections. Where the store does not say what the idle policy returns, stopped runs cannot be counted.

    `stopped` are the runs whose status is not ok, or that have a return that is not finite; `unfinished` the seeds
    whose episodes are not all there yet. `limits` are totals over what the counted runs did.
    """

    oracle: str
    error: float
    algo: str
    point: Point
    seeds: Int[np.ndarray, "runs"]
    returns: Float[np.ndarray, "runs episodes"]
    corrections: Float[np.ndarray, "runs episodes"]
    stopped: tuple[Stop, ...]
    unfinished: tuple[int, ...]
    limits: Limits

    @property
    def runs(self) -> int:
        return len(self.seeds)

    @property
    def broke_down(self) -> Bool[np.ndarray, "runs"]:
        """Which of the counted runs stopped."""
        return np.isin(self.seeds, [stop.seed for stop in self.stopped])

    @property
    def uncounted(self) -> tuple[Stop, ...]:
        """The stopped runs that are in no number."""
        counted = np.isin([stop.seed for stop in self.stopped], self.seeds)
        return tuple(stop for stop, there in zip(self.stopped, counted, strict=True) if not there)

    @property
    def final(self) -> Scores:
        """Mean return of the last episodes."""
        return self._scores(self.returns[:, -FINAL_EPISODES:].mean(axis=1))

    @property
    def area(self) -> Scores:
        """Area under the learning curve: the mean return of an episode."""
        return self._scores(self.returns.mean(axis=1))

    @property
    def corrections_used(self) -> Scores:
        """Corrections in all episodes together."""
        return self._scores(self.corrections.sum(axis=1))

    def closed_after(self, idle: Baseline, oracle: Baseline) -> Scores:
        """The first episode that closes `CLOSED_GAP` of the gap; inf for never, nan if there is no gap to close."""
        gap = oracle.mean - idle.mean
        return self._scores(first_crossing(self.returns, idle.mean + CLOSED_GAP * gap if gap > 0 else np.nan))

    def _scores(self, values: Float[np.ndarray, "runs"]) -> Scores:
        return Scores(self.seeds, values)


@dataclass(frozen=True, eq=False)
class Study:
    """All groups of a store with what its manifest says of them.

    `episodes` is how long the compared runs are: as long as the specification says, or as the longest run so far. `cut`
    counts the episodes of a lesson that are in no number, as they were ended before the task did, and `cut_runs` the
    runs that have no other; these are in no group.
    """

    env: str
    groups: tuple[Group, ...]
    episodes: int
    varying: tuple[str, ...]
    idle: Baseline
    oracles: Mapping[str, Baseline]
    manifest: Mapping[str, Any]
    cut: int = 0
    cut_runs: int = 0

    @property
    def is_taught(self) -> bool:
        """Whether people have taught, whose runs no sweep could go on with."""
        return bool(self.cut) or self.manifest.get("specification", {}).get("teacher") == "person"

    @cached_property
    def algorithms(self) -> tuple[str, ...]:
        order = self.manifest.get("specification", {}).get("algo", built_in("learner"))
        return tuple(sorted({group.algo for group in self.groups}, key=lambda algo: _rank(algo, order)))

    @cached_property
    def errors(self) -> tuple[float, ...]:
        return tuple(sorted(unique(group.error for group in self.groups)))

    @cached_property
    def panels(self) -> tuple[tuple[str, float], ...]:
        """Each oracle with each error rate: what is compared with each other."""
        return unique((group.oracle, group.error) for group in self.groups)

    def oracle(self, name: str) -> Baseline:
        return self.oracles.get(name, Baseline())

    def select(self, oracle: str, error: float, algo: str | None = None) -> tuple[Group, ...]:
        """The groups of one panel, of one algorithm if it is given."""
        return tuple(self._selections.get((oracle, error, algo), ()))

    @cached_property
    def _selections(self) -> Mapping[tuple[str, float, str | None], list[Group]]:
        found: dict[tuple[str, float, str | None], list[Group]] = {}
        for group in self.groups:
            for algo in (None, group.algo):
                found.setdefault((group.oracle, group.error, algo), []).append(group)
        return found

    def axes(self, algo: str) -> tuple[str, ...]:
        """The settings that take several values for `algo`."""
        points = [group.point for group in self.groups if group.algo == algo]
        return tuple(name for name in self.varying if len({point.get(name) for point in points}) > 1)


def gather(episodes: pd.DataFrame | Episodes, manifest: Mapping[str, Any]) -> Study:
    """Sort the rows of a store into groups, ordered by oracle, error, algorithm, point.

    Raises:
        UserError: there is no row, or none of a whole episode.
    """
    remember(manifest)
    specification = manifest.get("specification", {})
    baselines = manifest.get("baselines") or {}
    if isinstance(episodes, pd.DataFrame):
        if episodes.empty:
            raise UserError("the store holds no episodes: run the sweep first")
        varying = [name for name in manifest.get("varying", ()) if name in episodes.columns]
        episodes = Episodes.of(episodes, varying)
    runs_there = len(episodes.seeds)
    episodes, cut = without_cut(episodes)
    if cut and not len(episodes.cell):
        raise UserError("each of its episodes was ended before the task did: let the task end one")
    idle = _baseline(baselines.get("idle"))
    over = broken(episodes)
    length = compared_length(episodes, over, specification.get("episodes"))
    keys, number = _keys(episodes, specification)
    runs = arranged(episodes, number, over, length, idle.mean)
    lines = parted(episodes, runs, number[runs.cell], len(keys), stops_count=idle.n > 0)
    return Study(
        env=str(specification.get("env") or episodes.env),
        groups=tuple(_group(key, of) for key, of in zip(keys, lines, strict=True)),
        episodes=length,
        varying=tuple(list(episodes.settings)[3:]),
        idle=idle,
        oracles={name: _baseline(numbers) for name, numbers in (baselines.get("oracles") or {}).items()},
        manifest=manifest,
        cut=cut,
        cut_runs=runs_there - len(episodes.seeds),
    )


def unique(values: Iterable[T]) -> tuple[T, ...]:
    """Each value once, in order of appearance."""
    return tuple(dict.fromkeys(values))


class _Key(NamedTuple):
    """What the runs of a group have in common."""

    oracle: str
    error: float
    algo: str
    point: Point


def _keys(
    episodes: Episodes, specification: Mapping[str, Any]
) -> tuple[list[_Key], Int[np.ndarray, "cells"]]:
    """The groups in their order, and the number of that of each cell."""
    oracles, algorithms = specification.get("oracle", ()), specification.get("algo", built_in("learner"))
    settings = episodes.settings
    _, once, number = np.unique(
        joint([column.codes for column in settings.values()]), return_index=True, return_inverse=True
    )
    columns = {name: _values(column, once) for name, column in settings.items()}
    varying = [name for name in columns if name not in ("algo", "oracle", "error")]
    rows = zip(*(columns[name] for name in ("oracle", "error", "algo", *varying)), strict=True)
    keys = [
        _Key(str(oracle), float(error), str(algo), _point(varying, values))
        for oracle, error, algo, *values in rows
    ]

    def place(index: int) -> tuple[Any, ...]:
        key = keys[index]
        return _rank(key.oracle, oracles), key.error, _rank(key.algo, algorithms), key.point.values

    order = sorted(range(len(keys)), key=place)
    return [keys[index] for index in order], np.argsort(order)[number]


def _group(key: _Key, lines: Lines) -> Group:
    return Group(
        *key,
        seeds=lines.seeds,
        returns=lines.returns,
        corrections=lines.corrections,
        stopped=tuple(Stop(*stop) for stop in lines.stopped),
        unfinished=lines.unfinished,
        limits=Limits(*lines.totals),
    )


def _values(column: Coded, cells: Int[np.ndarray, "groups"]) -> list[Any]:
    return [column.values[code] if code >= 0 else None for code in column.codes[cells].tolist()]


def _point(names: Sequence[str], values: Sequence[float | None]) -> Point:
    return Point(
        tuple((name, float(value)) for name, value in zip(names, values, strict=True) if value is not None)
    )


def _baseline(numbers: Mapping[str, Any] | None) -> Baseline:
    if not numbers:
        return Baseline()
    return Baseline(float(numbers["mean"]), float(numbers["std"]), int(numbers["n"]))


def _rank(name: str, order: Sequence[str]) -> tuple[int, str]:
    return (order.index(name) if name in order else len(order)), name
