"""Who is at a lesson: one page teaches, others are told so; a reader that is slow loses frames, and then its place."""

import asyncio
import contextlib
import json
import time
from collections import deque
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

import gpcjax
from gpcjax.teach.lesson import Lesson
from gpcjax.teach.protocol import Command, Refused, parse

MOST_MESSAGES = 200
"""A second, from one page."""
MOST_REFUSED = 20
MOST_WAITING = 500
"""Messages that a page has not taken yet; a frame and a picture count once, as only the newest is sent."""
FRAMES_APART = 1 / 60


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
