"""Worker processes, and who gets which cell. Loads no jax."""

import dataclasses
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterable
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import Any

from gpcjax.envs.registry import on_host
from gpcjax.sweep.environment import worker_environment
from gpcjax.sweep.plan import Cell, Program, program_of
from gpcjax.sweep.store import CellRows

BATCH = 16
"""Cells handed out at once, at most."""

JOIN = 48
"""A program that another worker already runs must have this many cells left to be worth compiling a second time.

Where the host simulates, a few are enough: their steps take longer than any compilation.
"""


@dataclasses.dataclass
class Totals:
    """What all workers have done, for the progress bar and the manifest."""

    env_steps: int = 0
    episodes: int = 0
    compile_seconds: float = 0.0
    compilations: int = 0


@dataclasses.dataclass
class _Worker:
    connection: Connection
    process: subprocess.Popen[bytes]
    program: Program | None = None
    given: int = 0
    """Cells of this program that it has been given."""
    progress: Any = None


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
        self._baselines = deque(baselines)
        count = sum(map(len, self._programs.values()))
        self._jobs = max(1, min(jobs, count or 1))
        self._on_rows, self._on_baseline, self._on_progress = on_rows, on_baseline, on_progress
        self._workers: list[_Worker] = []

    def run(self) -> None:
        """Returns when all is done. Workers never outlive this call.

        Raises:
            RuntimeError: a worker failed; the message has its reason.
        """
        try:
            self._workers = [_start() for _ in range(self._jobs)]
            working = {worker.connection: worker for worker in self._workers}
            while working:
                for connection in wait(list(working)):
                    assert isinstance(connection, Connection)
                    if not self._serve(working[connection]):
                        del working[connection]
        finally:
            for worker in self._workers:
                worker.connection.close()
                worker.process.kill()
                worker.process.wait()

    def _serve(self, worker: _Worker) -> bool:
        """Answers one message; False if the worker has no more to do."""
        try:
            message = worker.connection.recv()
        except (EOFError, ConnectionResetError):
            status = worker.process.wait()
            raise RuntimeError(
                f"a worker process ended with status {status}, perhaps for want of memory"
            ) from None
        match message:
            case ("ready",):
                answer = self._next_program(worker)
                worker.connection.send(answer)
                return answer[0] != "stop"
            case ("next",):
                worker.connection.send(("cells", self._next_cells(worker)))
            case ("rows", CellRows() as rows):
                self._on_rows(rows)
            case ("baseline", name, numbers):
                self._on_baseline(name, numbers)
            case ("progress", progress):
                worker.progress = progress
                self._on_progress(self._totals())
            case ("failed", text):
                raise RuntimeError(f"a worker process failed:\n{text}")
        return True

    def _next_program(self, worker: _Worker) -> tuple[Any, ...]:
        worker.program, worker.given = None, 0
        if self._baselines and worker is self._workers[-1]:
            return ("baseline", *self._baselines.popleft())
        taken = {other.program for other in self._workers}
        free = [key for key, cells in self._programs.items() if cells and key not in taken]
        shared = [
            key for key, cells in self._programs.items() if len(cells) >= (1 if on_host(key.env) else JOIN)
        ]
        if not free and not shared:
            return ("stop",)
        # In order, but a worker that must share takes what has most left.
        worker.program = free[0] if free else max(shared, key=lambda key: len(self._programs[key]))
        return ("program", self._programs[worker.program][0])

    def _next_cells(self, worker: _Worker) -> list[Cell]:
        assert worker.program is not None
        cells = self._programs[worker.program]
        share = min(max(1, min(BATCH, len(cells) // (4 * self._jobs))), len(cells))
        if on_host(worker.program.env):
            # Runs of minutes: a worker leaves the others their part, even where its first block could take it all.
            share = min(share, -(-self._sizes[worker.program] // self._jobs) - worker.given)
        worker.given += share
        return [cells.popleft() for _ in range(share)]

    def _totals(self) -> Totals:
        done = [worker.progress for worker in self._workers if worker.progress is not None]
        return Totals(
            *(sum(getattr(progress, field.name) for progress in done) for field in dataclasses.fields(Totals))
        )


def run_alone(module: str, *words: str) -> int:
    """`python -m module words` on one thread, as workers compute; gives its exit status."""
    command = [sys.executable, "-m", module, *words]
    return subprocess.run(command, env=worker_environment(), check=False).returncode


def _start() -> _Worker:
    ours, theirs = Pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", "gpcjax.sweep.worker", str(theirs.fileno())],
        pass_fds=[theirs.fileno()],
        env=worker_environment(),
        stdin=subprocess.DEVNULL,
        process_group=0,  # Ctrl-C is for the parent alone, also while a worker is still importing
    )
    theirs.close()
    return _Worker(ours, process)
