"""Workers on the machines of a Ray cluster, or of a Ray that is started for one sweep. Loads no jax; Ray when used.

Each worker is an actor that has a core to itself and carries the words of a process (`gpcjax.sweep.executors.remote`).
Rows, baselines and checkpoints come back to the desk as words, so nothing but Ray is shared. Ray says when an actor or
its machine is gone: what it had goes to others, and another actor takes its number, wherever there is room.
"""

import contextlib
import dataclasses
import importlib.util
import logging
import os
import pickle
import queue
import shutil
import signal
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gpcjax.errors import Failure, UserError
from gpcjax.sweep import stopping
from gpcjax.sweep.checkpoints import Place, receive
from gpcjax.sweep.executors.base import ASKS, Desk, Message, Orders
from gpcjax.sweep.executors.remote import Place as Machine
from gpcjax.sweep.executors.remote import Remote, place
from gpcjax.sweep.machine import kind_of
from gpcjax.sweep.parcel import pack, parcel_of, unpack
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.versions import source_digest, versions

LOOK_SECONDS = 0.5
"""Longest time between two reports of progress."""

CALLS_PER_SECOND = 100.0
"""Words of all workers are fetched so often, at most, beside questions: they wait longer where there are many."""

SAVES_PER_SECOND = 4.0
"""Checkpoints of all workers that come in, at most."""

TRIES = 3
"""Losses of one worker in a row, without a row in between, after which the sweep fails."""

PATIENCE = 10.0
"""Seconds without any worker at work until it is said that machines are waited for."""

CLOSING = 3.0
"""Seconds that workers have to clear up at the end."""

_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DEDUP_LOGS": "0",
}
"""Of the environment before Ray is loaded: it reports nothing to anybody, and says nothing on stderr."""

_OBJECTS = 1 << 28
"""Bytes of memory in which a Ray of our own keeps what is sent, at most."""


class Ray:
    """An executor: one actor for each core that it gets of a Ray.

    Args:
        address: of a cluster, "auto" for the one that this machine belongs to or HOST:PORT; None for a Ray on this
            machine, which is started for the sweep and ended after it. A Ray that this process is connected to
            already is used, and left as it is.
        jobs: workers at once; by default one for each core that there is when the sweep begins.

    Raises:
        UserError: Ray is not installed.
    """

    def __init__(self, address: str | None = None, jobs: int | None = None):
        if importlib.util.find_spec("ray") is None:
            raise UserError("engine ray: Ray is not installed: pip install 'gpcjax[cluster]'")
        self._address, self._jobs = address, jobs
        self._ray: Any = None
        self._ours = False

    @property
    def jobs(self) -> int:
        """Workers at once; connects to the cluster where nobody gave a number.

        Raises:
            UserError: no Ray is at the address, or another version of it.
        """
        if self._jobs is None:
            if self._address is None:
                self._jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
            else:
                self._connect()
                self._jobs = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        return self._jobs

    def run(self, desk: Desk) -> None:
        """Returns when all is done. No worker outlives this call.

        Raises:
            UserError: no Ray is at the address; or a machine of it computes with other versions than this one.
            Failure: a worker failed, or was lost again and again.
            Stopped: a signal came in, within `stopping.deferred`.
        """
        try:
            self._connect()
            crew = _Crew(self._ray, desk)
            try:
                crew.serve()
            finally:
                crew.dismiss()
        finally:
            if self._ours:
                self._ray.shutdown()
                self._ray, self._ours = None, False

    def _connect(self) -> None:
        if self._ray is not None:
            return
        ray = _library()
        if not ray.is_initialized():
            own: dict[str, Any] = {
                "num_cpus": self.jobs if self._address is None else None,
                "object_store_memory": _OBJECTS,
                "include_dashboard": False,
                "_node_ip_address": "127.0.0.1",
            }
            options = own if self._address is None else {"address": self._address}
            with _handlers_kept():
                try:
                    ray.init(**options, logging_level=logging.ERROR, log_to_driver=False)
                except (ConnectionError, RuntimeError, ValueError, AssertionError) as error:
                    raise self._unreached(error) from None
            self._ours = True
        self._ray = ray

    def _unreached(self, error: Exception) -> Exception:
        text = " ".join(str(error).split())[:200]
        if self._address is None:
            return Failure(f"Ray cannot be started here: {text}")
        return UserError(
            f"address {self._address}: no Ray that this machine belongs to is there, or one of another version "
            f"({text}): start one with `ray start --head`, and on each further machine `ray start --address HOST:PORT`"
        )


def _library() -> Any:
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import ray

    return ray


@contextlib.contextmanager
def _handlers_kept() -> Iterator[None]:
    """Ray takes the handlers of signals, which are the sweep's."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in stopping.SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclasses.dataclass
class _Member:
    """A worker as the desk's side knows it."""

    number: int
    actor: Any
    machine: Machine | None = None
    """Where it is; None until it has a place."""
    kind: str = ""
    busy: bool = False
    """Whether it has been given something to do; else nobody waits for it once all is done."""
    has: set[str] = dataclasses.field(default_factory=set)
    """Checkpoints that lie where it is."""


class _Crew:
    """All workers of one sweep, by their numbers."""

    def __init__(self, ray: Any, desk: Desk):
        self._ray, self._desk = ray, desk
        self._parcel = ray.put(parcel_of(desk.cells))
        self._class = ray.remote(_Actor)
        self._members: dict[int, _Member] = {}
        self._heard: queue.SimpleQueue[tuple[_Member, Any]] = queue.SimpleQueue()
        """What calls have come to: each member, and a future that is done."""
        self._closing: list[Any] = []
        """What tells that workers which had no more to do are gone."""
        self._losses = dict.fromkeys(range(desk.workers), 0)
        self._saved: dict[int, tuple[str, Mapping[Cell, Place]]] = {}
        """The last checkpoint of each worker, and where its runs are."""
        self._kinds: dict[str, str] = {}
        """The kind of machine of each checkpoint that came in."""
        self._versions, self._source = versions(), source_digest()
        self._here = kind_of(place().machine)
        self._told: dict[str, float] = {}

    def serve(self) -> None:
        """Until all rows have come, and nobody is busy any more."""
        for number in range(self._desk.workers):
            self._hire(number)
        idle = time.monotonic()
        while any(member.busy for member in self._members.values()) or not self._desk.done:
            stopping.check()
            try:
                member, future = self._heard.get(timeout=LOOK_SECONDS)
            except queue.Empty:
                self._desk.look()
                if self._at_work():
                    idle = time.monotonic()
                elif time.monotonic() - idle > PATIENCE:
                    self._tell("waiting", "no machine of the cluster has a free core: waiting for one")
                continue
            if self._members.get(member.number) is member:  # else it is gone, and so are its words
                self._take(member, future)

    def dismiss(self) -> None:
        """Ends all that are there; those that have a place clear it up."""
        placed = [member for member in self._members.values() if member.machine is not None]
        with contextlib.suppress(Exception):
            closing = [*self._closing, *(member.actor.close.remote() for member in placed)]
            if closing:
                self._ray.wait(closing, num_returns=len(closing), timeout=CLOSING)
        for member in self._members.values():
            self._kill(member)
        self._members = {}

    def _at_work(self) -> bool:
        return any(member.machine is not None for member in self._members.values())

    def _hire(self, number: int) -> None:
        """Asks for a worker, which begins as soon as a machine has a core for it."""
        patience = max(LOOK_SECONDS, self._desk.workers / CALLS_PER_SECOND)
        actor = self._class.options(num_cpus=1, max_restarts=0, max_task_retries=0).remote()
        member = self._members[number] = _Member(number, actor)
        self._call(member, actor.begin.remote(self._parcel, patience))

    def _call(self, member: _Member, reference: Any) -> None:
        reference.future().add_done_callback(lambda future: self._heard.put((member, future)))

    def _take(self, member: _Member, future: Any) -> None:
        """Takes what a call has come to: words for the desk, or the loss of who should have said them."""
        try:
            heard = future.result()
        except Exception as error:  # of many kinds, Ray's own and those of the other side
            self._lose(member, _reason(error))
            return
        if isinstance(heard, Machine):
            self._welcome(member, heard)
            self._call(member, member.actor.hear.remote(None))
            return
        answer = None
        for message in pickle.loads(heard):
            match message:
                case ("ended", line):
                    self._lose(member, line)
                    return
                case ("checkpoint", str() as name, bytes() as archive):
                    self._save(member, name, archive)
                case _:
                    if message[0] == "rows":
                        self._losses[member.number] = 0
                    reply = self._desk.answer(member.number, message)
                    answer = reply if message[0] in ASKS else answer
        if answer is not None:
            member.busy = answer != ("stop",)
        if answer == ("stop",):
            del self._members[member.number]
            self._closing.append(member.actor.close.remote())  # its core is free for others then
            return
        self._call(member, member.actor.hear.remote(answer and self._packed(member, answer)))

    def _welcome(self, member: _Member, there: Machine) -> None:
        """Notes where a worker is.

        Raises:
            UserError: it computes with other versions.
        """
        for name, version in self._versions.items():
            if (other := there.versions.get(name)) != version:
                raise UserError(
                    f"machine {there.name}: it has {name} {other}, this one {version}: install the same there"
                )
        if there.source != self._source:
            raise UserError(
                f"machine {there.name}: its gpcjax {self._versions['gpcjax']} is of another source ({there.source}, "
                f"here {self._source}): install the same there"
            )
        member.machine, member.kind = there, kind_of(there.machine)
        if member.kind != self._here:
            self._desk.answer(member.number, ("machine", there.machine))

    def _packed(self, member: _Member, answer: Message) -> bytes:
        """An answer, and the checkpoints from which its cells go on, where these are of this kind of machine."""
        archives: dict[str, bytes] = {}
        folder = self._desk.orders.checkpoints
        if isinstance(orders := answer[-1], Orders):
            least = self._desk.workers / SAVES_PER_SECOND
            seconds = max(orders.seconds, least) if orders.seconds else 0.0
            answer = (*answer[:-1], dataclasses.replace(orders, places={}, seconds=seconds))
        elif answer[0] == "cells" and len(answer) == 3:
            places = {
                cell: there
                for cell, there in answer[2].items()
                if self._kinds.get(there.folder, self._here) == member.kind
            }
            wanted = {there.folder for there in places.values()} - member.has
            if folder is not None:
                with contextlib.suppress(UserError):  # then their runs begin anew, with a line
                    archives = {name: pack([(Path(folder) / name, name)]) for name in wanted}
            member.has |= archives.keys()
            answer = (*answer[:2], places)
        return pickle.dumps((answer, archives), protocol=5)

    def _save(self, member: _Member, name: str, archive: bytes) -> None:
        """Writes the checkpoint of a worker in the place of the one before."""
        if self._desk.orders.checkpoints is None:
            return
        folder = Path(self._desk.orders.checkpoints)
        try:
            places = receive(folder.parent, name, lambda parts: unpack(archive, parts))
        except (OSError, UserError, KeyError, TypeError, ValueError) as error:
            self._desk.answer(member.number, ("note", f"no checkpoint: {error}"))
            return
        self._kinds[name] = member.kind
        member.has.add(name)
        before, _ = self._saved.get(member.number, ("", {}))
        self._saved[member.number] = name, places
        if before:
            shutil.rmtree(folder / before, ignore_errors=True)

    def _lose(self, member: _Member, why: str) -> None:
        """A worker is gone: its cells go to others, and its number to another worker.

        Raises:
            Failure: it was not the first time.
            Stopped: it went as the sweep is to stop.
        """
        stopping.check()
        number = member.number
        _, places = self._saved.pop(number, ("", {}))
        self._desk.lose(number, places)
        self._kill(member)
        del self._members[number]
        self._losses[number] += 1
        name = member.machine.name if member.machine is not None else "the cluster"
        if self._losses[number] > TRIES:
            raise Failure(f"a worker on {name} was lost {TRIES + 1} times: {why}")
        if self._desk.done:
            return
        self._tell(name, f"a worker on {name} is lost, its runs go to others ({why})")
        self._hire(number)

    def _kill(self, member: _Member) -> None:
        with contextlib.suppress(Exception):  # it is gone, or Ray is
            self._ray.kill(member.actor)

    def _tell(self, what: str, line: str) -> None:
        """A line for the person; one for many workers of a machine that go together."""
        now = time.monotonic()
        if now - self._told.get(what, -60.0) >= 60.0:
            self._told[what] = now
            self._desk.answer(0, ("note", line))


class _Actor:
    """What Ray makes on some machine. Nothing of it can fail before it is asked to begin."""

    def __init__(self) -> None:
        self._remote: Any = None

    def begin(self, parcel: Any, patience: float) -> Any:
        """Starts the process; gives where it is."""
        self._remote = Remote(parcel, patience)
        return place()

    def hear(self, answer: bytes | None) -> bytes:
        """See `Remote.hear`."""
        return self._remote.hear(answer)

    def close(self) -> None:
        """Ends the process, and this one."""
        if self._remote is not None:
            self._remote.close()
        _library().actor.exit_actor()


def _reason(error: Exception) -> str:
    """Why a call did not come back, in a line."""
    cause = getattr(error, "cause", None)
    lines = [line.strip() for line in str(cause or error).splitlines() if line.strip()]
    return (lines[0] if lines else type(error).__name__)[:200]
