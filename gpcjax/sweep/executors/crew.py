"""The workers of a sweep in a Ray, from the desk's side: who they are, what they say, what becomes of what one had.

Loads no jax, and no Ray.
"""

import contextlib
import dataclasses
import pickle
import queue
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpcjax.errors import Failure, UserError
from gpcjax.sweep import stopping
from gpcjax.sweep.checkpoints import Place, receive
from gpcjax.sweep.executors.base import ASKS, Message, Orders
from gpcjax.sweep.executors.desk import Desk
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


@dataclasses.dataclass(eq=False)
class Member:
    """A worker as the desk's side knows it."""

    number: int
    actor: Any
    machine: Machine | None = None
    """Where it is; None until it has a place."""
    busy: bool = False
    """Whether it has been given something to do; else nobody waits for it once all is done."""
    has: set[str] = dataclasses.field(default_factory=set)
    """Checkpoints that lie where it is."""
    closing: Any = None
    """What tells that it has cleared up."""


class Crew:
    """All workers of one sweep, by their numbers."""

    def __init__(self, ray: Any, desk: Desk):
        self._ray, self._desk = ray, desk
        self._parcel = ray.put(parcel_of(desk.cells))
        self._class = ray.remote(Actor)
        self._members: dict[int, Member] = {}
        self._heard: queue.SimpleQueue[tuple[Member, Any]] = queue.SimpleQueue()
        """What calls have come to: each member, and a future that is done."""
        self._leaving: list[Member] = []
        """Workers that have no more to do, and clear up what is theirs."""
        self._losses = dict.fromkeys(range(desk.workers), 0)
        self._saved: dict[int, tuple[str, Mapping[Cell, Place]]] = {}
        """The last checkpoint of each worker, and where its runs are."""
        self._versions, self._source = versions(), source_digest()
        self._here = kind_of(place().machine)
        self._told: dict[str, float] = {}

    def serve(self) -> None:
        """Until all rows have come, and nobody is busy any more but with what came from others."""
        self._desk.give_copies()
        for number in range(self._desk.workers):
            self._hire(number)
        idle = time.monotonic()
        done = None
        while True:
            if self._desk.done:
                done = done or time.monotonic()
                # One that hangs may have taken no cell yet: nobody waits long for last words.
                if (
                    not any(map(self._is_awaited, self._members.values()))
                    or time.monotonic() > done + CLOSING
                ):
                    return
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
            if member in self._leaving:
                self._leaving.remove(member)
                self._kill(member)  # its core is free for others then
            elif self._members.get(member.number) is member:  # else it is gone, and so are its words
                self._take(member, future)

    def dismiss(self) -> None:
        """Ends all that are there; those that have a place clear it up before.

        Nobody waits for the ends of Ray's own processes, which take seconds.
        """
        with contextlib.suppress(Exception):  # Ray itself may be gone
            placed = [member for member in self._members.values() if member.machine is not None]
            closing = [member.actor.close.remote() for member in placed]
            closing += [member.closing for member in self._leaving]
            if closing:
                self._ray.wait(closing, num_returns=len(closing), timeout=CLOSING)
        for member in (*self._members.values(), *self._leaving):
            self._kill(member)
        self._members, self._leaving = {}, []

    def _is_awaited(self, member: Member) -> bool:
        return member.busy and not self._desk.is_late(member.number)

    def _at_work(self) -> bool:
        return any(member.machine is not None for member in self._members.values())

    def _hire(self, number: int) -> None:
        """Asks for a worker, which begins as soon as a machine has a core for it."""
        patience = max(LOOK_SECONDS, self._desk.workers / CALLS_PER_SECOND)
        actor = self._class.options(num_cpus=1, max_restarts=0, max_task_retries=0).remote()
        member = self._members[number] = Member(number, actor)
        self._call(member, actor.begin.remote(self._parcel, patience))

    def _call(self, member: Member, reference: Any) -> None:
        reference.future().add_done_callback(lambda future: self._heard.put((member, future)))

    def _take(self, member: Member, future: Any) -> None:
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
            self._leaving.append(member)
            member.closing = member.actor.close.remote()
            self._call(member, member.closing)
            return
        self._call(member, member.actor.hear.remote(answer and self._packed(member, answer)))

    def _welcome(self, member: Member, there: Machine) -> None:
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
        member.machine = there
        if kind_of(there.machine) != self._here:
            self._desk.answer(member.number, ("machine", there.machine))

    def _packed(self, member: Member, answer: Message) -> bytes:
        """An answer, and the checkpoints from which its cells go on, which are of this kind of machine."""
        archives: dict[str, bytes] = {}
        folder = self._desk.orders.checkpoints
        if isinstance(orders := answer[-1], Orders):
            least = self._desk.workers / SAVES_PER_SECOND
            seconds = max(orders.seconds, least) if orders.seconds else 0.0
            answer = (*answer[:-1], dataclasses.replace(orders, seconds=seconds))
        elif answer[0] == "cells" and len(answer) == 3:
            wanted = {there.folder for there in answer[2].values()} - member.has
            if folder is not None:
                with contextlib.suppress(UserError):  # then their runs begin anew, with a line
                    archives = {name: pack([(Path(folder) / name, name)]) for name in wanted}
            member.has |= archives.keys()
        return pickle.dumps((answer, archives), protocol=5)

    def _save(self, member: Member, name: str, archive: bytes) -> None:
        """Writes the checkpoint of a worker in the place of the one before."""
        if self._desk.orders.checkpoints is None:
            return
        folder = Path(self._desk.orders.checkpoints)
        try:
            places = receive(folder.parent, name, lambda parts: unpack(archive, parts))
        except (OSError, UserError, KeyError, TypeError, ValueError) as error:
            self._desk.answer(member.number, ("note", f"no checkpoint: {error}"))
            return
        member.has.add(name)
        before, _ = self._saved.get(member.number, ("", {}))
        self._saved[member.number] = name, places
        if before:
            shutil.rmtree(folder / before, ignore_errors=True)

    def _lose(self, member: Member, why: str) -> None:
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

    def _kill(self, member: Member) -> None:
        with contextlib.suppress(Exception):  # it is gone, or Ray is
            self._ray.kill(member.actor)

    def _tell(self, what: str, line: str) -> None:
        """A line for the person; one for many workers of a machine that go together."""
        now = time.monotonic()
        if now - self._told.get(what, -60.0) >= 60.0:
            self._told[what] = now
            self._desk.answer(0, ("note", line))


class Actor:
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
        """Ends the process, and removes what was its own; this one is killed then."""
        if self._remote is not None:
            self._remote.close()


def _reason(error: Exception) -> str:
    """Why a call did not come back, in a line."""
    cause = getattr(error, "cause", None)
    lines = [line.strip() for line in str(cause or error).splitlines() if line.strip()]
    return (lines[0] if lines else type(error).__name__)[:200]
