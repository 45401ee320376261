"""Commands that run something: everything is checked first."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gpcjax.cli.flags import DEFAULTS
from gpcjax.cli.saying import tell
from gpcjax.cli.showing import report
from gpcjax.cli.words import settings
from gpcjax.errors import Failure, UserError
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.beforehand import check
from gpcjax.sweep.beginning import begun
from gpcjax.sweep.environment import compute_platform, notes
from gpcjax.sweep.fitting import left_out
from gpcjax.sweep.given import Given, Unchecked
from gpcjax.sweep.keeping import Keeping, keeping_of
from gpcjax.sweep.layout import MANIFEST
from gpcjax.sweep.lock import held
from gpcjax.sweep.options import OPTIONS, parse
from gpcjax.sweep.plan import count, default_out, varying
from gpcjax.sweep.runfolder import check_report
from gpcjax.sweep.shards import Shard, shard_of
from gpcjax.sweep.spec import SweepSpec, make_spec, read_toml

if TYPE_CHECKING:
    from gpcjax.sweep.executors import Executor

FAULT = "fault.txt"
"""In a run folder, the traceback of the fault of ours that ended its last run."""

_KEPT = ("keep", "keep_at", "checkpoint")


def usable_cores() -> int:
    """Cores that this process may run on."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def default_jobs() -> int:
    """Processes at once where nobody says: one for each core, and one alone where a GPU computes."""
    return usable_cores() if compute_platform() == "cpu" else 1


def sweep(arguments: argparse.Namespace) -> int:
    """`gpcjax sweep` and `gpcjax grid`."""
    if arguments.quick and arguments.toml is None:
        raise UserError("--quick takes the table [quick] of a TOML file: give the file")
    given = read_toml(Path(arguments.toml), arguments.quick) if arguments.toml is not None else {}
    given |= settings(arguments)
    unresolved = "rate_from" in given and arguments.dry_run
    if "rate_from" in given:
        given = _with_schedule(given, arguments.dry_run)
    if arguments.command == "grid":
        defaults = DEFAULTS["grid"]
        given = {name: Given(value, name) for name, value in defaults.items()} | given
    spec = make_spec(given)
    cells = count(spec)
    if arguments.command == "grid" and not set(varying(spec)) & set(spec.hyperparameters):
        raise UserError("no hyperparameter is a list: give one, as in --policy-length-scale 0.1,0.2,0.4")
    out = Path(os.path.expanduser(given["out"].value)) if "out" in given else default_out(spec)
    jobs = given["jobs"].value if "jobs" in given else default_jobs()
    executor = _executor(given)
    shard = shard_of(given["shard"].value, given["shard"].source) if "shard" in given else None
    out = out if shard is None else shard.folder(out)
    running = Running(jobs, arguments.json, arguments.live, *_kept(given), executor, shard)
    start = given["start"].source if "start" in given else "start"
    check(out, spec, running.keeping, shard, "--keep", start, resolved=not unresolved)
    for line in left_out(spec.env) if "algo" not in given else ():
        tell(line, 0)
    if arguments.dry_run:
        workers = f"in {jobs} processes" if executor is None else "in a Ray"
        share = "" if shard is None else f"shard {shard} of "
        print(f"{share}{cells} cells of {spec.env}, {spec.episodes} episodes each, {workers}, into {out}")
        return 0
    with begun(out):
        status = _teach(spec, out, running)
    if arguments.command == "grid" and shard is None:
        _write_best(out, spec, arguments.json)
    return status


def _write_best(out: Path, spec: SweepSpec | None, as_json: bool) -> None:
    """The best settings of a grid, by its rows, as files; says where they are."""
    from gpcjax.tune.best import write_best

    paths = write_best(out, spec)
    if as_json and paths:
        print(json.dumps({"event": "best", "out": str(out), "files": [*map(str, paths)]}))
    for path in () if as_json else paths:
        print(f"{path}: the best settings, with other seeds: gpcjax sweep {path}")


def _executor(given: Mapping[str, Given | Unchecked]) -> "Executor | None":
    """What runs the workers, where that is not processes of this machine."""
    engine, address, jobs = (given.get(name) for name in ("engine", "address", "jobs"))
    if engine is None and address is None:
        return None
    from gpcjax.sweep.executors import executor_of

    return executor_of(
        engine and engine.value,
        address and address.value,
        jobs and jobs.value,
        address.source if address is not None else "",
    )


class Running(NamedTuple):
    """How a sweep is run, beside what it is."""

    jobs: int
    as_json: bool
    live: bool
    """Whether the report is drawn meanwhile, too."""
    keeping: Keeping | None
    checkpoint: float
    executor: "Executor | None"
    """Beside processes of this machine."""
    shard: Shard | None


def _kept(given: Mapping[str, Given | Unchecked]) -> tuple[Keeping | None, float]:
    """What is kept of runs, and the seconds after which they are saved meanwhile."""
    value = {name: given[name].value if name in given else OPTIONS[name].default for name in _KEPT}
    source = {name: given[name].source if name in given else OPTIONS[name].flag for name in _KEPT}
    keeping = keeping_of(value["keep"], value["keep_at"], (source["keep"], source["keep_at"]))
    return keeping, value["checkpoint"]


def _with_schedule(given: dict[str, Given | Unchecked], dry_run: bool) -> dict[str, Given | Unchecked]:
    """The settings with the schedule that `rate_from` names; for a check it is enough that the folder is there."""
    setting = given.pop("rate_from")
    folder = Path(os.path.expanduser(setting.value))
    for name in ("rate_schedule", "rate"):
        if name in given:
            raise UserError(f"{given[name].source}: beside rate_from it changes nothing, give one of the two")
    check_report(folder)
    if dry_run:
        return given
    from gpcjax.sweep.schedule import offered_rates

    return given | {"rate_schedule": Given(offered_rates(folder), setting.source)}


def _teach(spec: SweepSpec, out: Path, running: Running) -> int:
    with keeping(out):
        from gpcjax.sweep.jsonlines import JsonLines
        from gpcjax.sweep.progress import Bar
        from gpcjax.sweep.run import run

        note()
        with held(out):  # until the report is written, too
            watcher = JsonLines if running.as_json else Bar
            with _drawing(out, running.live) as meanwhile:
                ran = run(
                    spec,
                    out,
                    running.jobs,
                    executor=running.executor,
                    keeping=running.keeping,
                    checkpoint=running.checkpoint,
                    watcher=watcher,
                    meanwhile=meanwhile,
                    shard=running.shard,
                )
            (out / FAULT).unlink(missing_ok=True)
            if running.shard is not None:  # all of them are reported on together
                return _tell_shard(out, running.shard, running.as_json)
            return report(out, running.as_json, anew=ran)


def _tell_shard(out: Path, shard: Shard, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"event": "shard", "shard": str(shard), "out": str(out)}))
    else:
        print(f"{out}: shard {shard} is there; gpcjax merge {out.parent.parent}, when all of them are")
    return 0


@contextmanager
def keeping(out: Path) -> Iterator[None]:
    """A run that ends before its time says that `out` keeps what is finished."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.args = (f"stopped: {out} keeps what is finished, the same command goes on from there",)
        raise
    except Failure as failure:
        raise Failure(f"{failure}; {out} keeps what is finished{_full_text(failure, out)}") from None


@contextmanager
def _drawing(out: Path, live: bool) -> Iterator[Callable[[], None]]:
    """What is done in a thread while a sweep runs: the report is drawn, or what it needs is loaded."""
    if not live:
        yield _prepare_report
        return
    from gpcjax.report.live import Live

    drawing = Live(out)
    try:
        yield drawing.run
    finally:
        drawing.stop()


def _prepare_report() -> None:
    """Loads what the report needs: of this process nothing else is wanted while the workers compute."""
    with suppress(Exception):  # the report will say it
        import gpcjax.report.figures.drawing
        import gpcjax.report.terminal  # noqa: F401
        from gpcjax.report.figures.style import load_formats

        load_formats()


def merge(arguments: argparse.Namespace) -> int:
    """`gpcjax merge`."""
    out = (
        None
        if arguments.out is None
        else Path(os.path.expanduser(parse(OPTIONS["out"], arguments.out, "--out")))
    )
    from gpcjax.sweep.merging import merge

    whole = merge([Path(os.path.expanduser(folder)) for folder in arguments.folder], out)
    status = report(whole, arguments.json)
    _write_best(
        whole, None, arguments.json
    )  # of lists of hyperparameters, as shards have no best of their own
    return status


def tune(arguments: argparse.Namespace) -> int:
    """`gpcjax tune`."""
    from gpcjax.tune.command import STATE, said, wishes_of

    wishes = wishes_of(arguments, settings(arguments), default_jobs())
    if arguments.dry_run:
        print(said(wishes))
        return 0
    with begun(wishes.out, (MANIFEST, STATE)), keeping(wishes.out):
        from gpcjax.tune.carrying_out import carry_out

        note()
        return carry_out(wishes)


def note() -> None:
    """Tells what of the present environment does not hold here."""
    for line in notes():
        tell(line, 0)


def _full_text(failure: Failure, out: Path) -> str:
    """Where the traceback of a fault of ours can be read, if there is one and it can be written."""
    if not failure.details:
        return ""
    path = out / FAULT
    try:
        write_atomic(path, failure.details)
    except OSError:
        return ""
    return f". This is a fault of gpcjax: its full text is in {path}"
