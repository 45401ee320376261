"""The runs of a study as run folders, which `gpcjax.load` and `gpcjax compare` read. Loads no jax."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from gpcjax.study.design import Treatment
from gpcjax.study.report.held import Held, RunRows
from gpcjax.sweep.layout import CORRECTIONS, EPISODES
from gpcjax.sweep.machine import kind_of
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.opening import new_manifest
from gpcjax.sweep.plan import varying
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.store import Store

ROWS = "rows"

Group = tuple[str, str, Treatment]
"""Phase, task, and who is taught in which arm."""


def write_stores(held: Held, analysis: Path) -> dict[str, int]:
    """Writes a run folder for each learner, task and phase; gives its number of runs, by its path in `analysis`.

    Raises:
        OSError: something cannot be written.
    """
    groups: dict[Group, list[RunRows]] = {}
    for run in held.runs:
        groups.setdefault((run.step.phase, run.step.task, run.step.treatment), []).append(run)
    names = _names(held, groups)
    for group, runs in groups.items():
        _write(held, analysis / names[group], group, runs)
    return {names[group]: len(runs) for group, runs in groups.items()}


def versions_differ(held: Held) -> bool:
    """Whether runs were taught with different versions."""
    return len({str(run.manifest["versions"]) for run in held.runs}) > 1


def _names(held: Held, groups: Mapping[Group, Sequence[RunRows]]) -> dict[Group, str]:
    found: dict[Group, str] = {}
    for phase, task, treatment in groups:
        parts = [task, treatment.learner, *([treatment.arm] if len(held.study.arms) > 1 else [])]
        stem = f"{ROWS}/{phase}/" + re.sub(r"[^A-Za-z0-9_.]+", "-", "-".join(parts)).strip("-.")
        name, count = stem, 1
        while name in found.values():
            count += 1
            name = f"{stem}-{count}"
        found[phase, task, treatment] = name
    return found


def _write(held: Held, folder: Path, group: Group, runs: Sequence[RunRows]) -> None:
    _, task, treatment = group
    course = held.study.course(treatment, task, runs[0].seed)
    spec = dataclasses.replace(
        course.spec(held.study.runs.episodes[task]), seeds=Seeds.of([run.seed for run in runs])
    )
    last = runs[-1].manifest
    machines = {kind_of(run.manifest["machine"]): run.manifest["machine"] for run in runs}
    first, *further = machines.values()
    manifest = new_manifest(spec, varying(spec), len(runs)) | {
        "baselines": {"idle": None, "oracles": dict.fromkeys(spec.oracle)},
        "versions": last["versions"],
        "machine": first,
        "env_steps": sum(int(run.episodes.column("length").to_numpy().sum()) for run in runs),
        "jobs": 1,
        "complete": True,
    }
    if further:
        manifest["further_machines"] = further
    folder.mkdir(parents=True)
    store = Store(folder, manifest, kind_of(first))
    for machine in dict.fromkeys(run.machine for run in runs):
        mine = [run for run in runs if run.machine == machine]
        tables = {EPISODES: [run.episodes for run in mine], CORRECTIONS: [run.corrections for run in mine]}
        store.put(
            {name: pa.concat_tables(of, promote_options="permissive") for name, of in tables.items()}, machine
        )
    write_manifest(folder, manifest)
