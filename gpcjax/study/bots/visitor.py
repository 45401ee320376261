"""One scripted participant, from the page to the end: what a browser would load, hear and say. Loads no jax.

Over 300 lines: one class, the answers to all that a server may say.
"""

import asyncio
import contextlib
import functools
import json
import time
from collections.abc import Mapping
from random import Random
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from gpcjax.study.bots.behaviour import Advice, Kind, Teacher
from gpcjax.study.bots.experts import expert_of
from gpcjax.study.bots.place import SECONDS, Outcome, Place, load_page

MEASURED = {"width": 1280, "height": 800, "frame_rate": 60, "round_trip": 5}
"""What it says of its machine."""

AGAIN = (0.5, 5.0)
"""Seconds until it tries to come back: the first time, and at most."""

TRIES = 5
"""How often it says something again that could not be kept."""


class _Left(Exception):
    """The browser is closed; `seconds` until it is opened again, None for never."""

    def __init__(self, seconds: float | None):
        super().__init__()
        self.seconds = seconds


class Visitor:
    """One of them.

    Args:
        place: of the study.
        code: takes part with it.
        kind: what sort of participant.
        seed: of all that it draws.
        reading: mean seconds for a text or a question.
        patience: seconds for which it tries to come back to a server that does not answer.
    """

    def __init__(
        self, place: Place, code: str, kind: Kind, seed: str, reading: float = 2.0, patience: float = 120.0
    ):
        self._place, self._kind, self._seed = place, kind, seed
        self._reading, self._patience = reading, patience
        self._random = Random(f"{seed}/self")
        self.outcome = Outcome(code, kind.name)
        self._gives_up = self._random.random() if self._random.random() < kind.gives_up else None
        """The part of all steps after which it gives up."""
        self._step: dict[str, Any] = {}
        self._teacher: Teacher | None = None
        self._state = {"paused": True, "why": "start"}
        self._held = False
        self._heard = 0.0
        self._tries = 0
        self._task: dict[str, Any] | None = None
        self._time = self._since = 0.0
        self._frame = 0
        self._repeat = 8.0
        self._hand: asyncio.Task[None] | None = None
        self._eyes: asyncio.Task[None] | None = None
        self._thought: asyncio.Task[None] | None = None

    async def goes(self) -> Outcome:
        """The whole way, with comings back; never raises for what a server may do."""
        begun = self._heard = time.monotonic()
        outcome, wait = self.outcome, AGAIN[0]
        while not outcome.ended:
            try:
                await self._visit()
            except _Left as left:
                if left.seconds is None:
                    outcome.ended = "gave up"
                else:
                    await asyncio.sleep(left.seconds)
                    self._heard, wait = time.monotonic(), AGAIN[0]
                continue
            except (OSError, ConnectionClosed, InvalidHandshake, TimeoutError) as error:
                if time.monotonic() - self._heard > self._patience:
                    outcome.ended, outcome.text = "lost", str(error) or type(error).__name__
            finally:
                self._drop()
            if not outcome.ended:
                await asyncio.sleep(wait)
                wait = min(2 * wait, AGAIN[1]) if time.monotonic() - self._heard > wait else AGAIN[0]
        outcome.seconds = time.monotonic() - begun
        return outcome

    # --- the page

    async def _visit(self) -> None:
        """Opens the page, and does what it asks for until the end, or until the connection breaks."""
        await asyncio.to_thread(load_page, self._place.address, self.outcome.code)
        async with connect(
            self._place.socket,
            origin=self._place.origin,  # pyright: ignore[reportArgumentType] (a NewType of str)
            open_timeout=SECONDS,
            compression=None,
            proxy=None,
        ) as socket:
            self.outcome.connections += 1
            self._task = None
            async for text in socket:
                self._heard = time.monotonic()
                if isinstance(text, str):
                    await self._hear(socket, json.loads(text))
                if self.outcome.ended:
                    return

    async def _hear(self, socket: ClientConnection, message: dict[str, Any]) -> None:
        match message["type"]:
            case "hello":
                await self._say(socket, "join", code=self.outcome.code, take=False)
            case "elsewhere":
                await self._say(socket, "join", code=self.outcome.code, take=True)
            case "refused":
                self.outcome.ended, self.outcome.text = "refused", message["text"]
            case "ended":
                self.outcome.ended = message["state"]
                self.outcome.completion = message["link"] or message["code"]
            case "step":
                self._arrive(socket, message)
            case "task":
                self._task, self._repeat = message["task"], message.get("repeat") or 8.0
                self._begin_run()
            case "held":
                self._held = message["on"]
                self._consider(socket)
            case "state":
                self._turn(message)
                self._consider(socket)
            case "frame":
                self._see(socket, message)
            case "advised":
                self.outcome.learned += 1
            case "gone" if "took over" in message["reason"]:
                self.outcome.ended, self.outcome.text = "lost", "another page took over"
            case "problem":
                self._try_again(socket, message["text"])

    async def _say(self, socket: ClientConnection, type_: str, **content: Any) -> None:
        with contextlib.suppress(ConnectionClosed):
            await socket.send(json.dumps({"type": type_, **content}, separators=(",", ":")))

    # --- steps

    def _arrive(self, socket: ClientConnection, step: dict[str, Any]) -> None:
        again = (step["name"], step.get("attempt")) == (self._step.get("name"), self._step.get("attempt"))
        self._step = step
        if not again:
            self._time, self._teacher = 0.0, None
            self._state = {"paused": True, "why": "start"}
            self._task, self._tries = None, 0
            self.outcome.runs += step["kind"] == "run"
        reply = self._reply(step)
        if reply is not None:
            self._think(self._say(socket, reply[0], **reply[1]))

    def _reply(self, step: Mapping[str, Any]) -> tuple[str, dict[str, Any]] | None:
        """What is said to a step that is no run, as a type and its values."""
        match step["kind"]:
            case "consent":
                return "agree", {"on": True}
            case "check":
                return "measured", MEASURED
            case "instructions":
                return "go_on", {}
            case "questions":
                return "answers", {"values": {each["name"]: self._answer(each) for each in step["questions"]}}
        return None

    def _try_again(self, socket: ClientConnection, text: str) -> None:
        """Says the same once more, as a person would, to a step that could not be kept; not for ever."""
        reply = self._reply(self._step)
        if reply is None:
            return
        self._tries += 1
        if self._tries > TRIES:
            self.outcome.ended, self.outcome.text = "lost", text
        else:
            self._think(self._say(socket, reply[0], **reply[1]))

    def _answer(self, question: Mapping[str, Any]) -> int | str | None:
        random = Random(f"{self._seed}/{self._step['name']}/{question['name']}")
        match question["kind"]:
            case "scale":
                middle = (question["points"] + 1) / 2
                return min(max(round(random.gauss(middle, question["points"] / 4)), 1), question["points"])
            case "choice":
                return random.choice(question["options"])
        needs = question["needed"] or random.random() < 0.3
        return "This is the answer of a scripted participant." if needs else None

    def _think(self, then: Any, seconds: float | None = None) -> None:
        """Does something after a while: as long as reading takes, or so many seconds."""
        mean = self._reading
        wait = self._random.gammavariate(3.0, mean / 3.0) if seconds is None else seconds
        self._cancel(self._thought)

        async def later() -> None:
            await asyncio.sleep(wait)
            await then

        self._thought = asyncio.create_task(later())
        # One that is cancelled before it slept has not begun, and would warn of it.
        self._thought.add_done_callback(lambda _: then.close())

    # --- a run

    def _begin_run(self) -> None:
        if self._task is None or self._teacher is not None:
            return
        random = Random(f"{self._seed}/{self._step['name']}/{self._step.get('attempt', 0)}")
        self._teacher = Teacher(self._kind, random, _expert(self._task["name"]))

    def _consider(self, socket: ClientConnection) -> None:
        """Begins, or goes on, if the run rests and may go on."""
        rests = self._step.get("kind") in ("run", "trial") and self._state["paused"]
        if not rests or self._held or self._task is None or self._state["why"] in ("over", "away"):
            return
        rest = self._step.get("rest", 0.0) if self._state["why"] == "start" else 0.0
        think = self._random.gammavariate(3.0, self._reading / 3.0)
        self._think(self._say(socket, "pause", on=False), max(rest, 0.0) + 0.05 + think)

    def _turn(self, state: dict[str, Any]) -> None:
        """The run rests from now on, or goes on."""
        if self._state["paused"] and not state["paused"]:
            self._since = time.monotonic()
        if state["paused"] and not self._state["paused"]:
            self._time += time.monotonic() - self._since
            self._cancel(self._hand)
        self._state = state

    def _see(self, socket: ClientConnection, frame: dict[str, Any]) -> None:
        self._frame = frame["n"]
        teacher = self._teacher
        if teacher is None or self._state["paused"]:
            return
        now = self._time + time.monotonic() - self._since
        self._maybe_gives_up(socket, frame)
        if (away := teacher.looks_away(now)) is not None and _is_free(self._eyes):
            self._cancel(self._hand)
            self._eyes = asyncio.create_task(self._look_away(socket, away))
            return
        if self._step["kind"] == "trial" and self._step["passes"] == "keys":
            advice = self._every_key(frame)
        else:
            advice = teacher.sees(frame, now)
        if advice is not None and _is_free(self._hand):
            self._hand = asyncio.create_task(self._press(socket, advice))

    def _every_key(self, frame: Mapping[str, Any]) -> Advice | None:
        """In a trial of keys each of them in turn, at a comfortable pace."""
        assert self._task is not None
        if not _is_free(self._hand):
            return None
        keys = [(dim, h) for dim in range(len(self._task["actions"])) for h in (-1, 1)]
        dim, h = keys[self.outcome.presses % len(keys)]
        return Advice(dim, h, frame["n"], 0.15, 0.0)

    async def _press(self, socket: ClientConnection, advice: Advice) -> None:
        await asyncio.sleep(advice.wait)
        begun = time.monotonic()
        held = False
        while not held or time.monotonic() - begun < advice.hold:
            self.outcome.presses += 1
            press = {"id": self.outcome.presses, "dim": advice.dim, "h": advice.h, "n": self._frame}
            await self._say(socket, "press", **press, at=1000 * time.monotonic() % 1e9, held=held)
            held = True
            await asyncio.sleep(1 / self._repeat)

    async def _look_away(self, socket: ClientConnection, seconds: float) -> None:
        await self._say(socket, "hidden", on=True)
        await asyncio.sleep(seconds)
        await self._say(socket, "hidden", on=False)
        await asyncio.sleep(self._kind.reaction)
        await self._say(socket, "pause", on=False)

    def _maybe_gives_up(self, socket: ClientConnection, frame: Mapping[str, Any]) -> None:
        """Closes the browser once, somewhere in the run that was drawn; or leaves the study."""
        step = self._step
        if self._gives_up is None or step["kind"] != "run" or (frame["episode"] == 0 and frame["step"] < 20):
            return
        if step["number"] - 1 < int(self._gives_up * step["of"]):
            return
        self._gives_up = None
        if self._random.random() < self._kind.returns:
            raise _Left(self._random.expovariate(1 / (3 * self._reading)))
        if self._random.random() < 0.5:
            raise _Left(None)
        self._cancel(self._hand)
        self._hand = asyncio.create_task(self._say(socket, "leave"))

    # --- ends

    def _drop(self) -> None:
        """Lets all go that belongs to a connection."""
        self._turn({"paused": True, "why": "connection"})
        for task in (self._hand, self._eyes, self._thought):
            self._cancel(task)

    @staticmethod
    def _cancel(task: "asyncio.Task[None] | None") -> None:
        if task is not None:
            task.cancel()


@functools.lru_cache(maxsize=64)
def _expert(task: str) -> Any:
    return expert_of(task)


def _is_free(task: "asyncio.Task[None] | None") -> bool:
    return task is None or task.done()
