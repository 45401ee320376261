"""Whether what was found teaches better: it and the usual values, on seeds that had no part in the choice."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.report import words
from gpcjax.report.compare import Comparison, compared, folder_names
from gpcjax.report.compare_match import opened
from gpcjax.report.statistics import paired_difference
from gpcjax.sweep.executors import Executor
from gpcjax.sweep.layout import tell
from gpcjax.sweep.manifest import read_manifest
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

    Rows go to `OUT/check/usual` and `OUT/check/tuned`, the comparison beside them. What an earlier check has left
    there, of another best or other seeds, stays, and has no part in the comparison.
    """
    if usual == tuned:
        return None
    specs = {
        out / CHECK / name: dataclasses.replace(spec, seeds=seeds)
        for name, spec in ((TUNED, tuned), (USUAL, usual))
    }
    for folder, spec in specs.items():
        folder.mkdir(parents=True, exist_ok=True)
        run(spec, folder, executor.jobs, executor, watcher=watcher)
    names = folder_names([*specs])
    read = [opened(path, name, tell, spec) for (path, spec), name in zip(specs.items(), names, strict=True)]
    comparison = compared(read, differing(usual, tuned))
    comparison.save(out / CHECK)
    return comparison


def is_all(comparison: Comparison) -> bool:
    """Whether the folders hold what was compared and no more, so that `gpcjax compare` says the same of them."""
    return all(read_manifest(folder.path)["hash"] == folder.hash for folder in comparison.folders)


def differing(usual: SweepSpec, tuned: SweepSpec) -> list[str]:
    """Settings that have other values in the one than in the other."""
    mine, its = (_settings(spec) for spec in (tuned, usual))
    return [name for name in {**mine, **its} if mine.get(name) != its.get(name)]


def _settings(spec: SweepSpec) -> dict[str, Any]:
    fields = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec)}
    given = fields.pop("hyperparameters")
    return {**fields, **given}


def of_objectives(objectives: Sequence[Objective], comparison: Comparison) -> list[str]:
    """A sentence for each objective that is none of a comparison's own statistics, of the runs of `checked_on`."""
    told = []
    studies = [folder.study for folder in comparison.folders]
    for objective in objectives:
        if objective.name in STATISTICS:
            continue
        each = [run_scores(study.groups, study, objective) for study in studies]
        tuned, usual = map(objective.of, each)
        places = words.places([tuned, usual])
        numbers = f"{words.number(tuned, places)} tuned, {words.number(usual, places)} usual"
        if all(np.isfinite(scores.values).all() for scores in each):
            difference, _ = paired_difference(*each)
            numbers += f"; tuned minus usual {words.interval(difference, places)}"
        told.append(f"{objective.name.replace('_', ' ')} on the same seeds: {numbers}")
    return told
