"""A worker on another machine: a process that computes, and the one beside it that carries its words. Loads no jax.

The process is that of `gpcjax.sweep.executors.processes`, with its environment: what carries the words (Ray's worker)
may have loaded numpy long ago, and survives machine code that ends the process, so that its reason can be told.

Words travel together: everything that was said since is fetched at once, at the latest after `patience` seconds, and
at once when an answer is wanted. Of several reports of progress the last one goes; of rows tables are made here.
"""

import contextlib
import dataclasses
import fcntl
import json
import os
import pickle
import shutil
import socket
import tempfile
import time
from collections.abc import Sequence
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from gpcjax import elsewhere
from gpcjax.sweep import machine
from gpcjax.sweep.blocks import block_of
from gpcjax.sweep.environment import worker_environment
from gpcjax.sweep.executors.base import ASKS, Message, Orders
from gpcjax.sweep.executors.processes import _end_of, _start, _Worker
from gpcjax.sweep.layout import is_checkpoint
from gpcjax.sweep.parcel import CODE, Parcel, pack, unpack
from gpcjax.sweep.parts import names_in
from gpcjax.sweep.versions import source_digest, versions

LAST = ("failed", "refused", "theirs", "ended")
"""First words of messages after which nothing comes."""


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a worker is."""

    name: str
    versions: dict[str, str]
    source: str
    """`gpcjax.sweep.versions.source_digest`"""
    machine: dict[str, Any]
    """`gpcjax.sweep.machine.describe`"""
    process: int


def place() -> Place:
    """Of this process."""
    return Place(socket.gethostname(), versions(), source_digest(), machine.describe(), os.getpid())


class Remote:
    """Carries the words of one worker.

    Messages are those of `gpcjax.sweep.executors.base`, and two more:

        ("checkpoint", name, archive)   runs under way were saved in a folder of this name
        ("ended", line)                 the process has ended; why

    Args:
        parcel: what the sweep names that may not be on this machine.
        patience: seconds that words wait for others.
    """

    def __init__(self, parcel: Parcel, patience: float):
        self._patience = patience
        _remove_abandoned()
        self._folder, self._lock = _own_folder()
        self._saved = self._folder / "checkpoints"
        self._saved.mkdir()
        self._sent: set[str] = set()
        """Checkpoints that were passed on, or that came from there."""
        self._kind = machine.kind_of(machine.describe())
        environment = worker_environment()
        environment["PYTHONPATH"] += os.pathsep + str(self._folder / CODE)
        environment[elsewhere.VARIABLE] = json.dumps(parcel.open(self._folder))
        self._varying: tuple[str, ...] = ()
        self._worker: _Worker = _start(0, environment)
        self._writes = True

    def hear(self, answer: bytes | None = None) -> bytes:
        """Passes on an answer, then waits for what the worker says: a list of messages, pickled as the answer is."""
        if answer is not None:
            self._pass_on(*pickle.loads(answer))
        heard: list[Message] = []
        until = time.monotonic() + self._patience
        while not heard or heard[-1][0] not in (*ASKS, *LAST):
            left = until - time.monotonic()
            if left <= 0:
                break
            sources = [self._worker.connection, *([self._worker.errors] if self._writes else [])]
            ready = wait(sources, left)
            if self._worker.errors in ready:
                self._writes = self._worker.listen()
            if self._worker.connection in ready:
                message = self._receive()
                if message[0] == "progress":
                    heard = [each for each in heard if each[0] != "progress"]
                heard.append(message)
        said = [*self._checkpoints(), *together(heard, self._varying)]
        for name in (message[1] for message in heard if message[0] == "over"):
            shutil.rmtree(self._saved / name, ignore_errors=True)
        return pickle.dumps(said, protocol=5)

    def close(self) -> None:
        """Ends the process, and removes its folder."""
        self._worker.end()
        shutil.rmtree(self._folder, ignore_errors=True)
        os.close(self._lock)

    def _receive(self) -> Message:
        try:
            return self._worker.connection.recv()
        except (EOFError, ConnectionError):
            return ("ended", str(_end_of(self._worker)))

    def _pass_on(self, answer: Message, archives: dict[str, bytes]) -> None:
        """To the worker: what it is told of its folder is this machine's, with the checkpoints that it may need."""
        for name, archive in archives.items():
            unpack(archive, self._saved)
            self._sent.add(name)
        if isinstance(orders := answer[-1], Orders):
            self._varying = orders.varying
            agree = {**orders.agree, "machine": self._kind} if orders.agree else {}
            local = None if orders.checkpoints is None else str(self._saved)
            answer = (*answer[:-1], dataclasses.replace(orders, checkpoints=local, agree=agree))
        with contextlib.suppress(OSError):  # it has ended: that is heard next
            self._worker.connection.send(answer)

    def _checkpoints(self) -> list[Message]:
        """Those that have come since: the newest, as it holds all runs that are under way."""
        new = [name for name in names_in(self._saved) if is_checkpoint(name) and name not in self._sent]
        self._sent.update(new)
        if not new:
            return []
        try:
            return [("checkpoint", new[-1], pack([(self._saved / new[-1], new[-1])]))]
        except (OSError, ValueError):  # the worker has just put another one in its place
            return []


def together(heard: Sequence[Message], varying: Sequence[str]) -> list[Message]:
    """The messages, with the rows of all cells in them as one block; these come first."""
    rows = [message[1] for message in heard if message[0] == "rows"]
    others = [message for message in heard if message[0] != "rows"]
    return [("rows", block_of(rows, varying)), *others] if rows else others


_PREFIX, _LOCK = "gpcjax-worker-", "lock"


def _own_folder() -> tuple[Path, int]:
    """A folder of this worker, and the descriptor of its lock, which ends with this process however that ends."""
    folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
    unseen = folder / f".{_LOCK}"
    lock = os.open(unseen, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    fcntl.flock(lock, fcntl.LOCK_EX)
    unseen.rename(folder / _LOCK)  # nobody sees it before it is locked
    return folder, lock


def _remove_abandoned() -> None:
    """The folders of workers that were killed: their locks are free."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):  # somebody else's, or it is just going, or its worker is there
            lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CLOEXEC)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)
