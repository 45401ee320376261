"""The best points of a grid as files that a sweep takes, with seeds that had no part in the choice."""

import dataclasses
import shlex
from collections.abc import Mapping
from pathlib import Path

from gpcjax.errors import UserError
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.plan import axes_of
from gpcjax.sweep.seeds import LARGEST_SEED, Seeds
from gpcjax.sweep.spec import SweepSpec
from gpcjax.tune import toml
from gpcjax.tune.found import found_in
from gpcjax.tune.objectives import OBJECTIVES
from gpcjax.tune.space import Space, Values

OBJECTIVE = OBJECTIVES["final_return"]
"""What a report of a grid calls the best point by."""


def with_point(spec: SweepSpec, point: Mapping[str, float]) -> SweepSpec:
    """The specification with these hyperparameters."""
    values = {name: (value,) for name, value in point.items()}
    return dataclasses.replace(spec, hyperparameters={**spec.hyperparameters, **values})


def other_seeds(seeds: Seeds) -> Seeds:
    """As many seeds, behind the last of these, or before the first where there is no room."""
    last, count = seeds.spans[-1][1], len(seeds)
    if last + count <= LARGEST_SEED:
        return Seeds(((last + 1, last + count),))
    return Seeds(((max(seeds.spans[0][0] - count, 0), max(seeds.spans[0][0] - 1, 0)),))


def write_best(out: Path, spec: SweepSpec) -> list[Path]:
    """Writes `OUT/best.toml`, or `OUT/best-LEARNER.toml` for each of several, from the rows of a grid.

    Best is the highest final return, the mean over oracles and error rates; a learner that the grid does not concern,
    or that has no rows, has no file. Gives the paths.

    Raises:
        OSError: a file cannot be written.
    """
    written = []
    for algo in spec.algo:
        axes = axes_of(spec, algo)
        space: Space = {name: Values(values) for name, values in axes.items() if len(values) > 1}
        if not space:
            continue
        try:
            found = found_in(out, algo, space, [OBJECTIVE])
        except UserError:  # no row of it is there
            continue
        own = {name: values for name, values in axes.items() if len(values) == 1}
        best = with_point(
            dataclasses.replace(spec, algo=(algo,), hyperparameters=own, seeds=other_seeds(spec.seeds)),
            found.best.point,
        )
        path = out / ("best.toml" if len(spec.algo) == 1 else f"best-{algo.replace(':', '-')}.toml")
        tied = sum(each.tied for each in found.points) - 1
        comments = [
            f"The best of {len(found.points):,} points by the final return on {spec.seeds.words}; {tied:,} others "
            "are tied with it.",
            "These seeds had no part in the choice.",
            f"    {shlex.join(['gpcjax', 'sweep', str(path)])}",
        ]
        write_atomic(path, toml.text_of(best, comments))
        written.append(path)
    return written
