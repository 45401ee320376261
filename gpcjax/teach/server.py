"""The server of a lesson's page: its files, its websocket, its socket. Loads no jax.

Bound to 127.0.0.1 unless told otherwise; beyond that only with a token.
"""

import contextlib
import ipaddress
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import uvicorn
import websockets  # noqa: F401  (uvicorn loads it when it serves: what is missing is told before)
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from gpcjax.errors import UserError
from gpcjax.teach.door import Door
from gpcjax.teach.lesson import Lesson
from gpcjax.teach.protocol import MESSAGE_BYTES
from gpcjax.teach.room import Room

PAGE = Path(__file__).parent / "page"
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
"""The files that are served, and as what."""

FAREWELL_SECONDS = 2.0
"""Within which pages take what the lesson said last."""

HTTP_PORT = 80
"""The port that browsers leave out of an address."""


def files(folder: Path) -> Callable[[Request], Awaitable[Response]]:
    """What serves the files of one folder of ours, and index.html where no name is asked for."""
    known = frozenset(each.name for each in folder.iterdir() if each.is_file())

    async def file(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        path = folder / name
        if name not in known or path.suffix not in KINDS:
            return PlainTextResponse("there is nothing\n", 404)
        return FileResponse(path, media_type=KINDS[path.suffix])

    return file


def application(room: Room, names: frozenset[str] | None, token: str, port: int) -> Any:
    """The page, its files, and its websocket, behind a door."""
    page = files(PAGE)

    async def lesson(websocket: WebSocket) -> None:
        await websocket.accept()
        await room.visit(websocket)

    routes = [Route("/", page), Route("/page/{name}", page), WebSocketRoute("/lesson", lesson)]
    return Door(Starlette(routes=routes), names, token, f"gpcjax-token-{port}")


def bound(host: str, port: int, attempts: int) -> socket.socket:
    """A socket that listens: on the port, or on the first of so many after it that is free.

    Raises:
        UserError: there is none.
    """
    family, reason = (socket.AF_INET6 if ":" in host else socket.AF_INET), ""
    for number in range(port, port + attempts):
        made = socket.socket(family, socket.SOCK_STREAM)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((host, number))
            made.listen(64)
            return made
        except (OSError, OverflowError) as error:
            made.close()
            reason = getattr(error, "strerror", None) or str(error)
    raise UserError(
        f"--port {port}: nobody can listen on {host} there ({reason}), give another --port or --host"
    )


def is_local(host: str) -> bool:
    """Whether a host is this machine alone."""
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def names_of(host: str, port: int) -> frozenset[str]:
    """What browsers on this machine call a host that is this machine alone."""
    hosts = ("127.0.0.1", "localhost", "[::1]", host.lower())
    names = frozenset(f"{name}:{port}" for name in hosts)
    return names | frozenset(hosts) if port == HTTP_PORT else names


def configuration(app: Any, longest: int) -> uvicorn.Config:
    """How every server of ours runs; `longest` is of the messages that are read, in bytes."""
    return uvicorn.Config(
        app,
        log_config=None,  # its own closes the handlers of everybody, and with them, as absl has it, streams
        log_level="warning",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="websockets-sansio",
        ws_max_size=2 * longest,
        ws_ping_interval=5.0,
        ws_ping_timeout=15.0,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=2,
    )


class Serving:
    """A lesson on a socket: its address, until somebody stops it."""

    def __init__(self, lesson_with: Callable[[Callable[..., None]], Lesson], host: str, port: int | None):
        self._socket = bound(host, 8765 if port is None else port, 20 if port is None else 1)
        number = self._socket.getsockname()[1]
        local = is_local(host)
        self.token = "" if local else secrets.token_urlsafe(24)
        shown = f"[{host}]" if ":" in host else host
        self.address = f"http://{shown}:{number}/" + (f"?token={self.token}" if self.token else "")
        names = names_of(shown, number)
        self.lesson = lesson_with(lambda message: self._room.say(message))
        self._room = Room(self.lesson)
        app = application(self._room, names if local else None, self.token, number)
        self._server = uvicorn.Server(configuration(app, MESSAGE_BYTES))

    def run(self) -> None:
        """Until Ctrl-C, SIGTERM, or an error of the lesson; what is taught is written down then.

        Raises:
            BaseException: what ended the lesson.
        """
        self.lesson.start()
        threading.Thread(target=self._end_with_lesson, daemon=True, name="end of the lesson").start()
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self.lesson.close()
            self._socket.close()
        if self.lesson.failure is not None:
            raise self.lesson.failure

    def _end_with_lesson(self) -> None:
        """Has the server end when the lesson did: there is nothing to teach any more."""
        self.lesson.join()
        self._room.await_empty(FAREWELL_SECONDS)  # a server that ends sends nothing more
        self._server.should_exit = True
