"""One sweep from its specification to a complete store. The parent process loads no jax."""

import importlib.metadata
import json
import os
import platform
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

import gpcjax
from gpcjax.allowed import checked, checked_path
from gpcjax.errors import UserError
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.executors import Executors, Totals
from gpcjax.sweep.options import OPTIONS
from gpcjax.sweep.plan import Cell, default_out, plan, specification_hash, varying
from gpcjax.sweep.runfolder import FORMAT, MANIFEST, check_sweep, make_writable, read_manifest
from gpcjax.sweep.spec import SweepSpec, as_dict, spec_of
from gpcjax.sweep.store import CellRows, Store

FLUSH_SECONDS = 2.0
"""Finished rows wait at most this long in memory."""

_LIBRARIES = ("jax", "jaxlib", "equinox", "numpy", "scipy", "pandas", "pyarrow")


def sweep(out: Any = None, jobs: Any = 1, **settings: Any) -> Path:
    """Runs what is missing of a sweep; gives its run folder, for `load` and `draw_report`.

    Args:
        out: the path of the run folder, or None for `runs/ENV-HASH`.
        jobs: processes at once, a whole number as on the command line.
        **settings: as in TOML: `env`, `algo`, `error`, `seeds`, `episodes`, `oracle`, `delta`, `rate`, hyperparameters.

    Raises:
        UserError: a setting that is not allowed, or a folder that is another sweep's (a ValueError).
    """
    spec = spec_of(**settings)
    folder = default_out(spec) if out is None else checked_path("out", out)
    jobs = checked("jobs", jobs, int, OPTIONS["jobs"].allowed)
    check_sweep(folder, spec)
    make_writable(folder)
    run(spec, folder, jobs)
    return folder


def run(spec: SweepSpec, out: Path, jobs: int) -> None:
    """Runs the cells of `spec` that `out` does not hold yet. Rows are flushed every few seconds, and on Ctrl-C.

    Raises:
        UserError: `out` was begun with other versions of what computes, whose rows would differ in the last bits.
        RuntimeError: a worker failed; what was finished is kept.
    """
    cells, names = plan(spec), varying(spec)
    manifest = read_manifest(out) if (out / MANIFEST).exists() else _new_manifest(spec, names, len(cells))
    store = Store(out, names)
    missing = store.missing(cells)
    if missing or not manifest["complete"]:
        _refuse_other_versions(out, manifest)
        _Sweep(spec, out, manifest, store, missing).run(jobs)


class _Sweep:
    """A sweep while it runs: rows on their way to the store, and the manifest that grows with them."""

    def __init__(
        self, spec: SweepSpec, out: Path, manifest: dict[str, Any], store: Store, missing: list[Cell]
    ):
        self._spec, self._out, self._manifest = spec, out, manifest
        self._store, self._missing = store, missing
        self._earlier = {name: manifest[name] for name in _ACCUMULATED}
        self._began = self._flushed = time.monotonic()
        self._rows: list[CellRows] = []
        self._totals = Totals()
        self._bar = _progress_bar()
        self._task = self._bar.add_task(
            spec.env, total=len(missing) * spec.episodes, cells=f"0/{len(missing)}", speed="compiling"
        )
        self._finished = 0

    def run(self, jobs: int) -> None:
        """Until nothing is missing."""
        executors = Executors(
            self._missing,
            baselines=self._missing_baselines(),
            jobs=jobs,
            on_rows=self._collect,
            on_baseline=self._keep_baseline,
            on_progress=self._show,
        )
        self._manifest["jobs"] = jobs
        self._save(complete=False)
        with self._bar:
            try:
                executors.run()
            finally:
                self._flush()
        self._save(complete=True)

    def _missing_baselines(self) -> list[tuple[str, str]]:
        known = self._manifest["baselines"]
        names = [
            *(["idle"] if known["idle"] is None else []),
            *(n for n in self._spec.oracle if n not in known["oracles"]),
        ]
        return [(self._spec.env, name) for name in names]

    def _collect(self, rows: CellRows) -> None:
        self._rows.append(rows)
        self._finished += 1
        if time.monotonic() - self._flushed > FLUSH_SECONDS:
            self._flush()

    def _flush(self) -> None:
        # Taken first: a Ctrl-C just after the writing must not write them twice.
        rows, self._rows = self._rows, []
        self._store.append(rows)
        self._flushed = time.monotonic()
        self._save(complete=False)

    def _keep_baseline(self, name: str, numbers: dict[str, float]) -> None:
        baselines = self._manifest["baselines"]
        if name == "idle":
            baselines["idle"] = numbers
        else:
            baselines["oracles"][name] = numbers

    def _show(self, totals: Totals) -> None:
        self._totals = totals
        seconds = max(time.monotonic() - self._began, 1e-9)
        self._bar.update(
            self._task,
            completed=totals.episodes,
            cells=f"{self._finished}/{len(self._missing)}",
            speed=f"{totals.env_steps / seconds:,.0f}" if totals.env_steps else "compiling",
        )

    def _save(self, complete: bool) -> None:
        now = {
            "wall_time_s": time.monotonic() - self._began,
            "compile_time_s": self._totals.compile_seconds,
            "env_steps": self._totals.env_steps,
        }
        self._manifest |= {name: self._earlier[name] + value for name, value in now.items()}
        self._manifest["env_steps_per_s"] = self._manifest["env_steps"] / max(
            self._manifest["wall_time_s"], 1e-9
        )
        self._manifest["complete"] = complete
        write_atomic(self._out / MANIFEST, json.dumps(self._manifest, indent=2) + "\n")


def _new_manifest(spec: SweepSpec, names: list[str], cells: int) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "hash": specification_hash(spec),
        "specification": as_dict(spec),
        "varying": names,
        "cells": cells,
        "baselines": {"idle": None, "oracles": {}},
        "versions": _versions(),
        "machine": {
            "platform": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count(),
        },
        "jobs": 0,
        **dict.fromkeys(_ACCUMULATED, 0),
        "env_steps_per_s": 0,
        "complete": False,
    }


_ACCUMULATED = ("wall_time_s", "compile_time_s", "env_steps")
"""Numbers of the manifest that grow when an interrupted sweep goes on. Compile time is the sum over processes."""


def _versions() -> dict[str, str]:
    libraries = {name: importlib.metadata.version(name) for name in _LIBRARIES}
    return {"gpcjax": gpcjax.__version__, "python": platform.python_version(), **libraries}


def _refuse_other_versions(out: Path, manifest: dict[str, Any]) -> None:
    for name, version in _versions().items():
        before = manifest["versions"].get(name)
        if before != version:
            raise UserError(
                f"{out}: it was begun with {name} {before}, this is {version}: give a new folder (--out)"
            )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _progress_bar() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[cells]} cells"),
        TextColumn("{task.fields[speed]} env steps/s"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        refresh_per_second=4,
    )
