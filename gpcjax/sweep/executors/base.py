"""What an executor is, and what is said between workers and the desk at which they ask. Loads no jax.

An executor runs `gpcjax.sweep.worker.work(say)` for each worker, somewhere, and takes what the worker says to
`Desk.answer`. Messages of a worker, all of which can be pickled:

    ("begun", seconds, core's, piece)
                                 took so long to import what it needs, so much of a core for it, and so much for a
                                 `piece_of_work`: only of a process of its own, once
    ("ready",)                   has nothing to do; answer: ("program", Cell, Orders), ("baseline", env, name),
                                 ("errand", function, words), ("stop",), or ("again",): this is another sweep, say it
                                 again
    ("next",)                    wants cells of its program; answer: ("cells", list of Cell), empty at the end, and a
                                 third entry {Cell: Place} where runs of these can go on
    ("machine", description)     computes on this machine (`gpcjax.sweep.machine.describe`): first of all, and only
                                 from another one than the desk's
    ("rows", CellRows | Block)   has finished a cell, or some
    ("over", name)               of all runs in the checkpoint of this name the rows were said
    ("baseline", name, numbers)  has measured an idle policy or an expert
    ("errand", function)         has called this function
    ("progress", Totals)         has done so much so far; some times a second
    ("compiling", whether)       XLA begins with a program, or has it
    ("note", line)               has something to tell the person
    ("failed", line, text)       its last word: an error in one line, and its full text or ""
    ("refused", line)            its last word: what a person asked for cannot be done, as a `UserError` says it
    ("theirs", ...)              its last word: the arguments of a `ForeignError`

Only those of `ASKS` are answered; the answer to all others is None, and nothing needs to be sent back.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from gpcjax.engine.pace import Pace
from gpcjax.sweep.keeping import Keeping
from gpcjax.sweep.works import Work

if TYPE_CHECKING:
    from gpcjax.sweep.executors.desk import Desk

ASKS = ("ready", "next")
"""The first words of messages that are answered."""

Message = tuple[Any, ...]
Say = Callable[[Message], Message | None]
"""How a worker speaks: it gives the answer to what is asked."""


@dataclasses.dataclass
class Totals:
    """What all workers have done, for the progress bar and the manifest."""

    env_steps: int = 0
    episodes: int = 0
    compile_seconds: float = 0.0
    compilations: int = 0
    kept: int = 0
    """Of these programs, those that are kept, so that nobody compiles them again."""
    processor_seconds: float = 0.0
    """Of a worker's process, since it began."""
    paces: tuple[Pace, ...] = ()
    """How fast a worker is at its program, by tier, and what it has left there."""
    works: tuple[Work, ...] = ()
    """What has been done for each program. Workers send none, they are reckoned here."""
    compiling: bool = False
    """Whether a worker has been compiling for a while."""

    def plus(self, more: "Totals", sign: int = 1) -> "Totals":
        """What was done in both, or with -1 in this one beyond the other; nothing but counts and compile seconds."""
        return Totals(*(getattr(self, name) + sign * getattr(more, name) for name in COUNTS))


COUNTS = ("env_steps", "episodes", "compile_seconds", "compilations", "kept")
"""The first of its fields, which add up; the counters of a pool have them, too."""


@dataclasses.dataclass(frozen=True)
class Orders:
    """What a worker is to do beside the rows of a program."""

    keeping: Keeping | None = None
    """What is kept of each run."""
    checkpoints: str | None = None
    """The folder for runs that are under way, where workers reach it; None for no checkpoints."""
    seconds: float = 0.0
    """Between two checkpoints."""
    agree: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """What runs must agree in to go on (`gpcjax.sweep.checkpoints.told`)."""
    varying: tuple[str, ...] = ()
    """Settings with more than one value in the folder that rows go to: they are columns of its tables."""


NO_ORDERS = Orders()
"""Nothing but the rows."""


class Counter(Protocol):
    """Where workers ask: the desk of a sweep, or what stands before several of them."""

    @property
    def workers(self) -> int:
        """How many there is work for."""
        ...

    def answer(self, worker: int, message: Message) -> Message | None:
        """The answer to what this worker says; None where it asks nothing."""
        ...

    def look(self) -> None:
        """Nothing comes, time goes on: tell of the progress."""
        ...


@runtime_checkable
class Executor(Protocol):
    """Runs the workers of a sweep: all that differs between threads, processes and machines.

    A worker computes where the environment is `worker_environment()`, and refuses otherwise: rows must not depend on
    who ran it.
    """

    @property
    def jobs(self) -> int:
        """Workers at once, at most; the desk says how many there is work for."""
        ...

    def run(self, desk: "Desk") -> None:
        """Run workers 0 to `desk.workers - 1` until each of them has been told to stop. None outlives this call.

        Each message goes to `desk.answer(worker, message)`, and its answer back. What that raises ends the sweep, and
        is let through. While nothing comes, `desk.look()` is called twice a second.

        Raises:
            Failure: a worker ended or could not be started; the message has its reason.
        """
        ...
