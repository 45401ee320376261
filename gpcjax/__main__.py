"""`python -m gpcjax` and the command `gpcjax`: quiet from the first line on.

What the command needs takes a tenth of a second to import. Until `gpcjax.cli` listens there is nothing to keep and
nothing to undo, so a signal ends the process where it is: raised as an exception it would come out of whichever library
is being imported, with that library's traceback.
"""

import os
import signal

_QUIET = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def main() -> int:
    """Run `gpcjax` with the words of this process; the exit status is that of `gpcjax.cli.main`."""
    for number in _QUIET:
        # What the shell ignores (nohup) stays ignored.
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _leave)
    from gpcjax.cli import main as run

    return run()


def _leave(number: int, frame: object) -> None:
    """The handler until then: one line and the status, as later."""
    try:
        os.write(2, b"gpcjax: stopped\n")
    finally:
        os._exit(128 + number)


if __name__ == "__main__":  # worker processes import this file again
    raise SystemExit(main())
