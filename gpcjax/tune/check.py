"""Whether what was found teaches better: it and the usual values, on seeds that had no part in the choice."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gpcjax.report.compare import Comparison, compare
from gpcjax.sweep.executors import Executor
from gpcjax.sweep.run import run
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.telling import Watcher

CHECK, USUAL, TUNED = "check", "usual", "tuned"


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
