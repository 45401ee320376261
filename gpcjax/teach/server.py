"""The page and its websocket: who may come in, one teacher at a time, and a reader that is slow. Loads no jax.

Bound to 127.0.0.1 unless told otherwise; beyond that only with a token. A page elsewhere in the person's browser can
reach a local port: so the names of the host and the origin are looked at, and nothing runs that is not ours (the
content security policy).
"""

import asyncio
import contextlib
import hmac
import ipaddress
import json
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, MutableMapping
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

import gpcjax
from gpcjax.errors import UserError
from gpcjax.teach.lesson import Lesson
from gpcjax.teach.protocol import MESSAGE_BYTES, Command, Refused, parse

PAGE = Path(__file__).parent / "page"
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
"""The files that are served, and as what."""

COOKIE = "gpcjax-token"
MOST_MESSAGES = 200
"""A second, from one page."""
MOST_REFUSED = 20
MOST_WAITING = 500
"""Messages that a page has not taken yet; a frame and a picture count once, as only the newest is sent."""
FRAMES_APART = 1 / 60

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


class Page:
    """One connected page, and what it has not been sent yet. Used in the server's thread alone."""

    def __init__(self, websocket: WebSocket):
        self._websocket = websocket
        self._waiting: deque[str] = deque()
        self._newest: dict[str, str | bytes] = {}
        self._something = asyncio.Event()
        self._closing = False
        self._framed = 0.0
        self.slow = asyncio.Event()
        """Set when it takes too long to read: `send` waits for it then, maybe for ever."""

    def put(self, message: dict[str, Any] | bytes) -> None:
        """Has a message sent soon, unless it is being closed: nothing follows `gone`."""
        if self._closing:
            return
        if isinstance(message, bytes):
            self._newest["picture"] = message
        elif message["type"] in ("frame", "map"):
            self._newest[message["type"]] = _text(message)
        elif len(self._waiting) < MOST_WAITING:
            self._waiting.append(_text(message))
        else:
            self._closing = True
            self.slow.set()
        self._something.set()

    def close(self, reason: str) -> None:
        """Tells it that it no longer teaches, and closes after that."""
        self._newest.clear()
        self._waiting.append(_text({"type": "gone", "reason": reason}))
        self._closing = True
        self._something.set()

    async def send(self) -> None:
        """Sends what is put, until it is closed."""
        while True:
            await self._something.wait()
            self._something.clear()
            while self._waiting:
                await self._websocket.send_text(self._waiting.popleft())
            if self._closing:
                return
            pause = self._framed + FRAMES_APART - time.monotonic()
            if "frame" in self._newest and pause > 0:
                # Something else may come meanwhile, which does not wait for the next frame.
                asyncio.get_running_loop().call_later(pause, self._something.set)
                continue
            if "frame" in self._newest:
                self._framed = time.monotonic()
            for kind in ("frame", "picture", "map"):
                if (message := self._newest.pop(kind, None)) is not None:
                    await (
                        self._websocket.send_bytes(message)
                        if isinstance(message, bytes)
                        else self._websocket.send_text(message)
                    )


class Room:
    """Who is there: one page teaches, others are told so."""

    def __init__(self, lesson: Lesson):
        self._lesson = lesson
        self._teaching: Page | None = None
        self._preparing: dict[str, Any] | None = {"type": "preparing", "what": "starting"}
        self._loop: asyncio.AbstractEventLoop | None = None

    def say(self, message: dict[str, Any] | bytes) -> None:
        """Takes what the lesson tells the page, from any thread."""
        if self._loop is None:
            self._remember(message)
        else:
            with contextlib.suppress(RuntimeError):  # the server has ended
                self._loop.call_soon_threadsafe(self._deliver, message)

    def _remember(self, message: dict[str, Any] | bytes) -> None:
        if isinstance(message, dict) and message["type"] in ("preparing", "task"):
            self._preparing = message if message["type"] == "preparing" else None

    def _deliver(self, message: dict[str, Any] | bytes) -> None:
        self._remember(message)
        if self._teaching is not None:
            self._teaching.put(message)

    async def visit(self, websocket: WebSocket) -> None:
        """One page, from its coming to its going."""
        self._loop = asyncio.get_running_loop()
        page = Page(websocket)
        sending = asyncio.create_task(page.send())
        listening = asyncio.create_task(self._listen(websocket, page))
        slow = asyncio.create_task(page.slow.wait())
        page.put({"type": "hello", "version": gpcjax.__version__, "taken": self._teaching is not None})
        if self._teaching is None:
            self._take(page)
        try:
            await asyncio.wait([sending, listening, slow], return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (sending, listening, slow):
                task.cancel()
            await asyncio.gather(sending, listening, slow, return_exceptions=True)
            if self._teaching is page:
                self._teaching = None
                self._lesson.submit(Command("left"))
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close(1008 if page.slow.is_set() else 1000)

    def _take(self, page: Page) -> None:
        if self._teaching is not None:
            self._teaching.close("took over")
            self._lesson.submit(Command("left"))
        self._teaching = page
        if self._preparing is not None:
            page.put(self._preparing)
        self._lesson.submit(Command("joined"))

    async def _listen(self, websocket: WebSocket, page: Page) -> None:
        refused, second, count = 0, 0.0, 0
        while True:
            try:
                message = await websocket.receive()
            except RuntimeError:
                return
            if message["type"] == "websocket.disconnect":
                return
            now = time.monotonic()
            if now - second > 1.0:
                second, count = now, 0
            count += 1
            try:
                if count > MOST_MESSAGES:
                    raise Refused("too many messages")
                command = parse(message.get("text") or message.get("bytes") or b"")
            except Refused as error:
                refused += 1
                if refused > MOST_REFUSED or count > MOST_MESSAGES:
                    page.close(f"messages were refused: {error}")
                    await asyncio.sleep(1.0)
                    return
                continue
            if command.type == "ping":
                page.put({"type": "pong", "at": command.values["at"]})
            elif command.type == "take":
                if self._teaching is not page:
                    self._take(page)
            elif self._teaching is page:
                self._lesson.submit(command)


def _text(message: dict[str, Any]) -> str:
    return json.dumps(message, separators=(",", ":"))


class Door:
    """Lets in who asks for this host from a page of its own, with the token where one is needed.

    Args:
        app: what is behind.
        names: the hosts that may be asked for, with the port; None for any.
        token: empty where none is needed.
    """

    def __init__(self, app: Any, names: frozenset[str] | None, token: str):
        self._app, self._names, self._token = app, names, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        why_not = self._reason(scope, headers)

        async def with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        if why_not is None:
            await self._app(scope, receive, with_headers)
        elif scope["type"] == "http":
            await why_not(scope, receive, with_headers)
        else:
            await send({"type": "websocket.close", "code": 1008})

    def _reason(self, scope: Scope, headers: Headers) -> Response | None:
        """The answer to who may not come in."""
        host, origin = headers.get("host", "").lower(), headers.get("origin")
        if self._names is not None and host not in self._names:
            return PlainTextResponse("another host is meant\n", 421)
        if scope["type"] == "websocket" and (
            origin is None or origin.lower() not in (f"http://{host}", f"https://{host}")
        ):
            return PlainTextResponse("another page asks\n", 403)
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD"):
            return PlainTextResponse("only to be read\n", 405)
        if not self._token:
            return None
        given = QueryParams(scope["query_string"]).get("token", "")
        if scope["type"] == "http" and scope["path"] == "/" and self._is_token(given):
            answer = RedirectResponse("/", 303)
            answer.set_cookie(COOKIE, self._token, httponly=True, samesite="strict")
            return answer
        cookies = Request({**scope, "type": "http"}).cookies
        if not self._is_token(cookies.get(COOKIE, "")):
            return PlainTextResponse("open the address with its token, as gpcjax teach prints it\n", 403)
        return None

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def application(room: Room, names: frozenset[str] | None, token: str) -> Any:
    """The page, its files, and its websocket."""
    names_of_page = frozenset(each.name for each in PAGE.iterdir() if each.is_file())

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        path = PAGE / name
        if name not in names_of_page or path.suffix not in KINDS:
            return PlainTextResponse("there is nothing\n", 404)
        return FileResponse(path, media_type=KINDS[path.suffix])

    async def lesson(websocket: WebSocket) -> None:
        await websocket.accept()
        await room.visit(websocket)

    routes = [Route("/", page), Route("/page/{name}", page), WebSocketRoute("/lesson", lesson)]
    return Door(Starlette(routes=routes), names, token)


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


class Serving:
    """A lesson on a socket: its address, until somebody stops it."""

    def __init__(self, lesson_with: Callable[[Callable[..., None]], Lesson], host: str, port: int | None):
        self._socket = bound(host, 8765 if port is None else port, 20 if port is None else 1)
        number = self._socket.getsockname()[1]
        local = is_local(host)
        self.token = "" if local else secrets.token_urlsafe(24)
        shown = f"[{host}]" if ":" in host else host
        self.address = f"http://{shown}:{number}/" + (f"?token={self.token}" if self.token else "")
        names = frozenset(f"{name}:{number}" for name in ("127.0.0.1", "localhost", "[::1]", shown.lower()))
        self.lesson = lesson_with(lambda message: self._room.say(message))
        self._room = Room(self.lesson)
        app = application(self._room, names if local else None, self.token)
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            server_header=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=2 * MESSAGE_BYTES,
            ws_ping_interval=5.0,
            ws_ping_timeout=15.0,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=2,
        )
        self._server = uvicorn.Server(config)

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
        self._server.should_exit = True
