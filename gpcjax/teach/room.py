"""Who is at a lesson: one page teaches, others are told so."""

import asyncio
import contextlib
import threading
from typing import Any

from starlette.websockets import WebSocket

import gpcjax
from gpcjax.teach.lesson import Lesson
from gpcjax.teach.pages import Page, attended, leave
from gpcjax.teach.protocol import Command, parse


class Room:
    """Who is there: one page teaches, others are told so."""

    def __init__(self, lesson: Lesson):
        self._lesson = lesson
        self._teaching: Page | None = None
        self._here: set[Page] = set()
        self._preparing: dict[str, Any] | None = {"type": "preparing", "what": "starting"}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._empty = threading.Event()
        self._empty.set()

    def say(self, message: dict[str, Any] | bytes) -> None:
        """Takes what the lesson tells the page, from any thread."""
        if self._loop is None:
            self._remember(message)
        else:
            with contextlib.suppress(RuntimeError):  # the server has ended
                self._loop.call_soon_threadsafe(self._deliver, message)

    def await_empty(self, seconds: float) -> None:
        """Waits in any thread until nobody is there, at most so long: after `gone`, until all have heard it."""
        self._empty.wait(seconds)

    def _remember(self, message: dict[str, Any] | bytes) -> None:
        if isinstance(message, dict) and message["type"] in ("preparing", "task"):
            self._preparing = message if message["type"] == "preparing" else None

    def _deliver(self, message: dict[str, Any] | bytes) -> None:
        self._remember(message)
        if isinstance(message, dict) and message["type"] == "gone":
            for page in self._here:
                page.close(message["reason"])
        elif self._teaching is not None:
            self._teaching.put(message)

    async def visit(self, websocket: WebSocket) -> None:
        """One page, from its coming to its going."""
        self._loop = asyncio.get_running_loop()
        self._empty.clear()
        page = Page(websocket)
        self._here.add(page)
        page.put({"type": "hello", "version": gpcjax.__version__, "taken": self._teaching is not None})
        if self._teaching is None:
            self._take(page)

        async def hear(command: Command) -> None:
            if command.type == "take":
                if self._teaching is not page:
                    self._take(page)
            elif self._teaching is page:
                self._lesson.submit(command)

        try:
            await attended(websocket, page, parse, hear)
        finally:
            if self._teaching is page:
                self._teaching = None
                self._lesson.submit(Command("left"))
            try:
                await leave(websocket, page)
            finally:
                self._here.discard(page)
                if not self._here:
                    self._empty.set()

    def _take(self, page: Page) -> None:
        if self._teaching is not None:
            self._teaching.close("took over")
            self._lesson.submit(Command("left"))
        self._teaching = page
        if self._preparing is not None:
            page.put(self._preparing)
        self._lesson.submit(Command("joined"))
