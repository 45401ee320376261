"""One page at a websocket: what it is sent, what it says, and when it is sent away; slow readers lose frames."""

import asyncio
import contextlib
import json
import math
import time
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from gpcjax.teach.protocol import Command, Refused

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
        self._newest: dict[str, dict[str, Any] | bytes] = {}
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
            self._newest[message["type"]] = message
        elif len(self._waiting) < MOST_WAITING:
            self._waiting.append(_text(message))
        else:
            self._closing = True
            self.slow.set()
        self._something.set()

    def close(self, reason: str) -> None:
        """Tells it that it no longer teaches, and closes after that, once."""
        if self._closing:
            return
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
                        else self._websocket.send_text(_text(message))
                    )


async def attended(
    websocket: WebSocket,
    page: Page,
    read: Callable[[str | bytes], Command],
    hear: Callable[[Command], Awaitable[None]],
) -> None:
    """Sends a page what it is told and hears what it says, until it goes, is closed, or is too slow.

    Args:
        websocket: accepted.
        page: of this websocket.
        read: the command of a message; raises Refused.
        hear: takes each command, but pings, which are answered here.
    """
    sending = asyncio.create_task(page.send())
    listening = asyncio.create_task(_listen(websocket, page, read, hear))
    slow = asyncio.create_task(page.slow.wait())
    try:
        await asyncio.wait([sending, listening, slow], return_when=asyncio.FIRST_COMPLETED)
        if listening.done():
            listening.result()  # what hearing raised is a fault, and no page's affair
    finally:
        for task in (sending, listening, slow):
            task.cancel()
        await asyncio.gather(sending, listening, slow, return_exceptions=True)


async def leave(websocket: WebSocket, page: Page) -> None:
    """Closes the websocket of a page that was attended."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await websocket.close(1008 if page.slow.is_set() else 1000)


async def _listen(
    websocket: WebSocket,
    page: Page,
    read: Callable[[str | bytes], Command],
    hear: Callable[[Command], Awaitable[None]],
) -> None:
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
            command = read(message.get("text") or message.get("bytes") or b"")
        except Refused as error:
            refused += 1
            if refused > MOST_REFUSED or count > MOST_MESSAGES:
                page.close(f"messages were refused: {error}")
                await asyncio.sleep(1.0)
                return
            continue
        if command.type == "ping":
            page.put({"type": "pong", "at": command.values["at"]})
        else:
            await hear(command)


def _text(message: dict[str, Any]) -> str:
    """A message as JSON; a number that JSON does not know, which no browser reads, is null."""
    try:
        return json.dumps(message, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(_known(message), separators=(",", ":"), allow_nan=False)


def _known(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: _known(each) for name, each in value.items()}
    return [_known(each) for each in value] if isinstance(value, list | tuple) else value
