"""One sweep from its specification to a complete store. The parent process loads no jax.

Over 300 lines: a third of them make and mend the manifest, which belongs to the order in which a sweep begins.
"""

import threading
import time
from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import Any

from gpcjax.allowed import checked, checked_path
from gpcjax.envs.registry import NOBODY
from gpcjax.errors import UserError
from gpcjax.sweep import experience, machine, stopping
from gpcjax.sweep.blocks import Block
from gpcjax.sweep.checkpoints import remove, remove_all, survey, told
from gpcjax.sweep.environment import cache_folder
from gpcjax.sweep.executors import Desk, Executor, Orders, Processes, Totals, executor_of
from gpcjax.sweep.fitting import left_out
from gpcjax.sweep.growth import covering, grown, requests
from gpcjax.sweep.keepable import check_keeping, check_kept, refuse_other
from gpcjax.sweep.keeping import ENTRY, Keeping, as_json, keeping_of
from gpcjax.sweep.labels import labels_of
from gpcjax.sweep.layout import CHECKPOINTS, DAMAGED, FORMAT, MANIFEST, tell
from gpcjax.sweep.lock import held
from gpcjax.sweep.manifest import DamagedManifest, read_manifest, write_manifest
from gpcjax.sweep.notebook import usual_watcher
from gpcjax.sweep.options import OPTIONS
from gpcjax.sweep.parts import origins_of, refuse_measured
from gpcjax.sweep.plan import Cell, count, default_out, hash_of, plan, specification_hash, varying
from gpcjax.sweep.rows import CellRows
from gpcjax.sweep.runfolder import check_sweep, make_writable, own_parts, set_aside
from gpcjax.sweep.sealing import Origin
from gpcjax.sweep.shards import Shard, check_shard, shard_of, share_of
from gpcjax.sweep.siblings import asked_with
from gpcjax.sweep.sofar import SoFar
from gpcjax.sweep.spec import SweepSpec, as_dict, from_dict, spec_of
from gpcjax.sweep.store import Store
from gpcjax.sweep.telling import State, Watcher
from gpcjax.sweep.versions import versions

FLUSH_SECONDS = 2.0
"""Finished rows wait at most this long in memory."""

UNKNOWN = "unknown, the manifest that said it was lost"
"""The machine of rows that this one has not computed: they tell of which kind it was, not which."""


def sweep(
    out: Any = None,
    jobs: Any = 1,
    executor: Any = None,
    keep: Any = None,
    keep_at: Any = "last",
    checkpoint: Any = OPTIONS["checkpoint"].default,
    engine: Any = None,
    address: Any = None,
    shard: Any = None,
    **settings: Any,
) -> Path:
    """Runs what is missing of a sweep; gives its run folder, for `load` and `draw_report`.

    Args:
        out: the path of the run folder, or None for `runs/ENV-HASH`.
        jobs: processes at once, a whole number as on the command line.
        executor: what runs the workers, in the place of so many processes (`gpcjax.sweep.executors`).
        keep: "policies" or "states" (from which teaching goes on) of each run, for `load_policies` and `load_states`.
        keep_at: after which episode: "last", "best", or n for every n-th.
        checkpoint: seconds after which runs that are under way are saved, 0 for never.
        engine: "processes" or "ray", in the place of an executor; "ray" has a job for each core where `jobs` is 1.
        address: of the Ray cluster, see `gpcjax.sweep.executors.Ray`.
        shard: "i/n" for the i-th of n shares alone, whose folder is `OUT/shards/i-of-n`.
        **settings: as in TOML: `env`, `algo`, `error`, `seeds`, `episodes`, `oracle`, `delta`, `rate`, hyperparameters;
            `start`, a run folder with kept states or a saved learner, with which the runs begin.

    Raises:
        UserError: a setting that is not allowed, or a folder that is another sweep's or that another process is
            writing to (a ValueError).
    """
    spec = spec_of(**settings)
    folder = default_out(spec) if out is None else checked_path("out", out)
    jobs = checked("jobs", jobs, int, OPTIONS["jobs"].allowed)
    if not isinstance(executor, Executor | None):
        raise UserError(f"executor {executor!r}: give an object with `jobs` and `run(desk)`, as InProcess()")
    if executor is not None and jobs != 1:
        raise UserError(f"jobs {jobs}: an executor has a number of its own, give one of the two")
    if executor is not None and engine is not None:
        raise UserError("engine: beside an executor it changes nothing, give one of the two")
    executor = executor or executor_of(engine, address, None if jobs == 1 else jobs)
    share = None if shard is None else shard_of(shard, "shard")
    keeping = keeping_of(keep, keep_at)
    check_keeping(keeping, spec)
    seconds = checked("checkpoint", checkpoint, float, OPTIONS["checkpoint"].allowed)
    folder = folder if share is None else share.folder(folder)
    check_sweep(folder, spec)
    check_shard(folder, share, count(spec))
    check_kept(folder, keeping, spec)
    _check_start(spec)
    make_writable(folder)
    for line in left_out(spec.env) if "algo" not in settings else ():
        tell(line)
    run(spec, folder, jobs, executor, keeping=keeping, checkpoint=seconds, shard=share)
    return folder


def _check_start(spec: SweepSpec) -> None:
    if spec.start is not None:
        from gpcjax.sweep.sources import check_start  # which reads run folders

        check_start(spec)


def run(
    spec: SweepSpec,
    out: Path,
    jobs: int,
    executor: Executor | None = None,
    grows: bool = True,
    keeping: Keeping | None = None,
    checkpoint: float = OPTIONS["checkpoint"].default,
    watcher: Callable[..., Watcher] | None = None,
    meanwhile: Callable[[], None] = lambda: None,
    shard: Shard | None = None,
    say: Callable[[str], None] = tell,
) -> bool:
    """Runs the cells of `spec` that `out` does not hold yet. Rows are flushed every few seconds, and on Ctrl-C.

    With a `shard`, of these the cells of that share, into its own folder.

    Gives whether there was anything to do. `meanwhile` is called in a thread of its own once the workers are busy;
    `say` takes a line for the person where the folder grows.

    A folder that holds less than `spec` asks for `grows`, or is refused. Of each run that is kept what `keeping` says;
    runs that are under way are saved every `checkpoint` seconds, and go on from there after a kill.

    Nobody else can write to `out` meanwhile. What is damaged there is set aside with a line on stderr, and computed
    again: the manifest too, if the parts say that they are of this sweep.

    Raises:
        UserError: `out` holds something else, another process writes there, or it was begun with other versions of
            what computes, whose rows would differ in the last bits.
        Failure: a worker failed; what was finished is kept.
    """
    with held(out):
        check_sweep(out, spec, grows)  # again: somebody may have been faster
        cells = plan(spec)
        check_shard(out, shard, len(cells))
        check_kept(out, keeping, spec)
        begun = (out / MANIFEST).exists()
        manifest, request = _asked(_manifest(spec, out, keeping, shard), spec, out, shard, say)
        if shard is not None:
            share = set(share_of(manifest, shard))
            if not begun:  # what the other shards were asked for before is asked for, too
                asked = [from_dict(each["specification"]) for each in requests(manifest)]
                cells = [*dict.fromkeys(cell for each in asked for cell in plan(each))]
            cells = [cell for cell in cells if cell in share]
            manifest |= {"shard": shard.as_json(), "cells": len(share)}
        here = machine.describe()
        store = Store(out, manifest, machine.kind_of(here), request=request)
        missing = store.missing(cells)
        if keeping is not None and ENTRY not in manifest and store.cells:
            say(
                f"{out}: its manifest does not say what of its runs is kept: those that are there stay as they are"
            )
        if missing or not manifest["complete"]:
            refuse_other(out, manifest, keeping)
            _refuse_other_versions(out, manifest)
            _note_machine(out, manifest, here)
            agree = told(manifest["versions"], machine.kind_of(here), keeping)
            orders = Orders(
                keeping=keeping,
                checkpoints=str((out / CHECKPOINTS).absolute()),
                seconds=checkpoint,
                agree=agree,
                varying=tuple(manifest["varying"]),
                places=survey(out, lambda cell: not store.holds(cell), agree, tell),
            )
            sweep = _Sweep(spec, out, manifest, store, missing, executor or Processes(jobs), orders, watcher)
            threading.Thread(target=meanwhile, daemon=True).start()
            sweep.run()
            return True
        remove_all(out)  # of a run that was killed when all was there
        return False


def _asked(
    manifest: dict[str, Any], spec: SweepSpec, out: Path, shard: Shard | None, say: Callable[[str], None]
) -> tuple[dict[str, Any], str]:
    """The manifest of a folder that is asked for `spec`, perhaps beside what it was asked before; and the hash of that.

    Nothing is written yet.
    """
    request = covering(manifest, spec)
    if request is not None:
        return manifest, request
    larger = grown(manifest, spec)
    refuse_measured(out, manifest, {*larger["varying"]} - {*manifest["varying"]})
    if shard is not None:
        larger["cells"] = len(share_of(larger, shard))
    new = larger["cells"] - manifest["cells"]
    say(f"{out}: it grows by {new:,} to {larger['cells']:,} cells")
    return larger, specification_hash(spec)


def _manifest(spec: SweepSpec, out: Path, keeping: Keeping | None, shard: Shard | None) -> dict[str, Any]:
    """The manifest of `out`; a new one where there is none, or none that is whole."""
    try:
        if (out / MANIFEST).exists():
            return read_manifest(out)
        what = "is missing"
    except DamagedManifest:
        set_aside(out, out / MANIFEST)
        what = f"was damaged and lies in {out / DAMAGED} now"
    if own_parts(out, specification_hash(spec)):
        # Its parts may be all that there is to compute, and of other versions or another machine than these.
        manifest, origins = _recovered(spec, origins_of(out))
        manifest["versions"] = origins[0].versions if origins else manifest["versions"]
        manifest["recovered"] = True
        if {origin.machine for origin in origins} - {machine.kind_of(manifest["machine"])}:
            manifest["machine"] = {"processor": UNKNOWN}
        tell(f"{out / MANIFEST} {what}: made anew from the parts, its times count from now on")
        return manifest
    specs = [spec] if shard is None else asked_with(out, shard, spec)
    if len(specs) > 1:
        tell(f"{out}: the other shards were asked for other things before: it has its share of these, too")
    return _asked_for(specs) | {ENTRY: as_json(keeping)}


def _recovered(spec: SweepSpec, origins: list[Origin]) -> tuple[dict[str, Any], list[Origin]]:
    """The manifest with all that its folder was asked for, as far as parts tell, and the origins that are of it.

    A part lists what had been asked when it was written: so all that names a known specification is known too. Each
    of these is asked for again, even what a later one covers: parts are named after it, and shares follow the order.
    """
    known, mine = {specification_hash(spec): spec}, list[Origin]()
    while True:
        mine = [each for each in origins if known.keys() & {each.hash, *map(hash_of, each.asked)}]
        named = {hash_of(one): one for each in mine for one in each.asked}
        if not named.keys() - known.keys():
            break
        known |= {hash_: from_dict(one) for hash_, one in named.items() if hash_ not in known}
    longest_first = sorted(mine, key=lambda each: len(each.asked), reverse=True)
    order = dict.fromkeys(hash_of(one) for each in longest_first for one in each.asked)
    return _asked_for([known[hash_] for hash_ in {**order, **known}]), [
        each for each in mine if each.hash in known
    ]


def _asked_for(specs: Sequence[SweepSpec]) -> dict[str, Any]:
    """The manifest of a folder that is asked for these, one after the other."""
    first, *further = specs
    manifest = new_manifest(first, varying(first), count(first))
    for each in further:
        manifest = grown(manifest, each)
    return manifest


class _Sweep:
    """A sweep while it runs: rows on their way to the store, and the manifest that grows with them."""

    def __init__(
        self,
        spec: SweepSpec,
        out: Path,
        manifest: dict[str, Any],
        store: Store,
        missing: list[Cell],
        executor: Executor,
        orders: Orders,
        watcher: Callable[..., Watcher] | None,
    ):
        self._spec, self._out, self._manifest = spec, out, manifest
        self._store, self._missing = store, missing
        self._earlier = {name: manifest[name] for name in _ACCUMULATED}
        self._began = self._flushed = time.monotonic()
        self._rows: list[CellRows | Block] = []
        self._totals = Totals()
        self._finished, self._executor = 0, executor
        self._sofar = SoFar(missing, manifest["varying"])
        self._desk = Desk(
            missing,
            baselines=self._missing_baselines(),
            jobs=executor.jobs,
            on_rows=self._collect,
            on_baseline=self._keep_baseline,
            on_progress=self._show,
            on_note=tell,
            orders=orders,
            before=lambda programs: experience.of(programs, cache_folder()),
            starts=experience.start_of(cache_folder()),
            on_machine=lambda described: _note_machine(out, manifest, described),
            on_over=self._forget_checkpoint,
        )
        works = tuple(self._desk.works.values())
        self._bar = (watcher or usual_watcher())(spec.env, len(missing), self._desk.workers, works=works)

    def run(self) -> None:
        """Until nothing is missing."""
        self._manifest["jobs"] = self._executor.jobs
        self._save(complete=False)
        with stopping.deferred():
            with self._bar:
                try:
                    self._executor.run(self._desk)
                    self._desk.refuse_less()
                finally:
                    self._flush()
                    took = {program: work.took for program, work in self._desk.works.items()}
                    known = {program: cost for program, cost in took.items() if cost is not None}
                    experience.learn(known, cache_folder(), self._desk.started)
            _forget_idle_machines(self._manifest, self._store.machines)
            # What was asked for before may have been interrupted, and is not asked for now.
            self._save(complete=self._store.cells >= self._manifest["cells"])
            if self._manifest["complete"]:
                remove_all(self._out)

    def _missing_baselines(self) -> list[tuple[str, str]]:
        known = self._manifest["baselines"]
        names = [
            *(["idle"] if known["idle"] is None else []),
            *(n for n in self._spec.oracle if n not in known["oracles"] and n != NOBODY),
        ]
        return [(self._spec.env, name) for name in names]

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


def new_manifest(spec: SweepSpec, names: list[str], cells: int) -> dict[str, Any]:
    """The manifest of a sweep that has not run yet; `names` are its varying settings."""
    return {
        "format": FORMAT,
        "hash": specification_hash(spec),
        "specification": as_dict(spec),
        **labels_of(spec),
        "varying": names,
        "cells": cells,
        "baselines": {"idle": None, "oracles": {}},
        "versions": versions(),
        "machine": machine.describe(),
        "jobs": 0,
        **dict.fromkeys(_ACCUMULATED, 0),
        "env_steps_per_s": 0,
        "complete": False,
    }


_ACCUMULATED = ("wall_time_s", "compile_time_s", "env_steps")
"""Numbers of the manifest that grow when an interrupted sweep goes on. Compile time is the sum over processes."""


def _refuse_other_versions(out: Path, manifest: dict[str, Any]) -> None:
    for name, version in versions().items():
        before = manifest["versions"].get(name)
        if before != version:
            raise UserError(
                f"{out}: it was begun with {name} {before}, this is {version}: give a new folder (--out)"
            )


def _note_machine(out: Path, manifest: dict[str, Any], here: Mapping[str, Any]) -> None:
    """Adds this machine to a manifest that was begun on one of another kind, and says that bits may differ."""
    kind = machine.kind_of(here)
    known = [manifest["machine"], *manifest.get("further_machines", [])]
    if kind in map(machine.kind_of, known):
        return
    manifest["further_machines"] = [*known[1:], here]
    before = known[0]
    if machine.kind_of(before):  # an old manifest does not say enough to tell
        names = ", ".join(machine.differences(before, here))
        tell(f"{out}: begun on another kind of machine ({names}): last bits may differ, see its manifest")


def _forget_idle_machines(manifest: dict[str, Any], with_rows: Container[str]) -> None:
    """Leaves those machines in the manifest that have computed rows: who hands out cells need not compute any."""
    known = [manifest["machine"], *manifest.get("further_machines", [])]
    kinds = [machine.kind_of(each) for each in known]
    used = [each for each, kind in zip(known, kinds, strict=True) if not kind or kind in with_rows] or known[
        :1
    ]
    manifest["machine"] = used[0]
    manifest.pop("further_machines", None)
    if used[1:]:
        manifest["further_machines"] = used[1:]
