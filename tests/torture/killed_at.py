"""gpcjax as it is typed, killed at one exact moment.

    python -m tests.torture.killed_at MOMENT COUNT sweep ...

The process kills itself by SIGKILL just before it does something of the kind of MOMENT for the COUNT-th time: it opens,
renames or removes a file whose name is one of `FILES[MOMENT]`, or it hears that a worker begins to compile, which is
killed in its place where MOMENT is "worker compiles". Where that never happens, the command goes on to its end.
"""

import os
import re
import signal
import sys
from typing import Any

FILES = {
    "manifest": r"\.?manifest\.json.*",
    "parts": r"\.?part-.*\.parquet.*",
    "report": r"\.?(summary|differences|curves|rates|report)\..*",
    "checkpoints": r"\d{10,}-\d+-\d+|checkpoints",
    "lock": r".*\.lock|lock",
}
COMPILES = ("parent, while a worker compiles", "worker compiles")
MOMENTS = (*FILES, *COMPILES)
EVENTS = ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir")


def at_files(pattern: str, count: int) -> None:
    """Kills this process at the count-th of `EVENTS` with a file of such a name."""
    left, wanted = count, re.compile(pattern)

    def hear(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal left
        if event not in EVENTS:
            return
        names = (
            os.path.basename(os.fspath(each)) for each in arguments if isinstance(each, str | os.PathLike)
        )
        if any(wanted.fullmatch(name) for name in names):
            left -= 1
            if not left:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hear)


def at_compilations(of_worker: bool, count: int) -> None:
    """Kills this process, or one of its workers, when it hears of the count-th compilation."""
    from gpcjax.sweep.executors.base import Message
    from gpcjax.sweep.executors.desk import Desk
    from tests.sweep.processes import workers_of

    left, answer = count, Desk.answer

    def hear(desk: Desk, worker: int, message: Message) -> Message | None:
        nonlocal left
        if message == ("compiling", True):
            left -= 1
            if not left:
                workers = workers_of(os.getpid()) if of_worker else [os.getpid()]
                os.kill(workers[0], signal.SIGKILL)
        return answer(desk, worker, message)

    Desk.answer = hear


def main() -> int:
    """Waits for the moment while it does what it is told."""
    moment, count = sys.argv[1], int(sys.argv[2])
    del sys.argv[1:3]
    if moment in FILES:
        at_files(FILES[moment], count)
    else:
        at_compilations(moment == "worker compiles", count)
    from gpcjax.__main__ import main as run

    return run()


if __name__ == "__main__":
    raise SystemExit(main())
