"""The stores of a reproduction as claims and figures take them. Loads no jax."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from gpcjax.report.figures.curves import first_rates
from gpcjax.report.groups import FINAL_EPISODES, Group, Study, gather
from gpcjax.report.summary import Summary, summarise
from gpcjax.reproduce.measures import Measure, known, measure, rank_correlations, ratio_of_means, slopes
from gpcjax.sweep import reading
from gpcjax.sweep.layout import tell
from gpcjax.sweep.manifest import is_complete

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

    def runs(self, algo: str, error: float, oracle: str | None = None, delta: float | None = None) -> "Runs":
        """What can be measured of the runs of these settings."""
        return Runs(self, self.group(algo, error, oracle, delta))

    @property
    def only_runs(self) -> "Runs":
        """The same, where all have the same settings."""
        return Runs(self, self.only)

    @cached_property
    def summary(self) -> Summary:
        """Its numbers, for the figures of a sweep's report."""
        return summarise(self.study)

    def rates(self, group: Group) -> Float[np.ndarray, "runs corrections"]:
        """The first learning rates of each run."""
        return first_rates(group, self.corrections)

    def rows(self, group: Group, column: str) -> Float[np.ndarray, "runs episodes"]:
        """A column of the episodes of the runs, where all of the experiment have the same settings.

        nan is where a run has no such episode, or the column no value in it.
        """
        run = np.searchsorted(group.seeds, self.episodes["seed"].to_numpy(np.int64)).clip(max=group.runs - 1)
        episode = self.episodes["episode"].to_numpy(np.int64) - 1
        there = (group.seeds[run] == self.episodes["seed"].to_numpy()) & (episode < group.returns.shape[1])
        table = np.full(group.returns.shape, np.nan)
        table[run[there], episode[there]] = self.episodes[column].to_numpy(np.float64, na_value=np.nan)[there]
        return table


@dataclass(frozen=True, eq=False)
class Runs:
    """One group of runs: what is measured of each. Returns are in the task's unit, rates in units of the action."""

    experiment: Experiment
    group: Group

    @property
    def area(self) -> Measure:
        """Mean return of an episode: the area under the learning curve."""
        return measure(self.group.area)

    @property
    def final(self) -> Measure:
        """Mean return of the last episodes."""
        return measure(self.group.final)

    @property
    def closed(self) -> Measure:
        """The final return above that of the idle policy, in parts of the gap to the oracle."""
        return (self.final - self.experiment.study.idle.mean) / self.experiment.gap

    @property
    def early(self) -> Measure:
        """Mean return of the first episodes: a level."""
        return known(self.group.seeds, self.group.returns[:, :EARLY].mean(axis=1))

    @property
    def steepness(self) -> Measure:
        """Slope of the line of least squares through the returns of the first episodes, an episode."""
        return known(self.group.seeds, slopes(self.group.returns[:, :EARLY]))

    @property
    def corrections(self) -> Measure:
        """Corrections in all episodes together."""
        return measure(self.group.corrections_used)

    def rate(self, first: int, last: int) -> Measure:
        """Mean learning rate of corrections `first` to `last`, from 1; of runs that have so many."""
        return known(self.group.seeds, self.experiment.rates(self.group)[:, first - 1 : last].mean(axis=1))

    # What follows reads columns of the episodes, of an experiment whose runs all have the same settings.

    @property
    def feedback(self) -> Measure:
        """Corrections a step, over all steps of a run."""
        return known(self.group.seeds, _ratio(self._total("corrections"), self._total("length")))

    @property
    def mean_rate(self) -> Measure:
        """Mean learning rate over all corrections of a run."""
        rates, counts = self._rates()
        return known(self.group.seeds, _ratio(rates.sum(axis=1), counts.sum(axis=1)))

    @property
    def pooled_rate(self) -> Measure:
        """Mean learning rate over the corrections of all runs together, as what each run adds to it."""
        rates, counts = self._rates()
        sums = (known(self.group.seeds, each.sum(axis=1)) for each in (rates, counts))
        return ratio_of_means(*sums)

    @property
    def late_rate(self) -> Measure:
        """Mean learning rate over the corrections of a run's last episodes; of runs that are corrected there."""
        rates, counts = (each[:, -FINAL_EPISODES:].sum(axis=1) for each in self._rates())
        return known(self.group.seeds, _ratio(rates, counts))

    @property
    def chance_with_rate(self) -> Measure:
        """Rank correlation, over the episodes of a run, of the chance of advice with the mean learning rate."""
        columns = (self.experiment.rows(self.group, name) for name in ("chance", "mean_rate"))
        return known(self.group.seeds, rank_correlations(*columns))

    def _total(self, column: str) -> Float[np.ndarray, " runs"]:
        return np.nansum(self.experiment.rows(self.group, column), axis=1)

    def _rates(self) -> tuple[Float[np.ndarray, "runs episodes"], Float[np.ndarray, "runs episodes"]]:
        """Sums of the learning rates of an episode's corrections, and their number; 0 after a run has stopped."""
        counts = np.nan_to_num(self.experiment.rows(self.group, "corrections"))
        return np.nan_to_num(self.experiment.rows(self.group, "mean_rate")) * counts, counts


def _ratio(top: Float[np.ndarray, " runs"], bottom: Float[np.ndarray, " runs"]) -> Float[np.ndarray, " runs"]:
    return np.divide(top, bottom, out=np.full(len(top), np.nan), where=bottom > 0)


def read(out: Path) -> Experiment | None:
    """The experiment in a run folder; None where it is missing or not complete."""
    if not is_complete(out):
        return None
    rows = reading.read(out, tell)
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


Results = Mapping[str, Experiment]
