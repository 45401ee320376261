"""What a search has found: every point with its scores, the best one, those tied with it, the Pareto front."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gpcjax.errors import UserError
from gpcjax.report.groups import gather
from gpcjax.report.statistics import Scores, best_and_tied
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.points import given as points_given
from gpcjax.sweep.requested import chosen_of
from gpcjax.sweep.spec import SweepSpec
from gpcjax.tune.objectives import Objective, by_point, point_scores, run_scores
from gpcjax.tune.ranking import front, ranked
from gpcjax.tune.space import Space, at_edge


@dataclass(frozen=True)
class Looked:
    """A point that was looked at on all seeds."""

    point: dict[str, float]
    scores: tuple[float, ...]
    """One for each objective."""
    runs: int
    """Seeds."""
    tied: bool
    """Whether it is not significantly worse than the best one in the first objective, seed by seed."""
    on_front: bool
    """Whether no other point is better in one objective and nowhere worse."""


@dataclass(frozen=True)
class Found:
    """All points, the best first, and where they were looked for."""

    env: str
    algo: str
    space: Space
    objectives: tuple[Objective, ...]
    points: tuple[Looked, ...]

    @property
    def best(self) -> Looked:
        """The best in the one objective; of several the one with the smallest sum of ranks on the front."""
        return self.points[0]

    @property
    def edges(self) -> list[str]:
        """Settings of the best point that lie at an end of their range."""
        return at_edge(self.space, self.best.point)

    def table(self) -> pd.DataFrame:
        """A row for each point: its settings, `runs`, a column for each objective, `tied` and `front`."""
        return pd.DataFrame(
            {
                **each.point,
                "runs": each.runs,
                **dict(zip((objective.name for objective in self.objectives), each.scores, strict=True)),
                "tied": each.tied,
                "front": each.on_front,
            }
            for each in self.points
        )


def found_in(
    folder: Path, algo: str, space: Space, objectives: Sequence[Objective], spec: SweepSpec | None = None
) -> Found:
    """What the rows of a run folder say of one of its learners; with a `spec` the rows of that alone.

    Raises:
        UserError: there are no rows of it, or no point has a score.
    """
    episodes, manifest = read_counted(folder, lambda line: None)
    if spec is not None and episodes is not None:
        episodes, manifest = chosen_of(episodes, manifest, spec)
    if episodes is not None:
        codes, values = episodes.settings["algo"]
        episodes = episodes.of_cells(np.array([each == algo for each in values], bool)[codes])
    if episodes is None or not len(episodes.seeds):
        raise UserError(f"{folder}: it holds no rows of {algo}")
    study = gather(episodes, manifest)
    names, fixed = list(space), _fixed(space, manifest)
    keys = by_point(study, names)
    each = [run_scores(groups, study, objectives[0]) for groups in keys.values()]
    scores = [point_scores(groups, study, objectives) for groups in keys.values()]
    if not any(np.isfinite(score).all() for score in scores):
        raise UserError(
            f"{folder}: no point has a number for {', '.join(objective.name for objective in objectives)}: "
            "give more episodes, other ranges or another objective"
        )
    larger = [objective.larger for objective in objectives]
    order, nobody_better = ranked(scores, larger), set(front(scores, larger))
    tied = _tied(each, order[0], objectives[0])
    points = tuple(
        Looked(
            {**fixed, **{name: value for name, value in zip(names, key, strict=True) if value is not None}},
            scores[place],
            len(each[place].values),
            tied[place],
            place in nobody_better,
        )
        for place, key in ((place, list(keys)[place]) for place in order)
    )
    return Found(study.env, algo, space, tuple(objectives), points)


def _fixed(space: Space, manifest: Mapping[str, Any]) -> dict[str, float]:
    """The settings that have one value in all rows, which is no column: as the manifest says."""
    given = points_given(manifest["specification"])
    return {name: float(given[name][0]) for name in space if name not in manifest["varying"]}


def _tied(each: Sequence[Scores], best: int, objective: Objective) -> list[bool]:
    """Which points are not significantly worse than the best, over the seeds that both have."""
    signed = [
        scores._replace(values=scores.values if objective.larger else -scores.values) for scores in each
    ]
    # Of infinite scores there is no difference: the worst finite one stands for them.
    finite = np.concatenate([scores.values[np.isfinite(scores.values)] for scores in signed])
    worst = finite.min() if finite.size else 0.0
    signed = [
        scores._replace(values=np.where(np.isfinite(scores.values), scores.values, worst))
        for scores in signed
    ]
    others = [place for place in range(len(signed)) if place != best]
    which, tied = best_and_tied([signed[best], *(signed[place] for place in others)])
    if which != 0:  # by its mean another is better: the best by median, or one of a front
        return [place == best for place in range(len(each))]
    found = dict(zip([best, *others], tied.tolist(), strict=True))
    return [found[place] for place in range(len(each))]
