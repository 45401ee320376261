"""The stores of a reproduction as claims and figures take them. Loads no jax."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from gpcjax.report.curves import first_rates
from gpcjax.report.groups import Group, Study, gather
from gpcjax.report.statistics import Scores
from gpcjax.report.summary import Summary, summarise
from gpcjax.sweep import store
from gpcjax.sweep.runfolder import read_manifest, tell

EARLY = 10
"""Episodes that count as the leading part of a learning curve."""


@dataclass(frozen=True)
class Experiment:
    """One run folder, read."""

    study: Study
    episodes: pd.DataFrame
    corrections: pd.DataFrame

    @property
    def gap(self) -> float:
        """Return from the idle policy to the first oracle."""
        return next(iter(self.study.oracles.values())).mean - self.study.idle.mean

    def group(self, algo: str, error: float, oracle: str | None = None, delta: float | None = None) -> Group:
        """The runs of these settings."""
        oracle = next(iter(self.study.oracles)) if oracle is None else oracle
        groups = self.study.select(oracle, error, algo)
        return next(group for group in groups if delta is None or group.point.get("delta") == delta)

    @property
    def only(self) -> Group:
        """The runs, where all have the same settings."""
        (group,) = self.study.groups
        return group

    @cached_property
    def summary(self) -> Summary:
        """Its numbers, for the figures of a sweep's report."""
        return summarise(self.study)

    def rates(self, group: Group) -> Float[np.ndarray, "runs corrections"]:
        """The first learning rates of each run."""
        return first_rates(group, self.corrections)

    def rows(self, group: Group, column: str) -> Float[np.ndarray, "runs episodes"]:
        """A column of the episodes of the runs, where all of the experiment have the same settings."""
        table = self.episodes.pivot(index="seed", columns="episode", values=column)
        return table.loc[group.seeds].to_numpy(np.float64)[:, : group.returns.shape[1]]


def read(out: Path) -> Experiment | None:
    """The experiment in a run folder; None where it is missing or not complete."""
    if not (out / "manifest.json").exists() or not read_manifest(out)["complete"]:
        return None
    rows = store.read(out, tell)
    return Experiment(gather(rows.episodes, rows.manifest), rows.episodes, rows.corrections)


def joined(first: Experiment, second: Experiment) -> Experiment:
    """Two sweeps of one task that differ in their learners, as one."""
    lists = [list(each.study.manifest["specification"]["algo"]) for each in (first, second)]
    order = sorted(lists[0] + lists[1], key=("gpc", "gpc-ns", "coach").index)
    specification = {**first.study.manifest["specification"], "algo": order}
    groups = sorted(
        first.study.groups + second.study.groups, key=lambda group: (group.error, order.index(group.algo))
    )
    study = replace(
        first.study,
        groups=tuple(groups),
        manifest={**first.study.manifest, "specification": specification},
    )
    return Experiment(
        study,
        pd.concat([first.episodes, second.episodes]),
        pd.concat([first.corrections, second.corrections]),
    )


def early(group: Group) -> Scores:
    """Mean return of the first episodes."""
    return Scores(group.seeds, group.returns[:, :EARLY].mean(axis=1))


def scaled(scores: Scores, gap: float) -> Scores:
    """In parts of the gap from idle to oracle."""
    return Scores(scores.seeds, scores.values / gap)


Results = Mapping[str, Experiment]
