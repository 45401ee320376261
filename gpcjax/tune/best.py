"""The best points of a grid as files that a sweep takes, with seeds that had no part in the choice."""

import dataclasses
import shlex
from collections.abc import Mapping
from pathlib import Path

from gpcjax.errors import UserError
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.growth import requests
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import axes_of
from gpcjax.sweep.seeds import LARGEST_SEED, Seeds
from gpcjax.sweep.spec import SweepSpec, from_dict
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


def other_seeds(seeds: Seeds, count: int) -> Seeds:
    """So many seeds that are none of these: behind the last of them, or the last before where there is no room."""
    ends = [-1, *(end for span in seeds.spans for end in span), LARGEST_SEED + 1]
    gaps = [(first + 1, last - 1) for first, last in zip(ends[::2], ends[1::2], strict=True)]
    if (behind := gaps[-1])[0] + count - 1 <= LARGEST_SEED:
        return Seeds(((behind[0], behind[0] + count - 1),))
    first, last = max(gaps, key=lambda gap: min(gap[1] - gap[0] + 1, count))
    return Seeds(((max(first, last - count + 1), last),))


def write_best(out: Path, spec: SweepSpec | None = None) -> list[Path]:
    """Writes `OUT/best.toml`, or `OUT/best-LEARNER.toml` for each of several, from the rows of a grid.

    Best is the highest final return, the mean over oracles and error rates; a learner that the grid does not concern,
    or that has no rows, has no file. The rows of `spec` alone choose, by default of what the folder was asked for last;
    the seeds of the file are none that the folder has. Gives the paths.

    Raises:
        OSError: a file cannot be written.
    """
    manifest, written = read_manifest(out), []
    spec = spec or from_dict(requests(manifest)[-1]["specification"])
    seeds = other_seeds(from_dict(manifest["specification"]).seeds | spec.seeds, len(spec.seeds))
    for algo in spec.algo:
        axes = axes_of(spec, algo)
        space: Space = {name: Values(values) for name, values in axes.items() if len(values) > 1}
        if not space:
            continue
        try:
            found = found_in(out, algo, space, [OBJECTIVE], spec)
        except UserError:  # no row of it is there
            continue
        own = {name: values for name, values in axes.items() if len(values) == 1}
        best = with_point(
            dataclasses.replace(spec, algo=(algo,), hyperparameters=own, seeds=seeds),
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
