"""The command line: parse and check first, import what computes second."""

import argparse
import dataclasses
import errno
import json
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import gpcjax
from gpcjax import cli_options
from gpcjax.envs.registry import env_names
from gpcjax.errors import Failure, ForeignError, UserError
from gpcjax.reproduce.parts import SWEEPS, check, chosen, folder
from gpcjax.streams import leave, make_printable
from gpcjax.sweep import stopping
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.environment import notes
from gpcjax.sweep.keepable import check_keeping
from gpcjax.sweep.keeping import Keeping, keeping_of
from gpcjax.sweep.lock import held
from gpcjax.sweep.options import OPTIONS, parse
from gpcjax.sweep.plan import count, default_out, varying
from gpcjax.sweep.runfolder import check_report, check_sweep, make_writable
from gpcjax.sweep.shards import Shard, check_shard, shard_of
from gpcjax.sweep.spec import Given, SweepSpec, Unchecked, make_spec, read_toml

if TYPE_CHECKING:
    from gpcjax.sweep.executors import Executor

FAILED = 1
MISTAKE = 2
FAULT = "fault.txt"
"""In a run folder, the traceback of the fault of ours that ended its last run."""

BROKEN_PIPE = 141

_KEPT = ("keep", "keep_at", "checkpoint")

_HINTS = {
    errno.ENOSPC: "make room",
    errno.EDQUOT: "make room",
    errno.EFBIG: "a file may not be that large here (ulimit -f), raise the limit",
    errno.EMFILE: "too few files may be open here (ulimit -n), raise the limit or give fewer --jobs",
    errno.ENFILE: "the system has too many open files, close some",
    errno.EROFS: "make it writable",
    errno.EACCES: "make it writable",
    errno.EPERM: "make it writable",
    errno.ENOENT: "the folder was removed or moved while it was in use",
    errno.ENOMEM: "give fewer --jobs or a machine with more memory",
    errno.EAGAIN: "give fewer --jobs",
}
"""What to do about an error of the system."""


def main(words: Sequence[str] | None = None) -> int:
    """Run `gpcjax WORDS`, or the words of this process if none are given, and give the exit status.

    0 done; 1 the run failed; 2 a mistake in the command; 130, 143, 129 stopped by Ctrl-C, SIGTERM, SIGHUP (128 and the
    signal's number, as in shells); 141 nobody reads the output. Everything but 0 comes with one line on stderr. A fault
    of ours raises, with its traceback.
    """
    if words is not None:
        return _guarded(words)
    make_printable()
    _forget_warnings()
    stopping.listen()
    try:
        return _guarded(sys.argv[1:])
    finally:
        stopping.deaf()


def _guarded(words: Sequence[str]) -> int:
    """Run the words, and make one line and a status of all that is no fault of ours."""
    try:
        status = _run(words)
        sys.stdout.flush()
        return status
    except UserError as error:
        if isinstance(error, ForeignError):
            _show(error.details)
        return _tell(f"error: {error}", MISTAKE)
    except KeyboardInterrupt as stop:
        return _tell(str(stop) or "stopped", _status(stop))
    except Exception as error:
        # A signal while a library is loaded comes out as that library's own error.
        if (status := stopping.status()) is not None:
            return _tell("stopped", status)
        if isinstance(error, BrokenPipeError):  # the reader of our output is gone, `| head` for one
            for name in ("stdout", "stderr"):
                leave(name)
            return BROKEN_PIPE
        line = _reason(error)
        if line is None:
            raise
        _give_up_stdout()
        return _tell(f"error: {line}", FAILED)


def _reason(error: Exception) -> str | None:
    """Why a run failed, in a line, where that is no fault of ours."""
    match error:
        case Failure():
            return str(error)
        case MemoryError():
            return f"too little memory: {_HINTS[errno.ENOMEM]}"
        case OSError(errno=int(number)):
            hint = _HINTS.get(number, "see to it")
            return f"{error}: {hint}, then the same command goes on"
        case OSError():
            return str(error)
        case ImportError():
            return f"a library cannot be loaded: {error}"
        case RuntimeError() if "can't start new thread" in str(error):
            return f"{error}: {_HINTS[errno.EAGAIN]}"
    return None


def _status(stop: KeyboardInterrupt) -> int:
    return stop.status if isinstance(stop, stopping.Stopped) else 128 + signal.SIGINT


def _give_up_stdout() -> None:
    """If it can take no more, so that the end of the process does not try it again."""
    try:
        sys.stdout.flush()
    except OSError:
        leave("stdout")


def _forget_warnings() -> None:
    """Warnings are as Python has them by default, also where PYTHONWARNINGS makes errors of them: libraries warn."""
    warnings.resetwarnings()
    for category in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
        warnings.simplefilter("ignore", category)


def usable_cores() -> int:
    """Cores that this process may run on."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _run(words: Sequence[str]) -> int:
    if not words:
        cli_options.build().print_help(sys.stderr)
        return MISTAKE
    arguments = cli_options.parse_words(words)
    match arguments.command:
        case "sweep" | "grid":
            return _sweep(arguments)
        case "tune":
            return _tune(arguments)
        case "report":
            return _report(Path(arguments.out), arguments.json)
        case "compare":
            return _compare(arguments)
        case "merge":
            return _merge(arguments)
        case "runs":
            return _runs(Path(os.path.expanduser(arguments.folder or "runs")), arguments.json)
        case "show":
            return _show_folder(Path(os.path.expanduser(arguments.out)), arguments.json)
        case "oracles":
            return _oracles(arguments.env)
        case "reproduce":
            return _reproduce(arguments)
        case "teach":
            from gpcjax.teach.command import by_hand

            return by_hand(arguments, cli_options.settings(arguments))
        case "play":
            from gpcjax.play.command import play

            return play(arguments)
        case "replay":
            from gpcjax.teach.run import replay

            return replay(Path(os.path.expanduser(arguments.out)))
    print(f"gpcjax {gpcjax.__version__}")
    return 0


def _sweep(arguments: argparse.Namespace) -> int:
    if arguments.quick and arguments.toml is None:
        raise UserError("--quick takes the table [quick] of a TOML file: give the file")
    given = read_toml(Path(arguments.toml), arguments.quick) if arguments.toml is not None else {}
    given |= cli_options.settings(arguments)
    unresolved = "rate_from" in given and arguments.dry_run
    if "rate_from" in given:
        given = _with_schedule(given, arguments.dry_run)
    if arguments.command == "grid":
        defaults = cli_options.DEFAULTS["grid"]
        given = {name: Given(value, name) for name, value in defaults.items()} | given
    spec = make_spec(given)
    cells = count(spec)
    if arguments.command == "grid" and not set(varying(spec)) & set(spec.hyperparameters):
        raise UserError("no hyperparameter is a list: give one, as in --policy-length-scale 0.1,0.2,0.4")
    out = Path(os.path.expanduser(given["out"].value)) if "out" in given else default_out(spec)
    jobs = given["jobs"].value if "jobs" in given else usable_cores()
    executor = _executor(given)
    shard = shard_of(given["shard"].value, given["shard"].source) if "shard" in given else None
    out = out if shard is None else shard.folder(out)
    running = Running(jobs, arguments.json, arguments.live, *_kept(given), executor, shard)
    check_keeping(running.keeping, spec, "--keep")
    if not unresolved:  # without its schedule, this is not yet the specification that the folder holds
        check_sweep(out, spec)
        check_shard(out, shard, cells)
    if spec.start is not None:
        from gpcjax.sweep.sources import check_start  # which reads run folders

        check_start(spec, given["start"].source)
    if arguments.dry_run:
        workers = f"in {jobs} processes" if executor is None else "in a Ray"
        share = "" if shard is None else f"shard {shard} of "
        print(f"{share}{cells} cells of {spec.env}, {spec.episodes} episodes each, {workers}, into {out}")
        return 0
    make_writable(out)
    status = _teach(spec, out, running)
    if arguments.command == "grid" and not running.as_json:
        from gpcjax.tune.best import write_best

        for path in write_best(out, spec):
            print(f"{path}: the best settings, with other seeds: gpcjax sweep {path}")
    return status


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
    with _keeping(out):
        from gpcjax.sweep.progress import Bar, JsonLines
        from gpcjax.sweep.run import run

        _note()
        with held(out):  # until the report is written, too
            watcher = JsonLines if running.as_json else Bar
            with _drawing(out, running.live) as meanwhile:
                ran = run(
                    spec,
                    out,
                    running.jobs,
                    running.executor,
                    keeping=running.keeping,
                    checkpoint=running.checkpoint,
                    watcher=watcher,
                    meanwhile=meanwhile,
                    shard=running.shard,
                )
            (out / FAULT).unlink(missing_ok=True)
            if (
                running.shard is not None
            ):  # a part of the runs says nothing: all of them are reported on together
                whole = out.parent.parent
                print(f"{out}: shard {running.shard} is there; gpcjax merge {whole}, when all of them are")
                return 0
            return _report(out, running.as_json, anew=ran)


@contextmanager
def _keeping(out: Path) -> Iterator[None]:
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


def _report(out: Path, as_json: bool, anew: bool = True) -> int:
    check_report(out)
    from gpcjax.report.run import draw
    from gpcjax.report.terminal import render

    summary = draw(out, anew=anew)
    if as_json:
        table = json.loads(summary.table().to_json(orient="records") or "[]")
        print(
            json.dumps(
                {"event": "report", "out": str(out), "files": [*map(str, summary.files)], "rows": table}
            )
        )
        return 0
    return _print(render(summary), out, summary.files)


def _merge(arguments: argparse.Namespace) -> int:
    out = (
        None
        if arguments.out is None
        else Path(os.path.expanduser(parse(OPTIONS["out"], arguments.out, "--out")))
    )
    from gpcjax.sweep.merging import merge

    whole = merge([Path(os.path.expanduser(folder)) for folder in arguments.folder], out)
    return _report(whole, arguments.json)


def _compare(arguments: argparse.Namespace) -> int:
    given = None if arguments.out is None else parse(OPTIONS["out"], arguments.out, "--out")
    folders = [Path(os.path.expanduser(folder)) for folder in arguments.folder]
    for each in folders:
        check_report(each)
    from gpcjax.report.compare import compare, usual_out
    from gpcjax.report.compare_page import terminal

    comparison = compare(*folders, by=arguments.by)
    names = [folder.name for folder in comparison.folders]
    out = usual_out(names) if given is None else Path(os.path.expanduser(given))
    return _print(terminal(comparison), out, comparison.save(out))


def _print(rendered: object, out: Path, files: Sequence[Path]) -> int:
    """A report at its end: what it says, and the files that hold it."""
    from rich.console import Console

    from gpcjax.report.words import printable

    width = None if sys.stdout.isatty() else 160  # a file or pipe is no narrow terminal
    Console(width=width).print(rendered)
    print(printable(f"{out}: {', '.join(path.name for path in files)}", sys.stdout.encoding))
    return 0


def _runs(below: Path, as_json: bool) -> int:
    from gpcjax.sweep.listing import run_folders

    folders = list(run_folders(below))
    if as_json:
        for folder in folders:
            print(json.dumps(folder.as_json()))
    elif folders:
        from gpcjax.report import folders as told
        from gpcjax.report.terminal import show_sheet

        show_sheet(told.sheet(folders, below))
    else:
        print(f"{below}: it holds no run folders")
    return 0


def _show_folder(out: Path, as_json: bool) -> int:
    from gpcjax.sweep.listing import contents, look

    folder = look(out)
    held = contents(folder)
    if as_json:
        print(json.dumps(folder.as_json() | dataclasses.asdict(held)))
        return 0
    from gpcjax.report import folders as told
    from gpcjax.report.terminal import show_facts

    show_facts(str(out), told.facts(folder, held))
    return 0


def _tune(arguments: argparse.Namespace) -> int:
    from gpcjax.tune.command import said, wishes_of

    wishes = wishes_of(arguments, cli_options.settings(arguments), usable_cores())
    if arguments.dry_run:
        print(said(wishes))
        return 0
    make_writable(wishes.out)

    with _keeping(wishes.out):
        from gpcjax.tune.carrying_out import carry_out

        _note()
        return carry_out(wishes)


def _oracles(text: str | None) -> int:
    names = env_names() if text is None else text.split(",")
    envs = tuple(dict.fromkeys(parse(OPTIONS["env"], name, "--env") for name in names))
    from gpcjax.sweep.executors import run_alone

    run_alone("gpcjax.sweep.oracles", *envs)
    return 0


def _reproduce(arguments: argparse.Namespace) -> int:
    only, sweeps = chosen(arguments.only), Path(arguments.sweeps) if arguments.sweeps else SWEEPS
    given = {
        name: getattr(arguments, name) for name in ("out", "jobs") if getattr(arguments, name) is not None
    }
    given = {name: parse(OPTIONS[name], text, f"--{name}") for name, text in given.items()}
    out = Path(os.path.expanduser(given["out"])) if "out" in given else folder(arguments.quick)
    jobs = given.get("jobs", usable_cores())
    runs = check(sweeps, out, only, arguments.quick)
    if arguments.dry_run:
        print(f"{', '.join(only)}: {runs} experiments, in {jobs} processes, into {out}")
        return 0
    from gpcjax.reproduce.run import reproduce

    with _keeping(out):
        _note()
        print(reproduce(sweeps, out, only, arguments.quick, jobs))
    return 0


def _note() -> None:
    for line in notes():
        _tell(line, 0)


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


def _show(traceback: str) -> None:
    """Somebody else's traceback, as it is."""
    try:
        print(traceback, end="", file=sys.stderr, flush=True)
    except OSError:  # as below
        leave("stderr")


def _tell(message: str, status: int) -> int:
    """Say it in one line on stderr, whatever characters a person's value held, and give back `status`."""
    line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in message)
    try:
        print(f"gpcjax: {line}", file=sys.stderr, flush=True)
    except OSError:  # nobody can be told; the status says it
        leave("stderr")
    return status
