"""Processes that compute: how they begin, and what their ends mean. Loads no jax."""

import errno
import os
import re
import signal
import subprocess
import time

from gpcjax.errors import Failure
from gpcjax.sweep import stopping
from gpcjax.sweep.environment import python, worker_environment

LAST_WORDS = 8192
"""Bytes that are kept of what a worker writes: the reason of its end stands in the last line."""

FEWER = ", give fewer --jobs or a machine with more memory"

NO_MEMORY = re.compile(
    r"MemoryError|bad_alloc|RESOURCE_EXHAUSTED(?!.*(?:[Ee]rror writing|No space))|[Oo]ut of memory"
    "|annot allocate memory|Resource temporarily unavailable|failed to map segment|can't start new thread"
)
"""How libraries say that memory, or room for another thread, was not to be had; not that a disk is full."""

ASKED_TO_STOP = (-signal.SIGINT, -signal.SIGTERM, -getattr(signal, "SIGHUP", signal.SIGTERM))


def run_alone(module: str, *words: str) -> None:
    """`python -m module words` on one thread, as workers compute. What it prints is shown, what it complains is not.

    Like a worker it hears no Ctrl-C, which is for the parent alone, and never outlives this call.

    Raises:
        Failure: it could not be started, was killed or failed; the message has its reason.
    """
    try:
        process = subprocess.Popen(
            python(module, *words),
            env=worker_environment(),
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            process_group=0,
        )
    except OSError as error:
        raise not_started(error) from None
    assert process.stderr is not None
    said = b""
    try:
        while written := os.read(process.stderr.fileno(), 1 << 16):
            said = (said + written)[-LAST_WORDS:]
        status = process.wait()
    finally:
        process.kill()
        process.wait()
        process.stderr.close()
    if status:
        await_signal(status)
        text = said.decode(errors="replace")
        fault = "Traceback" in text and not NO_MEMORY.search(text) and "[Errno " not in text.splitlines()[-1]
        raise Failure(f"{module.rpartition('.')[2]} {reason(status, text)}", text if fault else "")


def reason(status: int, last_words: str) -> str:
    """Why a process ended: how it was killed or its exit status, and the last line of what it wrote.

    Args:
        status: as `subprocess` has it, the negative number of a signal.
        last_words: the end of what it wrote. Frames of a stack ("@ 0x...") are no reason.
    """
    lines = [line for line in map(str.strip, last_words.splitlines()) if line and line[0] not in "@*#"]
    said = f": {lines[-1][:300]}" if lines else ""
    fewer = FEWER if NO_MEMORY.search(last_words) else ""
    if status == -signal.SIGKILL:
        return f"was killed by SIGKILL{said}, perhaps by the system for want of memory{FEWER}"
    if status < 0:
        names = {number.value: number.name for number in signal.Signals}
        return f"was ended by {names.get(-status, f'signal {-status}')}{said}{fewer}"
    return f"ended with status {status}{said}{fewer}"


def await_signal(status: int) -> None:
    """If one asked a process of ours to stop: sent to all of them, it is on its way to this one as well.

    Raises:
        Stopped: it has come in.
    """
    if status in ASKED_TO_STOP:
        time.sleep(0.2)
        stopping.check()


def not_started(error: OSError) -> Failure:
    """Why a process could not be started, and what to give."""
    hint = FEWER if error.errno in (errno.ENOMEM, errno.EAGAIN) else ", give fewer --jobs"
    return Failure(f"a worker process could not be started: {error.strerror}{hint}")
