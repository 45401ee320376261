"""The command line: parse and check first, import what computes second."""

import argparse
import errno
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import gpcjax
from gpcjax.cli import experiments, running, showing
from gpcjax.cli import words as grammar
from gpcjax.cli.saying import show, tell
from gpcjax.errors import Failure, ForeignError, Unwritten, UserError
from gpcjax.installed import is_set_up
from gpcjax.streams import leave, make_printable
from gpcjax.sweep import stopping

FAILED = 1
MISTAKE = 2
BROKEN_PIPE = 141

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
        if isinstance(error, ForeignError) and error.details:
            show(error.details)
        return tell(f"error: {error}", FAILED if isinstance(error, Unwritten) else MISTAKE)
    except KeyboardInterrupt as stop:
        return tell(str(stop) or "stopped", _status(stop))
    except Exception as error:
        # A signal while a library is loaded comes out as that library's own error.
        if (status := stopping.status()) is not None:
            return tell("stopped", status)
        if isinstance(error, BrokenPipeError):  # the reader of our output is gone, `| head` for one
            for name in ("stdout", "stderr"):
                leave(name)
            return BROKEN_PIPE
        line = _reason(error)
        if line is None:
            raise
        _give_up_stdout()
        return tell(f"error: {line}", FAILED)


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


def _run(words: Sequence[str]) -> int:
    if not words:
        grammar.build().print_help(sys.stderr)
        return MISTAKE
    arguments = grammar.parse_words(words)
    try:
        return _done(arguments)
    except ImportError as error:
        if is_set_up() or not getattr(arguments, "dry_run", False):
            raise
        return tell(f"what this names is looked at once gpcjax is set up ({error})", 0)


def _done(arguments: argparse.Namespace) -> int:
    match arguments.command:
        case "sweep" | "grid":
            return running.sweep(arguments)
        case "tune":
            return running.tune(arguments)
        case "report":
            return showing.report(Path(arguments.out), arguments.json)
        case "compare":
            return showing.compare(arguments)
        case "merge":
            return running.merge(arguments)
        case "runs":
            return showing.runs(Path(os.path.expanduser(arguments.folder or "runs")), arguments.json)
        case "show":
            return showing.show_folder(Path(os.path.expanduser(arguments.out)), arguments.json)
        case "oracles":
            return experiments.oracles(arguments.env)
        case "reproduce":
            return experiments.reproduce(arguments)
        case "teach":
            from gpcjax.teach.command import by_hand

            return by_hand(arguments, grammar.settings(arguments))
        case "study":
            from gpcjax.study.command import study

            return study(arguments)
        case "play":
            from gpcjax.play.command import play

            return play(arguments)
        case "policy":
            from gpcjax.deploy.command import policy

            return policy(arguments)
        case "replay":
            from gpcjax.teach.run import replay

            return replay(Path(os.path.expanduser(arguments.out)))
    print(f"gpcjax {gpcjax.__version__}")
    return 0
