"""Workers on the machines of a Ray cluster, or of a Ray that is started for one sweep. Loads no jax; Ray when used.

Each worker is an actor that has a core to itself and carries the words of a process (`gpcjax.sweep.executors.remote`).
Rows, baselines and checkpoints come back to the desk as words, so nothing but Ray is shared. Ray says when an actor or
its machine is gone: what it had goes to others, and another actor takes its number, wherever there is room.
"""

import contextlib
import importlib.util
import logging
import os
import signal
import socket
import threading
import warnings
from collections.abc import Iterator
from typing import Any

from gpcjax.errors import Failure, UserError
from gpcjax.installed import require_set_up
from gpcjax.sweep import stopping
from gpcjax.sweep.executors.crew import Crew
from gpcjax.sweep.executors.desk import Desk

START_TRIES = 3
"""Of a Ray of our own: on a machine that is busy with other things its start takes long."""

ANSWER_SECONDS = 10.0
"""In which a cluster's address must take a connection."""

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
            require_set_up()
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
            crew = Crew(self._ray, desk)
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
            self._refuse_nobody()
            own: dict[str, Any] = {
                "num_cpus": self.jobs if self._address is None else None,
                "object_store_memory": _OBJECTS,
                "include_dashboard": False,
                "_node_ip_address": "127.0.0.1",
            }
            options = own if self._address is None else {"address": self._address}
            with _handlers_kept():
                self._begin(ray, options)
            self._ours = True
        self._ray = ray

    def _refuse_nobody(self) -> None:
        """Refuse HOST:PORT where nobody listens, which Ray would go on asking for many minutes."""
        host, colon, port = (self._address or "").rpartition(":")
        if not colon or "/" in host or not port.isdigit():
            return
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_SECONDS).close()
        except (OSError, OverflowError, ValueError) as error:  # the last of digits that are no port's
            raise self._unreached(error) from None

    def _begin(self, ray: Any, options: dict[str, Any]) -> None:
        """Starts a Ray, or joins one. One of our own is tried again: Ray gives itself half a minute for its start."""
        for left in reversed(range(1 if self._address is not None else START_TRIES)):
            try:
                ray.init(**options, logging_level=logging.ERROR, log_to_driver=False)
                return
            except Exception as error:  # of many kinds, some no more than that
                with contextlib.suppress(Exception):
                    ray.shutdown()
                stopping.check()
                if not left:
                    raise self._unreached(error) from None

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
