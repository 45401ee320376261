"""The rows of a store as groups of runs that differ in their seed only: the arrays that statistics and figures take."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gpcjax.errors import UserError
from gpcjax.registry import built_in
from gpcjax.report.statistics import Scores, first_crossing

T = TypeVar("T")

FINAL_EPISODES = 5
"""The final return is the mean of this many last episodes."""

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
        return tuple(stop for stop in self.stopped if stop.seed not in self.seeds)

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

    `episodes` is how long the compared runs are: as long as the specification says, or as the longest run so far.
    """

    env: str
    groups: tuple[Group, ...]
    episodes: int
    varying: tuple[str, ...]
    idle: Baseline
    oracles: Mapping[str, Baseline]
    manifest: Mapping[str, Any]

    @property
    def algorithms(self) -> tuple[str, ...]:
        order = self.manifest.get("specification", {}).get("algo", built_in("learner"))
        return tuple(sorted({group.algo for group in self.groups}, key=lambda algo: _rank(algo, order)))

    @property
    def errors(self) -> tuple[float, ...]:
        return tuple(sorted(unique(group.error for group in self.groups)))

    @property
    def panels(self) -> tuple[tuple[str, float], ...]:
        """Each oracle with each error rate: what is compared with each other."""
        return unique((group.oracle, group.error) for group in self.groups)

    def oracle(self, name: str) -> Baseline:
        return self.oracles.get(name, Baseline())

    def select(self, oracle: str, error: float, algo: str | None = None) -> tuple[Group, ...]:
        """The groups of one panel, of one algorithm if it is given."""
        return tuple(
            group
            for group in self.groups
            if (group.oracle, group.error) == (oracle, error) and algo in (None, group.algo)
        )

    def axes(self, algo: str) -> tuple[str, ...]:
        """The settings that take several values for `algo`."""
        points = [group.point for group in self.groups if group.algo == algo]
        return tuple(name for name in self.varying if len({point.get(name) for point in points}) > 1)


def gather(episodes: pd.DataFrame, manifest: Mapping[str, Any]) -> Study:
    """Sort the rows of a store into groups, ordered by oracle, error, algorithm, point.

    Raises:
        UserError: there is no row.
    """
    if episodes.empty:
        raise UserError("the store holds no episodes: run the sweep first")
    specification = manifest.get("specification", {})
    baselines = manifest.get("baselines") or {}
    varying = tuple(name for name in manifest.get("varying", ()) if name in episodes.columns)
    keys, idle = ["oracle", "error", "algo", *varying], _baseline(baselines.get("idle"))
    length = _length(episodes, keys, specification.get("episodes"))
    groups = [
        _group(rows, varying, length, idle) for _, rows in episodes.groupby(keys, dropna=False, sort=False)
    ]
    oracles, algorithms = specification.get("oracle", ()), specification.get("algo", built_in("learner"))

    def place(group: Group) -> tuple[Any, ...]:
        algorithm = _rank(group.algo, algorithms)
        return _rank(group.oracle, oracles), group.error, algorithm, group.point.values

    return Study(
        env=str(specification.get("env") or episodes["env"].iloc[0]),
        groups=tuple(sorted(groups, key=place)),
        episodes=length,
        varying=varying,
        idle=idle,
        oracles={name: _baseline(numbers) for name, numbers in (baselines.get("oracles") or {}).items()},
        manifest=manifest,
    )


def unique(values: Iterable[T]) -> tuple[T, ...]:
    """Each value once, in order of appearance."""
    return tuple(dict.fromkeys(values))


def _broken(rows: pd.DataFrame) -> Bool[np.ndarray, "rows"]:
    """The episodes in which a run stopped."""
    return np.asarray(rows["status"] != "ok") | ~np.isfinite(rows["return"].to_numpy(np.float64))


def _length(episodes: pd.DataFrame, keys: Sequence[str], specified: int | None) -> int:
    """How long runs are compared: what is specified, or as far as the longest run is that is still to be finished."""
    run = episodes.groupby([*keys, "seed"], dropna=False, sort=False).ngroup().to_numpy()
    over = np.bincount(run, weights=_broken(episodes))[run] > 0
    episode = episodes["episode"].to_numpy(np.int64)
    if over.all():
        return int(specified or episode.max())
    reached = int(episode[~over].max())
    return min(specified, reached) if specified else reached


def _group(rows: pd.DataFrame, varying: Sequence[str], length: int, idle: Baseline) -> Group:
    key = rows.iloc[0]
    seeds, run = np.unique(rows["seed"].to_numpy(np.int64), return_inverse=True)
    episode, status = rows["episode"].to_numpy(np.int64), rows["status"].to_numpy(str)
    longest = max(length, int(episode.max()))
    returns, corrections = np.full((len(seeds), longest), np.nan), np.zeros((len(seeds), longest))
    there = np.zeros(returns.shape, dtype=bool)
    returns[run, episode - 1] = rows["return"].to_numpy(np.float64)
    corrections[run, episode - 1] = rows["corrections"].to_numpy(np.float64)
    there[run, episode - 1] = True
    stops: dict[int, Stop] = {}
    for i in sorted(np.flatnonzero(_broken(rows)), key=lambda i: episode[i]):
        stops.setdefault(run[i], Stop(int(seeds[run[i]]), int(episode[i]), _reason(status[i])))
    for place, stop in stops.items():
        returns[place, stop.episode - 1 :] = idle.mean
        corrections[place, stop.episode :] = 0.0
        there[place, stop.episode - 1 :] = True
    whole = np.asarray(there[:, :length].all(axis=1))
    broke = np.isin(np.arange(len(seeds)), list(stops))
    kept = whole & (~broke | (idle.n > 0))
    return Group(
        oracle=str(key["oracle"]),
        error=float(key["error"]),
        algo=str(key["algo"]),
        point=Point(tuple((name, float(key[name])) for name in varying if not pd.isna(key[name]))),
        seeds=seeds[kept],
        returns=returns[kept, :length],
        corrections=corrections[kept, :length],
        stopped=tuple(stops[place] for place in sorted(stops) if whole[place]),
        unfinished=tuple(seeds[~whole].tolist()),
        limits=Limits(
            *(int(rows[name].to_numpy()[kept[run]].sum()) for name in ("length", "clipped", "full"))
        ),
    )


def _reason(status: str) -> str:
    return "non-finite" if status == "ok" else status


def _baseline(numbers: Mapping[str, Any] | None) -> Baseline:
    if not numbers:
        return Baseline()
    return Baseline(float(numbers["mean"]), float(numbers["std"]), int(numbers["n"]))


def _rank(name: str, order: Sequence[str]) -> tuple[int, str]:
    return (order.index(name) if name in order else len(order)), name
