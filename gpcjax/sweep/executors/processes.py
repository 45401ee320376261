"""Worker processes on this machine, each with a connection to this one. Loads no jax."""

import dataclasses
import os
import signal
import subprocess
from collections.abc import Sequence
from contextlib import ExitStack
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait

from gpcjax.errors import Failure
from gpcjax.sweep import stopping
from gpcjax.sweep.environment import forget_programs, script, worker_environment
from gpcjax.sweep.executors import served
from gpcjax.sweep.executors.base import ASKS, Counter, Message
from gpcjax.sweep.executors.starting import LAST_WORDS, await_signal, not_started, reason

MACHINE_CODE = tuple(
    -number for number in (signal.SIGSEGV, signal.SIGILL, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE)
)
"""How a process ends that executes what is no good here, as a kept program might be."""

LOOK_SECONDS = 0.5
"""Longest time between two reports of progress."""


@dataclasses.dataclass
class _Worker:
    number: int
    connection: Connection
    process: subprocess.Popen[bytes]
    errors: int
    """What it writes to stderr can be read here."""
    last_words: bytes = b""
    """The end of what it has written."""
    waits: bool = False
    """Whether it has said that it is ready, and has no answer yet."""

    def listen(self) -> bool:
        """Take in what it has written; False if it can write no more."""
        try:
            written = os.read(self.errors, 1 << 16)
        except BlockingIOError:
            return True
        self.last_words = (self.last_words + written)[-LAST_WORDS:]
        return bool(written)

    def receive(self) -> Message:
        """What it says. Raises Failure: it has ended."""
        try:
            return self.connection.recv()
        except (EOFError, ConnectionError):
            raise _end_of(self) from None

    def send(self, message: Message) -> None:
        """Likewise. What becomes of a message here, at the desk, is not its doing."""
        try:
            self.connection.send(message)
        except ConnectionError:
            raise _end_of(self) from None

    def end(self) -> None:
        """Kill it, if it has not ended."""
        self.connection.close()
        self.process.kill()
        self.process.wait()
        os.close(self.errors)


class Processes:
    """An executor: so many processes of this machine, which run `gpcjax.sweep.executors.served`.

    As a context, `with Processes(jobs) as executor`, it keeps its workers from one sweep to the next, until the end of
    the context: they import and compile once. A worker that has nothing to do waits then for an answer.

    Args:
        jobs: processes at once.
    """

    def __init__(self, jobs: int):
        self.jobs = jobs
        self._workers: list[_Worker] = []
        self._stay = False

    def __enter__(self) -> "Processes":
        self._stay = True
        return self

    def __exit__(self, *error: object) -> None:
        self._stay = False
        self._end()

    def _end(self) -> None:
        for worker in self._workers:
            worker.end()
        self._workers = []

    def run(self, desk: Counter) -> None:
        """Returns when all is done. Workers never outlive this call, or its context.

        Raises:
            Failure: a worker failed, ended or could not be started; the message has its reason.
            Stopped: a signal came in, within `stopping.deferred`.
        """
        try:
            environment = worker_environment()
            for number in range(len(self._workers), desk.workers):
                self._workers.append(_start(number, environment))
            self._serve_all(desk, self._workers[: desk.workers])
        except BaseException:
            self._end()
            raise
        if not self._stay:
            self._end()

    def _serve_all(self, desk: Counter, workers: Sequence[_Worker]) -> None:
        """Answers messages until no worker has more to do."""
        for worker in workers:
            if worker.waits:
                worker.waits = False
                worker.send(("again",))
        working = {worker.connection: worker for worker in workers}
        writing = {worker.errors: worker for worker in workers}
        stop = stopping.wakeup()
        while working:
            stopping.check()
            ready = wait([*working, *writing, *([] if stop is None else [stop])], LOOK_SECONDS)
            if not ready:  # nothing comes while all of them compile
                desk.look()
            for descriptor in writing.keys() & set(ready):
                if not writing[descriptor].listen():
                    del writing[descriptor]
            for connection in working.keys() & set(ready):
                stopping.check()
                if not _serve(working[connection], desk, self._stay):
                    del working[connection]


def _serve(worker: _Worker, desk: Counter, stay: bool) -> bool:
    """Answers one message; False if the worker has no more to do, and waits for the answer if it is to stay."""
    message = worker.receive()
    answer = desk.answer(worker.number, message)
    worker.waits = stay and answer == ("stop",)
    if message[0] in ASKS and not worker.waits:
        assert answer is not None
        worker.send(answer)
    return answer != ("stop",)


def _end_of(worker: _Worker) -> Exception:
    """What its end is to the sweep, from how it ended and from what it wrote."""
    try:
        status = worker.process.wait(5.0)
    except subprocess.TimeoutExpired:
        status = 0
    while True:  # what is left in the pipe
        before = worker.last_words
        if not worker.listen() or worker.last_words == before:
            break
    await_signal(status)
    why = reason(status, worker.last_words.decode(errors="replace"))
    if status in MACHINE_CODE and forget_programs():
        why += ", and the compiled programs that were kept are gone, in case that one of them was the cause: try again"
    return Failure(f"a worker process {why}")


def _start(number: int, environment: dict[str, str]) -> _Worker:
    opened = ExitStack()
    try:
        ours, theirs = map(opened.enter_context, Pipe())
        errors, written = os.pipe()
        for descriptor in (errors, written):
            opened.callback(os.close, descriptor)
        process = subprocess.Popen(
            script(served.__file__, str(theirs.fileno()), str(os.getpid())),
            pass_fds=[theirs.fileno()],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=written,
            process_group=0,  # Ctrl-C is for the parent alone, also while a worker is still importing
        )
    except OSError as error:
        opened.close()
        raise not_started(error) from None
    opened.pop_all()
    theirs.close()
    os.close(written)
    os.set_blocking(errors, False)
    return _Worker(number, ours, process, errors)
