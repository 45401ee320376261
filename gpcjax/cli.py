"""The command line: parse and check first, import what computes second."""

import argparse
import errno
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import gpcjax
from gpcjax import cli_options
from gpcjax.envs.registry import env_names
from gpcjax.errors import UserError
from gpcjax.reproduce.parts import check, chosen, folder
from gpcjax.sweep.options import OPTIONS, parse
from gpcjax.sweep.plan import count, default_out, varying
from gpcjax.sweep.runfolder import check_report, check_sweep, make_writable
from gpcjax.sweep.spec import Given, SweepSpec, make_spec, read_toml

MISTAKE = 2
INTERRUPTED = 130
"""Exit status after Ctrl-C, as in shells: 128 and the signal's number."""
BROKEN_PIPE = 141


def main(words: Sequence[str] | None = None) -> int:
    """Run `gpcjax WORDS`. Returns the exit status: 0, 2 after a person's mistake, 130 after Ctrl-C."""
    try:
        status = _run(sys.argv[1:] if words is None else words)
        sys.stdout.flush()
        return status
    except UserError as error:
        return _fail(f"error: {error}", MISTAKE)
    except KeyboardInterrupt:
        return _fail("stopped", INTERRUPTED)
    except BrokenPipeError:  # the reader of our output is gone, `| head` for one
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        return _fail(f"error: {error}: make room, then the same command goes on", 1)


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
        case "report":
            return _report(Path(arguments.out))
        case "oracles":
            return _oracles(arguments.env)
        case "reproduce":
            return _reproduce(arguments)
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
    if not unresolved:  # without its schedule, this is not yet the specification that the folder holds
        check_sweep(out, spec)
    if arguments.dry_run:
        print(f"{cells} cells of {spec.env}, {spec.episodes} episodes each, in {jobs} processes, into {out}")
        return 0
    make_writable(out)
    return _teach(spec, out, jobs)


def _with_schedule(given: dict[str, Given], dry_run: bool) -> dict[str, Given]:
    """The settings with the schedule that `rate_from` names; for a check it is enough that the folder is there."""
    setting = given.pop("rate_from")
    folder = Path(os.path.expanduser(setting.value))
    for name in ("rate_schedule", "rate"):
        if name in given:
            raise UserError(f"{given[name].where}: beside rate_from it changes nothing, give one of the two")
    check_report(folder)
    if dry_run:
        return given
    from gpcjax.sweep.schedule import offered_rates

    return given | {"rate_schedule": Given(offered_rates(folder), setting.where)}


def _teach(spec: SweepSpec, out: Path, jobs: int) -> int:
    try:
        from gpcjax.sweep.run import run

        run(spec, out, jobs)
        return _report(out)
    except KeyboardInterrupt:
        message = f"stopped: {out} keeps what is finished, the same command goes on from there"
        return _fail(message, INTERRUPTED)


def _report(out: Path) -> int:
    check_report(out)
    from rich.console import Console

    from gpcjax.report.run import draw
    from gpcjax.report.tables import render

    summary = draw(out)
    width = None if sys.stdout.isatty() else 160  # a file or pipe is no narrow terminal
    Console(width=width).print(render(summary))
    print(f"{out}: {', '.join(path.name for path in summary.files)}")
    return 0


def _oracles(text: str | None) -> int:
    names = env_names() if text is None else text.split(",")
    envs = tuple(dict.fromkeys(parse(OPTIONS["env"], name, "--env") for name in names))
    from gpcjax.sweep.executors import run_alone

    return run_alone("gpcjax.sweep.oracles", *envs)


def _reproduce(arguments: argparse.Namespace) -> int:
    only, sweeps = chosen(arguments.only), Path(arguments.sweeps)
    out = Path(os.path.expanduser(arguments.out)) if arguments.out else folder(arguments.quick)
    jobs = parse(OPTIONS["jobs"], arguments.jobs, "--jobs") if arguments.jobs else usable_cores()
    runs = check(sweeps, out, only, arguments.quick)
    if arguments.dry_run:
        print(f"{', '.join(only)}: {runs} experiments of {sweeps}, in {jobs} processes, into {out}")
        return 0
    from gpcjax.reproduce.run import reproduce

    try:
        print(reproduce(sweeps, out, only, arguments.quick, jobs))
    except KeyboardInterrupt:
        return _fail(
            f"stopped: {out} keeps what is finished, the same command goes on from there", INTERRUPTED
        )
    return 0


def _fail(message: str, status: int) -> int:
    """Say why in one line, whatever characters a person's value held, and give back `status`."""
    line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in message)
    print(f"gpcjax: {line}", file=sys.stderr)
    return status
