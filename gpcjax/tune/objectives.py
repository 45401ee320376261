"""What a search looks for, by name: a number for each run, and one for each point. Loads no jax."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gpcjax.report.groups import Group, Study
from gpcjax.report.statistics import Scores
from gpcjax.tune import names


@dataclass(frozen=True)
class Objective:
    """What is to be large, or small. Runs that stopped count as the idle policy from there on (`Group`)."""

    name: str
    larger: bool
    """Whether more of it is better."""
    of_runs: Callable[[Group, Study], Scores]
    median: bool = False
    """Whether a point has the median of its runs, of which some may be infinite, and not their mean."""

    @property
    def text(self) -> str:
        """What it is."""
        return names.OBJECTIVES[self.name]

    def of(self, scores: Scores) -> float:
        """The number of a point; nan without a run."""
        if not scores.values.size:
            return np.nan
        return float(np.median(scores.values) if self.median else scores.values.mean())


def corrections_until_closed(group: Group, study: Study) -> Scores:
    """Corrections of each run up to and with the first episode that closes the gap to the oracle; inf for never."""
    episode = group.closed_after(study.idle, study.oracle(group.oracle)).values
    used = group.corrections.cumsum(axis=1)
    reached = np.isfinite(episode)
    index = np.where(reached, episode, 1).astype(int) - 1
    return Scores(group.seeds, np.where(reached, used[np.arange(len(used)), index], np.inf))


OBJECTIVES = {
    "area": Objective("area", True, lambda group, study: group.area),
    "final_return": Objective("final_return", True, lambda group, study: group.final),
    "corrections": Objective("corrections", False, lambda group, study: group.corrections_used),
    "corrections_to_90": Objective("corrections_to_90", False, corrections_until_closed, median=True),
}


Key = tuple[float | None, ...]
"""The values of the settings that are searched; None for one that does not vary in a folder."""


def by_point(study: Study, names: Sequence[str]) -> dict[Key, tuple[Group, ...]]:
    """The groups of each point of these settings: one for each oracle, error rate, delta and chance of advice."""
    found: dict[Key, tuple[Group, ...]] = {}
    for group in study.groups:
        key = tuple(group.point.get(name) for name in names)
        found[key] = (*found.get(key, ()), group)
    return found


def key_of(point: Mapping[str, float], study: Study) -> Key:
    """The key of a point in a study."""
    return tuple(value if name in study.varying else None for name, value in point.items())


def run_scores(groups: Sequence[Group], study: Study, objective: Objective) -> Scores:
    """A number for each seed, the mean over the oracles and error rates; of the seeds that all of these have."""
    each = [objective.of_runs(group, study) for group in groups]
    seeds = each[0].seeds
    for scores in each[1:]:
        seeds = np.intersect1d(seeds, scores.seeds)
    values = [scores.values[np.searchsorted(scores.seeds, seeds)] for scores in each]
    return Scores(seeds, np.mean(values, axis=0))


def point_scores(groups: Sequence[Group], study: Study, objectives: Sequence[Objective]) -> tuple[float, ...]:
    """The number of a point for each objective, the mean over the oracles and error rates."""
    return tuple(
        float(np.mean([objective.of(objective.of_runs(group, study)) for group in groups]))
        for objective in objectives
    )
