"""Processes of this machine: begun, waited for, and as /proc tells of them."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATIENCE = 120
"""Seconds until a process that should have done something is given up."""


def workers_of(pid: int) -> list[int]:
    """Processes whose parent is `pid`."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = status.read_text().rpartition(")")[2].split()
            if int(fields[1]) == pid and fields[0] != "Z":
                found.append(int(status.parent.name))
    return sorted(found)


def alive(pid: int) -> bool:
    """Whether it is there, and has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for(condition, patience: float = PATIENCE) -> None:
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@contextlib.contextmanager
def process(words, out, env=None):
    """A process in a group of its own, as the shell makes them, whose workers are killed with it at the end."""
    with open(out / "stderr", "w") as stderr:
        running = subprocess.Popen(
            [sys.executable, *words], cwd=ROOT, stdout=stderr, stderr=stderr, start_new_session=True, env=env
        )
    try:
        yield running
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
        running.wait()
