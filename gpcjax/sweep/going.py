"""A sweep while it runs: rows on their way to the store, and the manifest that grows with them. Loads no jax."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gpcjax.envs.registry import NOBODY
from gpcjax.sweep import experience, stopping
from gpcjax.sweep.blocks import Block
from gpcjax.sweep.checkpoints import Places, remove, remove_all
from gpcjax.sweep.environment import cache_folder
from gpcjax.sweep.executors import Desk, Orders, Totals
from gpcjax.sweep.layout import tell
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.notebook import usual_watcher
from gpcjax.sweep.opening import ACCUMULATED
from gpcjax.sweep.origin import forget_idle_machines, note_machine
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.rows import CellRows
from gpcjax.sweep.sofar import SoFar
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.store import Store
from gpcjax.sweep.telling import State, Watcher

FLUSH_SECONDS = 2.0
"""Finished rows wait at most this long in memory."""


class Going:
    """The sweep of one run folder, from its first cell to its last row.

    Args:
        spec: what is asked for.
        out: the run folder.
        manifest: of the folder; what becomes of the sweep is written into it.
        store: of the folder.
        missing: the cells that are to run.
        jobs: workers there may be.
        orders: what these do beside.
        places: where runs can go on.
        watcher: shows how far it is; None for the usual one.
    """

    def __init__(
        self,
        spec: SweepSpec,
        out: Path,
        manifest: dict[str, Any],
        store: Store,
        missing: list[Cell],
        jobs: int,
        orders: Orders,
        places: Places,
        watcher: Callable[..., Watcher] | None,
    ):
        self._spec, self._out, self._manifest = spec, out, manifest
        self._store, self._missing = store, missing
        self._earlier = {name: manifest[name] for name in ACCUMULATED}
        self._began = self._flushed = time.monotonic()
        self._rows: list[CellRows | Block] = []
        self._totals = Totals()
        self._finished, self._jobs, self._over = 0, jobs, False
        self._sofar = SoFar(missing, manifest["varying"])
        self.desk = Desk(
            missing,
            baselines=[(spec.env, name) for name in missing_baselines(manifest, spec)],
            jobs=jobs,
            on_rows=self._collect,
            on_baseline=self._keep_baseline,
            on_progress=self._show,
            on_note=tell,
            orders=orders,
            before=lambda programs: experience.of(programs, cache_folder()),
            starts=experience.start_of(cache_folder()),
            on_machine=lambda described: note_machine(out, manifest, described),
            on_over=self._forget_checkpoint,
            places=places,
        )
        works = tuple(self.desk.works.values())
        self._bar = (watcher or usual_watcher())(spec.env, len(missing), self.desk.workers, works=works)

    @contextmanager
    def under_way(self) -> Iterator[None]:
        """While workers are at its desk. Signals are deferred; what came is kept, however this ends."""
        self._manifest["jobs"] = self._jobs
        self._save(complete=False)
        with stopping.deferred(), self._bar:
            try:
                yield
            finally:
                if not self._over:
                    self._keep()

    def begin(self) -> None:
        """Workers turn to it only now: what was before is none of its time."""
        self._began = time.monotonic()

    def finish(self) -> None:
        """All has come.

        Raises:
            Failure: it has not.
        """
        self.desk.refuse_less()
        self._keep()
        self._over = True
        forget_idle_machines(self._manifest, self._store.machines)
        # What was asked for before may have been interrupted, and is not asked for now.
        self._save(complete=self._store.cells >= self._manifest["cells"])
        if self._manifest["complete"]:
            remove_all(self._out)

    def _keep(self) -> None:
        """What came, and what it took."""
        self._flush()
        took = {program: work.took for program, work in self.desk.works.items()}
        known = {program: cost for program, cost in took.items() if cost is not None}
        experience.learn(known, cache_folder(), self.desk.started)

    def _collect(self, rows: CellRows | Block) -> None:
        self._rows.append(rows)
        for run in rows.runs:
            self._finished += 1
            self._sofar.add(run)
        if time.monotonic() - self._flushed > FLUSH_SECONDS:
            self._flush()

    def _flush(self) -> None:
        # Taken first: a Ctrl-C just after the writing must not write them twice.
        rows, self._rows = self._rows, []
        self._store.append(rows)
        self._flushed = time.monotonic()
        self._save(complete=False)

    def _forget_checkpoint(self, name: str) -> None:
        self._flush()  # until then it is all that there is of these runs
        remove(self._out, name)

    def _keep_baseline(self, name: str, numbers: dict[str, float]) -> None:
        baselines = self._manifest["baselines"]
        if name == "idle":
            baselines["idle"] = numbers
        else:
            baselines["oracles"][name] = numbers

    def _show(self, totals: Totals) -> None:
        self._totals = totals
        self._bar.show(State(self._finished, totals.env_steps, totals.works, totals.compiling, self._sofar))

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
        self._manifest |= {"complete": complete, "finished": self._store.cells}
        write_manifest(self._out, self._manifest)


def missing_baselines(manifest: Mapping[str, Any], spec: SweepSpec) -> list[str]:
    """The idle policy and the experts of which a manifest has no returns yet."""
    known = manifest["baselines"]
    return [
        *(["idle"] if known["idle"] is None else []),
        *(name for name in spec.oracle if name not in known["oracles"] and name != NOBODY),
    ]
