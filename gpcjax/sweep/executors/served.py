"""A worker process of `processes`: this file is run, with a descriptor and the parent's process as arguments.

It computes on one thread, whatever the number of processes: XLA's arithmetic may depend on how it splits work. Nothing
of ours is imported before it is sure to end with its parent, which may be killed at any moment: imports take seconds.
"""

import ctypes
import os
import signal
import sys
import time


def main() -> None:
    """Serves the connection whose descriptor is the first argument; the second one is the parent's process."""
    began = time.monotonic(), time.process_time()
    die_with_parent(int(sys.argv[2]))
    from multiprocessing.connection import Connection

    from gpcjax.sweep import stopping
    from gpcjax.sweep.executors.base import ASKS, Message

    for number in stopping.SIGNALS:  # they go to the parent, which says when to stop
        signal.signal(number, signal.SIG_IGN)
    connection = Connection(int(sys.argv[1]))

    def say(message: Message) -> Message | None:
        try:
            connection.send(message)
            return connection.recv() if message[0] in ASKS else None
        except (EOFError, BrokenPipeError, ConnectionResetError):
            os._exit(1)  # the parent is gone

    from gpcjax.sweep.crowd import piece_of_work
    from gpcjax.sweep.worker import work

    say(("begun", time.monotonic() - began[0], time.process_time() - began[1], piece_of_work()))
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
