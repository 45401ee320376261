"""A process that runs cells: it asks for programs and cells over a connection, and sends rows back.

Started by `gpcjax.sweep.executors` as `python -m gpcjax.sweep.worker DESCRIPTOR`. It computes on one thread, whatever
the number of processes: XLA's arithmetic may depend on how it splits work.

Messages to the parent: ("ready",), ("next", cells wanted), ("rows", CellRows), ("progress", Totals),
("compiling", whether), ("baseline", name, numbers), ("failed", line, full text or ""). Answers: ("program", Cell),
("cells", list of Cell, empty if there are no more), ("baseline", env, name), ("stop",).
"""

import ctypes
import gc
import os
import signal
import sys
import time
import traceback
from collections import deque
from multiprocessing.connection import Connection

import jax
import numpy as np

from gpcjax.engine.evaluate import evaluate, idle
from gpcjax.engine.lanes import Lane
from gpcjax.engine.pool import Finished, Pool, Start
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.errors import UserError
from gpcjax.learners.base import Status
from gpcjax.sweep import stopping
from gpcjax.sweep.build import make_pool, start_of
from gpcjax.sweep.executors import FEWER, NO_MEMORY, Totals
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.store import CellRows

REPORT_SECONDS = 0.25
BASELINE_STARTS = 100


class Worker:
    """One connection's work."""

    def __init__(self, connection: Connection):
        self._connection = connection
        self._done = Totals()
        self._reported = 0.0
        self._compiled = 0

    def run(self) -> None:
        """Serves until the parent says stop."""
        while True:
            match self._ask("ready"):
                case ("program", Cell() as cell):
                    self._teach(cell)
                    give_back_memory()
                case ("baseline", str() as env, str() as name):
                    self._connection.send(("baseline", name, baseline(env, name)))
                case _:
                    return

    def _teach(self, first: Cell) -> None:
        pool = make_pool(first)
        cells: deque[Cell] = deque()

        def next_start() -> Start | None:
            if not cells:
                cells.extend(self._ask("next")[1])
            return start_of(cells.popleft()) if cells else None

        def deliver(finished: Finished) -> None:
            self._connection.send(("rows", rows_of(finished.name, finished.lane)))

        self._compiled = 0
        pool.run(next_start, deliver, lambda: self._look(pool))
        self._done = self._progress(pool)
        self._connection.send(("progress", self._done))

    def _look(self, pool: Pool) -> None:
        if pool.counters.compilations > self._compiled:
            self._compiled = pool.counters.compilations
            give_back_memory()
        if time.monotonic() - self._reported > REPORT_SECONDS:
            self._reported = time.monotonic()
            self._connection.send(("progress", self._progress(pool)))

    def _progress(self, pool: Pool) -> Totals:
        done, counters = self._done, pool.counters
        return Totals(
            done.env_steps + counters.env_steps,
            done.episodes + counters.episodes,
            done.compile_seconds + counters.compile_seconds,
            done.compilations + counters.compilations,
        )

    def _ask(self, question: str) -> tuple:
        self._connection.send((question,))
        return self._connection.recv()


def give_back_memory() -> None:
    """Returns what compilations and pools have left: hundreds of MiB, which the allocator would keep."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
    if trim is not None:
        trim(0)


def rows_of(cell: Cell, lane: Lane) -> CellRows:
    """What is stored of a finished lane: an episode that never began has no row.

    One that was over before its first step, as its start or the action there was no number, has a row, with NaN.
    """
    began = np.flatnonzero((lane.rows.length > 0) | np.isnan(lane.rows.returns))
    status = [Status.OK.label] * len(began)
    if began.size:
        status[-1] = Status(int(lane.status)).label
    measured = {name: value for name, value in vars(lane.rows).items() if name != "own"}
    episodes, own = (
        {name: np.asarray(value)[began] for name, value in values.items()}
        for values in (measured, lane.rows.own)
    )
    logged = int(lane.log.count)
    corrections = {
        name: np.asarray(getattr(lane.log, name))[:logged] for name in ("where", "values", "outcome")
    }
    return CellRows(
        cell=cell, episode=began + 1, status=status, episodes=episodes, corrections=corrections, own=own
    )


def baseline(env_name: str, name: str) -> dict[str, float]:
    """Return of the idle policy or of an expert: mean and standard deviation over `n` starts."""
    env = make_env(env_name)
    policy = idle(env) if name == "idle" else make_expert(env_name, name)
    returns = np.asarray(evaluate(env, policy, BASELINE_STARTS).returns)
    return {"mean": float(returns.mean()), "std": float(returns.std(ddof=1)), "n": BASELINE_STARTS}


def main() -> None:
    """Serves the connection whose descriptor is the one argument."""
    for number in stopping.SIGNALS:  # they go to the parent, which says when to stop
        signal.signal(number, signal.SIG_IGN)
    die_with_parent()
    connection = Connection(int(sys.argv[1]))
    tell_of_compilations(connection)
    try:
        Worker(connection).run()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(1)  # the parent is gone
    except Exception as error:
        connection.send(("failed", *told(error)))
        raise SystemExit(1) from None


def told(error: Exception) -> tuple[str, str]:
    """An error in one line, and its full text where it is no fault of the machine."""
    text = " ".join(str(error).split())
    line = f"{type(error).__name__}{f': {text[:300]}' if text else ''}"
    if isinstance(error, MemoryError) or NO_MEMORY.search(str(error)):
        return line + FEWER, ""
    return line, "" if isinstance(error, OSError | UserError) else "".join(traceback.format_exception(error))


def tell_of_compilations(connection: Connection) -> None:
    """Sends word when XLA begins with a program and when it is there; one from the cache takes a moment only."""

    def hear(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == "/jax/core/compile/jaxpr_to_mlir_module_duration":  # what comes before
            connection.send(("compiling", True))
        elif event == "/jax/core/compile/backend_compile_duration":
            connection.send(("compiling", False))

    jax.monitoring.register_event_duration_secs_listener(hear)


def die_with_parent() -> None:
    """Has the kernel kill this process when its parent ends, where it can: during a compilation nobody looks."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)  # Linux alone has it
    if prctl is not None:
        prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


if __name__ == "__main__":
    main()
