"""Worker processes, and who gets which cell. Loads no jax."""

import dataclasses
import errno
import os
import re
import signal
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import Any

from gpcjax.errors import Failure
from gpcjax.registry import find
from gpcjax.sweep import stopping
from gpcjax.sweep.environment import python, worker_environment
from gpcjax.sweep.plan import Cell, Program, program_of
from gpcjax.sweep.progress import COMPILES_FROM, Work, least_to_join, works_of
from gpcjax.sweep.store import CellRows

BATCH = 16
"""Cells handed out at once, at most."""

LOOK_SECONDS = 0.5
"""Longest time between two reports of progress."""

LAST_WORDS = 8192
"""Bytes that are kept of what a worker writes: the reason of its end stands in the last line."""

FEWER = ", give fewer --jobs or a machine with more memory"

NO_MEMORY = re.compile(
    "MemoryError|bad_alloc|RESOURCE_EXHAUSTED|[Oo]ut of memory|annot allocate memory|Resource temporarily unavailable"
    "|failed to map segment|can't start new thread"
)
"""How libraries say that memory, or room for another thread, was not to be had."""

ASKED_TO_STOP = (-signal.SIGINT, -signal.SIGTERM, -getattr(signal, "SIGHUP", signal.SIGTERM))


@dataclasses.dataclass
class Totals:
    """What all workers have done, for the progress bar and the manifest."""

    env_steps: int = 0
    episodes: int = 0
    compile_seconds: float = 0.0
    compilations: int = 0
    works: tuple[Work, ...] = ()
    """What has been done for each program. Workers send none, they are reckoned here."""
    compiling: bool = False
    """Whether a worker has been compiling for a while."""


@dataclasses.dataclass
class _Worker:
    connection: Connection
    process: subprocess.Popen[bytes]
    errors: int
    """What it writes to stderr can be read here."""
    program: Program | None = None
    given: int = 0
    """Cells of this program that it has been given."""
    progress: Totals = dataclasses.field(default_factory=Totals)
    """What it has done, as far as it has told."""
    heard: float = 0.0
    """When its time was last put down to its program."""
    stepping: bool = False
    """Whether it has made a step in its program."""
    compiling_since: float | None = None
    last_words: bytes = b""
    """The end of what it has written."""

    def listen(self) -> bool:
        """Take in what it has written; False if it can write no more."""
        try:
            written = os.read(self.errors, 1 << 16)
        except BlockingIOError:
            return True
        self.last_words = (self.last_words + written)[-LAST_WORDS:]
        return bool(written)

    def end(self) -> None:
        """Kill it, if it has not ended."""
        self.connection.close()
        self.process.kill()
        self.process.wait()
        os.close(self.errors)


class Executors:
    """Runs cells in worker processes.

    Args:
        cells: what to run.
        baselines: (env, name) of idle policies and experts to measure, first.
        jobs: processes.
        on_rows: called with the rows of each finished cell.
        on_baseline: called with the name and the numbers of each baseline.
        on_progress: called with the totals, some times a second.
    """

    def __init__(
        self,
        cells: Iterable[Cell],
        baselines: Iterable[tuple[str, str]],
        jobs: int,
        on_rows: Callable[[CellRows], None],
        on_baseline: Callable[[str, dict[str, float]], None],
        on_progress: Callable[[Totals], None],
    ):
        self._programs: dict[Program, deque[Cell]] = {}
        for cell in cells:
            self._programs.setdefault(program_of(cell), deque()).append(cell)
        self._sizes = {program: len(cells) for program, cells in self._programs.items()}
        self._works = works_of(self._sizes)
        self._baselines = deque(baselines)
        count = sum(map(len, self._programs.values()))
        self._jobs = max(1, min(jobs, count or 1))
        self._on_rows, self._on_baseline, self._on_progress = on_rows, on_baseline, on_progress
        self._workers: list[_Worker] = []

    def run(self) -> None:
        """Returns when all is done. Workers never outlive this call.

        Raises:
            Failure: a worker failed, ended or could not be started; the message has its reason.
            Stopped: a signal came in, within `stopping.deferred`.
        """
        try:
            environment = worker_environment()
            for _ in range(self._jobs):
                self._workers.append(_start(environment))
            self._serve_all()
        finally:
            for worker in self._workers:
                worker.end()

    def _serve_all(self) -> None:
        """Answers messages until no worker has more to do."""
        working = {worker.connection: worker for worker in self._workers}
        writing = {worker.errors: worker for worker in self._workers}
        stop = stopping.wakeup()
        while working:
            stopping.check()
            ready = wait([*working, *writing, *([] if stop is None else [stop])], LOOK_SECONDS)
            if not ready:  # nothing comes while all of them compile; time goes on
                self._on_progress(self._totals())
            for descriptor in writing.keys() & set(ready):
                if not writing[descriptor].listen():
                    del writing[descriptor]
            for connection in working.keys() & set(ready):
                stopping.check()
                try:
                    more = self._serve(working[connection])
                except (EOFError, ConnectionError):
                    raise _end_of(working[connection]) from None
                if not more:
                    del working[connection]

    def _serve(self, worker: _Worker) -> bool:
        """Answers one message; False if the worker has no more to do."""
        match worker.connection.recv():
            case ("ready",):
                answer = self._next_program(worker)
                worker.connection.send(answer)
                return answer[0] != "stop"
            case ("next",):
                worker.connection.send(("cells", self._next_cells(worker)))
            case ("rows", CellRows() as rows):
                work = self._works[program_of(rows.cell)]
                work.finished += 1
                work.finished_steps += int(rows.episodes["length"].sum())
                work.finished_episodes += len(rows.episode)
                self._on_rows(rows)
            case ("baseline", name, numbers):
                self._on_baseline(name, numbers)
            case ("progress", Totals() as progress):
                self._reckon(worker, progress)
                self._on_progress(self._totals())
            case ("compiling", bool() as compiling):
                worker.compiling_since = time.monotonic() if compiling else None
            case ("failed", line, details):
                raise Failure(f"a worker process failed: {line}", details)
        return True

    def _next_program(self, worker: _Worker) -> tuple[Any, ...]:
        if worker.program is not None:
            self._works[worker.program].workers -= 1
            self._works[worker.program].starting -= not worker.stepping
        worker.program, worker.given = None, 0
        if self._baselines and worker is self._workers[-1]:
            return ("baseline", *self._baselines.popleft())
        taken = {other.program for other in self._workers}
        free = [key for key, cells in self._programs.items() if cells and key not in taken]
        shared = [key for key, cells in self._programs.items() if len(cells) >= least_to_join(key.env)]
        if not free and not shared:
            return ("stop",)
        # In order, but a worker that must share takes what has most left.
        worker.program = free[0] if free else max(shared, key=lambda key: len(self._programs[key]))
        worker.heard = time.monotonic()
        work = self._works[worker.program]
        worker.stepping = False
        work.workers += 1
        work.starting += 1
        work.joined += 1
        return ("program", self._programs[worker.program][0])

    def _next_cells(self, worker: _Worker) -> list[Cell]:
        assert worker.program is not None
        cells = self._programs[worker.program]
        share = min(max(1, min(BATCH, len(cells) // (4 * self._jobs))), len(cells))
        if find("task", worker.program.env).on_host:
            # Runs of minutes: a worker leaves the others their part, even where its first block could take it all.
            share = min(share, -(-self._sizes[worker.program] // self._jobs) - worker.given)
        worker.given += share
        self._works[worker.program].begun += share
        return [cells.popleft() for _ in range(share)]

    def _reckon(self, worker: _Worker, progress: Totals) -> None:
        """Put what a worker has done since it was last heard, and the time, down to its program."""
        before, now = worker.progress, time.monotonic()
        worker.progress = progress
        if worker.program is None:
            return
        work, compiled = self._works[worker.program], progress.compile_seconds - before.compile_seconds
        work.add(progress.env_steps - before.env_steps, progress.episodes - before.episodes, compiled)
        if not worker.stepping and progress.env_steps > before.env_steps:
            worker.stepping = True
            work.starting -= 1
        work.seconds += max(now - worker.heard - compiled, 0.0)
        worker.heard = now

    def _totals(self) -> Totals:
        done = [worker.progress for worker in self._workers]
        long_ago = time.monotonic() - COMPILES_FROM
        return Totals(
            env_steps=sum(progress.env_steps for progress in done),
            episodes=sum(progress.episodes for progress in done),
            compile_seconds=sum(progress.compile_seconds for progress in done),
            compilations=sum(progress.compilations for progress in done),
            works=tuple(self._works.values()),
            compiling=any(
                worker.compiling_since is not None and worker.compiling_since < long_ago
                for worker in self._workers
            ),
        )


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
        raise _not_started(error) from None
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
        _await_signal(status)
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
    _await_signal(status)
    return Failure(f"a worker process {reason(status, worker.last_words.decode(errors='replace'))}")


def _await_signal(status: int) -> None:
    """If one asked a process of ours to stop: sent to all of them, it is on its way to this one as well.

    Raises:
        Stopped: it has come in.
    """
    if status in ASKED_TO_STOP:
        time.sleep(0.2)
        stopping.check()


def _not_started(error: OSError) -> Failure:
    hint = FEWER if error.errno in (errno.ENOMEM, errno.EAGAIN) else ", give fewer --jobs"
    return Failure(f"a worker process could not be started: {error.strerror}{hint}")


def _start(environment: dict[str, str]) -> _Worker:
    opened = ExitStack()
    try:
        ours, theirs = map(opened.enter_context, Pipe())
        errors, written = os.pipe()
        for descriptor in (errors, written):
            opened.callback(os.close, descriptor)
        process = subprocess.Popen(
            python("gpcjax.sweep.worker", str(theirs.fileno())),
            pass_fds=[theirs.fileno()],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=written,
            process_group=0,  # Ctrl-C is for the parent alone, also while a worker is still importing
        )
    except OSError as error:
        opened.close()
        raise _not_started(error) from None
    opened.pop_all()
    theirs.close()
    os.close(written)
    os.set_blocking(errors, False)
    return _Worker(ours, process, errors)
