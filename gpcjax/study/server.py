"""The server of a study: participants at its address, the experimenter behind a token. Loads no jax.

Bound to 127.0.0.1 unless told otherwise. What the world sees is a proxy with TLS before it (docs/study.md).
"""

import asyncio
import contextlib
import os
import secrets
import socket
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import iterate_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.study.aside import POLICY, drawn
from gpcjax.study.download import zipped
from gpcjax.study.protocol import LONGEST
from gpcjax.study.reception import Reception
from gpcjax.study.register import TOKEN, Register
from gpcjax.teach.door import Door
from gpcjax.teach.server import KINDS, bound, configuration, files, is_local, names_of
from gpcjax.teach.server import PAGE as LESSON

if TYPE_CHECKING:
    from gpcjax.study.hall import Hall

PAGE = Path(__file__).parent / "page"
EXPERIMENTER = "/experimenter"
HTTPS_PORT = 443
FIRST_PORT, PORTS = 8765, 20
"""Without a port, the first of these that is free."""


def application(
    reception: Reception, names: frozenset[str] | None, encrypted: frozenset[str], token: str
) -> Any:
    """The pages, their files and websockets, behind a door."""
    out = reception.register.out

    async def experimenter(_: Request) -> Response:
        return FileResponse(PAGE / "experimenter.html", media_type=KINDS[".html"])

    async def download(request: Request) -> Response:
        if request.method == "HEAD":
            return PlainTextResponse("")
        name = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in out.name)
        headers = {"content-disposition": f'attachment; filename="{name}.zip"'}
        return StreamingResponse(_in_threads(zipped(out)), media_type="application/zip", headers=headers)

    drawing = asyncio.Lock()

    async def report(request: Request) -> Response:
        if request.method == "HEAD":
            return PlainTextResponse("")
        async with drawing:
            try:
                page = await drawn(out)
            except UserError as error:
                return PlainTextResponse(f"{error}\n", 503)
        return FileResponse(page, media_type=KINDS[".html"], headers={"content-security-policy": POLICY})

    async def part(websocket: WebSocket) -> None:
        await websocket.accept()
        await reception.visit(websocket)

    async def live(websocket: WebSocket) -> None:
        await websocket.accept()
        await reception.look(websocket)

    own = files(PAGE)
    routes = [
        Route("/", own),
        Route("/page/{name}", files(LESSON)),
        Route("/study/{name}", own),
        WebSocketRoute("/part", part),
        Route(EXPERIMENTER, experimenter),
        Route(f"{EXPERIMENTER}/download", download),
        Route(f"{EXPERIMENTER}/report", report),
        WebSocketRoute(f"{EXPERIMENTER}/live", live),
    ]
    return Door(Starlette(routes=routes), names, token, "gpcjax-experimenter", EXPERIMENTER, encrypted)


async def _in_threads(pieces: Iterator[bytes]) -> AsyncIterator[bytes]:
    async for piece in iterate_in_threadpool(pieces):
        if piece:
            yield piece


def host_of(address: str, source: str) -> str:
    """What browsers call the host of an https address.

    Raises:
        UserError: it is none, or has a path: the pages are at the root of their host.
    """
    parts = urlsplit(address)
    plain = parts.path in ("", "/") and not (parts.query or parts.fragment or parts.username)
    with contextlib.suppress(ValueError):
        if parts.scheme == "https" and parts.hostname and plain:
            own = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
            return own.lower() if parts.port in (None, HTTPS_PORT) else f"{own.lower()}:{parts.port}"
    raise UserError(f"{source} {shown(address)}: give https://HOST, as participants open it, without a path")


def token_of(out: Path) -> str:
    """The experimenter's token of a study's folder: made once, readable by its owner alone.

    Raises:
        UserError: it cannot be read or written.
    """
    path = out / TOKEN
    try:
        with contextlib.suppress(FileExistsError):
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(descriptor, "w") as file:
                file.write(secrets.token_urlsafe(24))
        token = path.read_text().strip()
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}, make it readable or take it away") from None
    if len(token) < 16:
        raise UserError(f"{path}: it holds no token, take it away, a new one is made then")
    return token


class Serving:
    """A study on a socket: its addresses, until somebody stops it.

    Args:
        register: of the study's folder, which is locked.
        hall: where lessons are held; it is started.
        places: how many lessons at once.
        host, port: where it listens; without a port on the first of a few that is free.
        address: https://HOST, as participants reach it through a proxy; None where there is none.
    """

    def __init__(
        self,
        register: Register,
        hall: "Hall",
        places: int,
        host: str,
        port: int | None,
        address: str | None,
    ):
        public = frozenset() if address is None else frozenset([host_of(address, "--address")])
        self.socket: socket.socket = bound(
            host, FIRST_PORT if port is None else port, PORTS if port is None else 1
        )
        number = self.socket.getsockname()[1]
        name = f"[{host}]" if ":" in host else host
        here = f"http://{name}:{number}/"
        self.address = here if address is None else f"{address.rstrip('/')}/"
        self.token = token_of(register.out)
        self.experimenter = f"{self.address.rstrip('/')}{EXPERIMENTER}?token={self.token}"
        names = None if address is None and not is_local(host) else names_of(name, number) | public
        self.reception = Reception(register, hall, places)
        app = application(self.reception, names, public, self.token)
        self.server = uvicorn.Server(configuration(app, LONGEST))

    def run(self) -> None:
        """Until Ctrl-C or SIGTERM; all seats are given back then."""
        try:
            asyncio.run(self._serve())
        finally:
            self.socket.close()

    async def _serve(self) -> None:
        try:
            await self.server.serve(sockets=[self.socket])
        finally:
            await self.reception.close()
