"""One sweep from its specification to a complete store. The parent process loads no jax."""

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gpcjax.allowed import checked, checked_path
from gpcjax.errors import UserError
from gpcjax.sweep import machine
from gpcjax.sweep.beforehand import check, check_folder
from gpcjax.sweep.beginning import begun
from gpcjax.sweep.changed import note
from gpcjax.sweep.checkpoints import remove_all, survey, told
from gpcjax.sweep.digests import ENTRY as DIGESTS
from gpcjax.sweep.executors import Executor, Orders, Processes, executor_of
from gpcjax.sweep.fitting import left_out
from gpcjax.sweep.going import Going, missing_baselines
from gpcjax.sweep.growth import requests
from gpcjax.sweep.keepable import refuse_other
from gpcjax.sweep.keeping import ENTRY, Keeping, keeping_of
from gpcjax.sweep.layout import CHECKPOINTS, MANIFEST, tell
from gpcjax.sweep.lock import held
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.opening import asked, begin
from gpcjax.sweep.options import OPTIONS
from gpcjax.sweep.origin import note_machine, refuse_other_versions
from gpcjax.sweep.plan import Cell, default_out, plan
from gpcjax.sweep.shards import Shard, shard_of, share_of
from gpcjax.sweep.spec import SweepSpec, from_dict, spec_of
from gpcjax.sweep.store import Store
from gpcjax.sweep.telling import Watcher


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
    seconds = checked("checkpoint", checkpoint, float, OPTIONS["checkpoint"].allowed)
    folder = folder if share is None else share.folder(folder)
    check(folder, spec, keeping, share)
    for line in left_out(spec.env) if "algo" not in settings else ():
        tell(line)
    with begun(folder):
        run(spec, folder, jobs, executor, keeping=keeping, checkpoint=seconds, shard=share)
    return folder


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

    Gives whether there was anything to do. `meanwhile` is called in a thread of its own once the workers are busy. The
    other arguments are those of `opened`, which says what it raises.

    Raises:
        Failure: a worker failed; what was finished is kept.
    """
    jobs = jobs if executor is None else executor.jobs
    with opened(spec, out, jobs, grows, keeping, checkpoint, watcher, shard, say) as going:
        if going is None:
            return False
        executor = executor or Processes(jobs)
        threading.Thread(target=meanwhile, daemon=True).start()
        with going.under_way():
            executor.run(going.desk)
            going.finish()
        return True


@contextmanager
def opened(
    spec: SweepSpec,
    out: Path,
    jobs: int,
    grows: bool = True,
    keeping: Keeping | None = None,
    checkpoint: float = OPTIONS["checkpoint"].default,
    watcher: Callable[..., Watcher] | None = None,
    shard: Shard | None = None,
    say: Callable[[str], None] = tell,
) -> Iterator[Going | None]:
    """The sweep of the cells of `spec` that `out` does not hold yet, for the block; None where it holds all.

    With a `shard`, of these the cells of that share, into its own folder. `say` takes a line for the person where the
    folder grows.

    A folder that holds less than `spec` asks for `grows`, or is refused. Of each run that is kept what `keeping` says;
    runs that are under way are saved every `checkpoint` seconds, and go on from there after a kill.

    Nobody else can write to `out` meanwhile. What is damaged there is set aside with a line on stderr, and computed
    again: the manifest too, if the parts say that they are of this sweep.

    Raises:
        UserError: `out` holds something else, another process writes there, or it was begun with other versions of
            what computes, whose rows would differ in the last bits.
    """
    with held(out):
        check_folder(out, spec, keeping, shard, grows)  # again: somebody may have been faster
        is_new = not (out / MANIFEST).exists()
        manifest, request = asked(begin(spec, out, keeping, shard), spec, out, shard, say)
        cells, specs = plan(spec), [spec]
        if shard is not None:
            share = share_of(manifest, shard)
            manifest |= {"shard": shard.as_json(), "cells": len(share)}
            specs = _requested(manifest) if is_new else specs
            cells = _of_share(share, specs)
        here = machine.describe()
        store = Store(out, manifest, machine.kind_of(here), request=request)
        missing = store.missing(cells)
        if keeping is not None and ENTRY not in manifest and store.cells:
            say(
                f"{out}: its manifest does not say what of its runs is kept: those that are there stay as they are"
            )
        if not missing and manifest["complete"]:
            note(out, manifest, specs, [], [], say)
            if store.cells < manifest["cells"]:  # rows of another request, that are damaged or gone
                write_manifest(out, manifest | {"complete": False, "finished": store.cells})
            else:
                remove_all(out)  # of a run that was killed when all was there
            yield None
            return
        refuse_other(out, manifest, keeping)
        refuse_other_versions(out, manifest)
        note_machine(out, manifest, here)
        note(out, manifest, specs, missing, missing_baselines(manifest, spec), say)
        agree = told(manifest["versions"], machine.kind_of(here), keeping, manifest.get(DIGESTS, {}))
        orders = Orders(
            keeping=keeping,
            checkpoints=str((out / CHECKPOINTS).absolute()),
            seconds=checkpoint,
            agree=agree,
            varying=tuple(manifest["varying"]),
        )
        places = survey(out, lambda cell: not store.holds(cell), agree, tell)
        yield Going(spec, out, manifest, store, missing, jobs, orders, places, watcher)


def _requested(manifest: Mapping[str, Any]) -> list[SweepSpec]:
    """Of a new folder of a share, that is what the other shards were asked for before, too."""
    return [from_dict(each["specification"]) for each in requests(manifest)]


def _of_share(share: Iterable[Cell], specs: Iterable[SweepSpec]) -> list[Cell]:
    """The cells of these specifications that are of a share, in their order."""
    mine = set(share)
    return [cell for cell in dict.fromkeys(cell for spec in specs for cell in plan(spec)) if cell in mine]
