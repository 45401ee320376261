"""A server in a thread of a test."""

import asyncio
import contextlib
import http.client
import threading
import types

import uvicorn.server
from websockets.sync.client import connect

LONG = 20.0
"""Seconds until something that should have happened is missing."""


class _Sooner(types.ModuleType):
    """In place of asyncio where uvicorn looks every tenth of a second whether it is to end, and who is still there."""

    def __getattr__(self, name):
        return getattr(asyncio, name)

    @staticmethod
    async def sleep(seconds):
        await asyncio.sleep(seconds / 20)


uvicorn.server.asyncio = _Sooner("asyncio")


class InThread:
    """Runs `serving`, which listens at `port`, until `end`, which has its uvicorn server closed."""

    def __init__(self, serving, server, port):
        self.raised = None
        self.serving, self._server, self.port = serving, server, port
        self.origin = f"http://127.0.0.1:{port}"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        try:
            self.serving.run()
        except BaseException as error:
            self.raised = error

    def ended(self):
        """Waits for it."""
        self._thread.join(LONG)
        assert not self._thread.is_alive()

    def end(self):
        self._server.should_exit = True
        self.ended()

    def asks(self, path, method="GET", **headers):
        """Status, headers and content of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=LONG)
        with contextlib.closing(connection):
            connection.request(
                method, path, headers={name.replace("_", "-"): text for name, text in headers.items()}
            )
            answer = connection.getresponse()
            return answer.status, {name.lower(): text for name, text in answer.getheaders()}, answer.read()

    def socket(self, path, **options):
        """A connection of the kind that pages have."""
        options = {"origin": self.origin, "open_timeout": LONG} | options
        return connect(f"ws://127.0.0.1:{self.port}{path}", compression=None, proxy=None, **options)
