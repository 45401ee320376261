"""What a worker does, wherever it runs: it asks for programs and cells, and hands in rows.

What it says and what it is answered is listed in `gpcjax.sweep.executors.base`.
"""

import ctypes
import dataclasses
import gc
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np

from gpcjax.engine.block import Counters
from gpcjax.engine.evaluate import evaluate, idle
from gpcjax.engine.identity import Unknown, digest
from gpcjax.engine.pace import Pace
from gpcjax.engine.pool import Pool
from gpcjax.envs.base import Env
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.errors import ForeignError, UserError
from gpcjax.registry import resolve
from gpcjax.sweep.build import make_pool
from gpcjax.sweep.digests import ENTRY as DIGESTS
from gpcjax.sweep.digests import Loaded
from gpcjax.sweep.environment import programs_folder, refuse_another_environment
from gpcjax.sweep.executables import Executables
from gpcjax.sweep.executors.base import COUNTS, Message, Orders, Say, Totals
from gpcjax.sweep.executors.starting import FEWER, NO_MEMORY
from gpcjax.sweep.keeping import Keeping
from gpcjax.sweep.plan import Cell, Program, program_of
from gpcjax.sweep.rehearsal import check_columns
from gpcjax.sweep.runs import Runs

REPORT_SECONDS = 0.25
BASELINE_STARTS = 100


def work(say: Say) -> bool:
    """Works until it is told to stop; False if it failed, which it has said then.

    Args:
        say: takes a message to the desk and gives its answer. What it raises is let through.
    """
    worker = _Worker(say)
    try:
        with telling_of_compilations(say):
            refuse_another_environment()
            worker.run()
    except Exception as error:
        if error is worker.unheard:
            raise
        say(last_word(error))
        return False
    return True


class _Worker:
    """What one worker has done."""

    def __init__(self, say: Say):
        self._to_desk = say
        self.unheard: BaseException | None = None
        """What the desk, or the way to it, raised: no error of the worker's own."""
        self._done = Totals()
        self._before = Counters()
        """What the pool that it runs had done before."""
        self._paces_before: tuple[Pace, ...] = ()
        self._reported = 0.0
        self._compiled = 0
        self._pool: tuple[tuple[Program, Keeping | None], Pool] | None = None
        """The last one, and what it is for: a worker that stays may be asked for more of the same."""
        self._code = Loaded()
        folder = programs_folder()
        self._programs = None if folder is None else Executables(folder)

    def run(self) -> None:
        """Until the desk says stop."""
        while True:
            match self._say(("ready",)):
                case ("program", Cell() as cell, Orders() as orders):
                    self._teach(cell, orders)
                    give_back_memory()
                case ("baseline", str() as env, str() as name):
                    self._say(("baseline", name, baseline(env, name, self._programs)))
                case ("errand", str() as function, tuple() as words):
                    resolve(function)(*words)
                    give_back_memory()
                    self._say(("errand", function))
                case ("again",):
                    self._done = Totals()
                case _:
                    return

    def _teach(self, first: Cell, orders: Orders) -> None:
        pool = self._pool_for(first, orders.keeping)
        self._code.refuse_other(first, orders.agree.get(DIGESTS, {}))
        check_columns(first, pool.template.learner, orders.varying)
        runs = Runs(pool, orders, self._say)
        self._before, self._paces_before = dataclasses.replace(pool.counters), pool.paces()
        self._compiled = pool.counters.compilations

        def look() -> None:
            self._look(pool)
            runs.save()

        pool.run(runs.next_start, runs.deliver, look, runs.keep)
        runs.close()
        self._done = self._progress(pool)
        self._say(("progress", self._done))

    def _pool_for(self, first: Cell, keeping: Keeping | None) -> Pool:
        wanted = program_of(first), keeping
        if self._pool is None or self._pool[0] != wanted:
            self._pool = None  # its memory first
            self._pool = wanted, make_pool(first, keeping, self._programs, keeping is not None)
        return self._pool[1]

    def _look(self, pool: Pool) -> None:
        if pool.counters.compilations > self._compiled:
            self._compiled = pool.counters.compilations
            give_back_memory()
        if time.monotonic() - self._reported > REPORT_SECONDS:
            self._reported = time.monotonic()
            self._say(("progress", self._progress(pool)))

    def _progress(self, pool: Pool) -> Totals:
        done, before, counters = self._done, self._before, pool.counters
        paces = zip(pool.paces(), self._paces_before, strict=True)
        return Totals(
            *(getattr(done, name) + getattr(counters, name) - getattr(before, name) for name in COUNTS),
            processor_seconds=time.process_time(),
            paces=tuple(now.since(before) for now, before in paces),
        )

    def _say(self, message: Message) -> Message | None:
        try:
            return self._to_desk(message)
        except BaseException as error:
            self.unheard = error
            raise


def give_back_memory() -> None:
    """Returns what compilations and pools have left: hundreds of MiB, which the allocator would keep."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
    if trim is not None:
        trim(0)


def baseline(env_name: str, name: str, kept: Executables | None = None) -> dict[str, float]:
    """Return of the idle policy or of an expert: mean and standard deviation over `n` starts.

    To trace it takes half a second, for numbers that are always the same: they are looked for in `kept`, and go there.
    """
    env = make_env(env_name)
    policy = idle(env) if name == "idle" else make_expert(env_name, name)
    key = None if kept is None else _key_of(env, name if name == "idle" else policy)
    if kept is not None and key is not None and (known := kept.numbers(key)) is not None:
        return known
    returns = np.asarray(evaluate(env, policy, BASELINE_STARTS).returns)
    numbers = {"mean": float(returns.mean()), "std": float(returns.std(ddof=1)), "n": BASELINE_STARTS}
    if kept is not None and key is not None:
        kept.keep_numbers(key, numbers)
    return numbers


def _key_of(env: Any, policy: Any) -> str | None:
    """A digest of all that a baseline depends on; None where that is somebody else's code."""
    if not isinstance(env, Env):
        return None
    try:
        return digest(("baseline", BASELINE_STARTS, env, policy), ())
    except Unknown:
        return None


def last_word(error: Exception) -> Message:
    """What a worker that ends by an error says of it: whose it is, and which."""
    match error:
        case ForeignError():
            return ("theirs", *error.arguments)
        case UserError():
            return ("refused", " ".join(str(error).split()))
    return ("failed", *told(error))


def told(error: Exception) -> tuple[str, str]:
    """An error in one line, and its full text where it is no fault of the machine."""
    text = " ".join(str(error).split())
    line = f"{type(error).__name__}{f': {text[:300]}' if text else ''}"
    if isinstance(error, MemoryError) or NO_MEMORY.search(str(error)):
        return line + FEWER, ""
    return line, "" if isinstance(error, OSError) else "".join(traceback.format_exception(error))


@contextmanager
def telling_of_compilations(say: Say) -> Iterator[None]:
    """Sends word when XLA begins with a program and when it is there; one from the cache takes a moment only."""
    thread = threading.get_ident()  # others of this process may compile as well

    def hear(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if threading.get_ident() != thread:
            return
        if event == "/jax/core/compile/jaxpr_to_mlir_module_duration":  # what comes before
            say(("compiling", True))
        elif event == "/jax/core/compile/backend_compile_duration":
            say(("compiling", False))

    jax.monitoring.register_event_duration_secs_listener(hear)
    try:
        yield
    finally:
        jax.monitoring.unregister_event_duration_listener(hear)
