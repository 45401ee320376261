"""Whether what was found teaches better: it and the usual values, on seeds that had no part in the choice."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.report import words
from gpcjax.report.compare import Comparison, compare
from gpcjax.report.groups import gather
from gpcjax.report.statistics import Scores, paired_difference
from gpcjax.sweep.executors import Executor
from gpcjax.sweep.reading import read
from gpcjax.sweep.run import run
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.telling import Watcher
from gpcjax.tune.objectives import Objective, run_scores

CHECK, USUAL, TUNED = "check", "usual", "tuned"

STATISTICS = ("area", "final_return")
"""Of which a comparison tells."""


def checked_on(
    usual: SweepSpec,
    tuned: SweepSpec,
    seeds: Seeds,
    out: Path,
    executor: Executor,
    watcher: Callable[..., Watcher] | None = None,
) -> Comparison | None:
    """Both specifications on these seeds, compared run by run; None where both are the same.

    Rows go to `OUT/check/usual` and `OUT/check/tuned`, the comparison beside them.
    """
    if usual == tuned:
        return None
    folders = {TUNED: tuned, USUAL: usual}
    for name, spec in folders.items():
        folder = out / CHECK / name
        folder.mkdir(parents=True, exist_ok=True)
        run(dataclasses.replace(spec, seeds=seeds), folder, executor.jobs, executor, watcher=watcher)
    comparison = compare(*(out / CHECK / name for name in folders), by=differing(usual, tuned))
    comparison.save(out / CHECK)
    return comparison


def differing(usual: SweepSpec, tuned: SweepSpec) -> list[str]:
    """Settings that have other values in the one than in the other."""
    mine, its = (_settings(spec) for spec in (tuned, usual))
    return [name for name in {**mine, **its} if mine.get(name) != its.get(name)]


def _settings(spec: SweepSpec) -> dict[str, Any]:
    fields = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec)}
    given = fields.pop("hyperparameters")
    return {**fields, **given}


def of_objectives(objectives: Sequence[Objective], out: Path) -> list[str]:
    """A sentence for each objective that is none of a comparison's own statistics, of the folders of `checked_on`.

    Raises:
        UserError: a folder cannot be read.
    """
    told = []
    for objective in objectives:
        if objective.name in STATISTICS:
            continue
        scores = {name: _scores(out / CHECK / name, objective) for name in (TUNED, USUAL)}
        tuned, usual = (objective.of(each) for each in scores.values())
        places = words.places([tuned, usual])
        numbers = f"{words.number(tuned, places)} tuned, {words.number(usual, places)} usual"
        if all(np.isfinite(each.values).all() for each in scores.values()):
            difference, _ = paired_difference(scores[TUNED], scores[USUAL])
            numbers += f"; tuned minus usual {words.interval(difference, places)}"
        told.append(f"{objective.name.replace('_', ' ')} on the same seeds: {numbers}")
    return told


def _scores(folder: Path, objective: Objective) -> Scores:
    """Of the one point of a folder, for each seed."""
    rows = read(folder, lambda line: None)
    study = gather(rows.episodes, rows.manifest)
    return run_scores(study.groups, study, objective)
