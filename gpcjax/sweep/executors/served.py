"""A worker process of `processes`, started as `python -m gpcjax.sweep.executors.served DESCRIPTOR`.

It computes on one thread, whatever the number of processes: XLA's arithmetic may depend on how it splits work.
"""

import ctypes
import os
import signal
import sys
from multiprocessing.connection import Connection

from gpcjax.sweep import stopping
from gpcjax.sweep.executors.base import ASKS, Message


def main() -> None:
    """Serves the connection whose descriptor is the first argument; the second one is the parent's process."""
    for number in stopping.SIGNALS:  # they go to the parent, which says when to stop
        signal.signal(number, signal.SIG_IGN)
    die_with_parent(int(sys.argv[2]))
    from gpcjax.sweep.worker import work  # takes seconds, in which the parent may end

    connection = Connection(int(sys.argv[1]))

    def say(message: Message) -> Message | None:
        try:
            connection.send(message)
            return connection.recv() if message[0] in ASKS else None
        except (EOFError, BrokenPipeError, ConnectionResetError):
            os._exit(1)  # the parent is gone

    if not work(say):
        raise SystemExit(1)


def die_with_parent(parent: int) -> None:
    """Has the kernel kill this process when its parent ends, where it can: during a compilation nobody looks."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)  # Linux alone has it
    if prctl is not None:
        prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    if os.getppid() != parent:  # it ended before
        os._exit(1)


if __name__ == "__main__":
    main()
