"""The reception of a study: pages come in, people sit down, the experimenter looks on. In the server's event loop."""

import asyncio
import contextlib
import sys
import time
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocket

from gpcjax.errors import UserError
from gpcjax.study.mailbox import Mailbox
from gpcjax.study.participant import Participant
from gpcjax.study.protocol import EXPERIMENTER, LONGEST, PARTICIPANT
from gpcjax.study.register import Refused, Register
from gpcjax.study.showing import hello
from gpcjax.study.sitting import Sitting
from gpcjax.study.status import lesson_of, line_of
from gpcjax.study.steps import Step
from gpcjax.teach.pages import Page, attended, leave
from gpcjax.teach.protocol import Command, parse

if TYPE_CHECKING:
    from gpcjax.study.hall import Hall, Run

MOST_TRIES = 10
"""Codes that one page may try."""
MOST_PAGES = 1000
"""At once."""
MOST_FAULTS = 20
"""The latest that are shown."""
SECOND = 1.0
EXPIRE_EVERY = 60.0

_UNAVAILABLE = "Too many people are coming at the moment. Please try again in a minute."


class Reception:
    """Everybody at a study.

    Args:
        register: of the study's folder.
        hall: where lessons are held.
        places: how many lessons at once.
    """

    def __init__(self, register: Register, hall: "Hall", places: int):
        self.register, self.hall, self.places = register, hall, places
        self.held = False
        self._sittings: dict[str, Sitting] = {}
        self._lookers: set[Page] = set()
        self._pages = 0
        self._joined: deque[float] = deque()
        self._faults: deque[str] = deque(maxlen=MOST_FAULTS)
        self._clerk = ThreadPoolExecutor(1, "clerk")
        self._expired = time.monotonic()
        self._mailbox: Mailbox | None = None
        self._ticking: asyncio.Task[None] | None = None

    @property
    def mailbox(self) -> Mailbox:
        """Of the event loop, in which it is first asked for."""
        if self._mailbox is None:
            self._mailbox = Mailbox()
        return self._mailbox

    def fault(self, text: str) -> None:
        """Shows the experimenter what concerns no single participant, from any thread."""
        print(text, file=sys.stderr, flush=True)
        self._faults.append(text)

    async def clerk(self, do: Callable[..., Any], *given: Any) -> Any:
        """Does something on the disk, one thing after the other, in a thread of its own."""
        return await asyncio.get_running_loop().run_in_executor(self._clerk, do, *given)

    def run_of(self, participant: Participant, step: Step) -> "Run":
        """What a run, or an attempt at the trial, has taught."""
        from gpcjax.study.hall import Run  # which loads jax

        study, run = participant.study, step.run
        if run is None:
            trial = study.trial
            assert trial is not None
            course = replace(trial.course, seed=participant.seed)
            return Run(participant.trial_folder(), course, trial.episodes, trial.seconds)
        return Run(
            participant.run_folder(run),
            study.course(run.treatment, run.task, participant.seed + run.repetition),
            study.runs.episodes[run.task],
            study.runs.seconds,
            study.arm(run.treatment.arm).cue,
        )

    # --- participants

    async def visit(self, websocket: WebSocket) -> None:
        """One page of a participant, from its coming to its going."""
        self._tick_on()
        page, tries = Page(websocket), 0
        sitting: Sitting | None = None

        async def hear(command: Command) -> None:
            nonlocal sitting, tries
            if command.type == "join":
                tries += 1
                if tries > MOST_TRIES:
                    page.close("too many codes were tried")
                elif sitting is None:
                    sitting = await self._join(page, command.values["code"].strip(), command.values["take"])
            elif sitting is not None and sitting.page is page:
                await sitting.hear(command)

        if self._pages >= MOST_PAGES:
            await websocket.close(1013)
            return
        self._pages += 1
        page.put(hello(self.register.study))
        try:
            await attended(websocket, page, lambda text: parse(text, PARTICIPANT, LONGEST), hear)
        finally:
            self._pages -= 1
            if sitting is not None:
                await sitting.go(page)
            await leave(websocket, page)

    async def _join(self, page: Page, code: str, take: bool) -> Sitting | None:
        """Sits somebody down; None where that cannot be, which the page has been told."""
        sitting = self._sittings.get(code)
        if sitting is not None and sitting.page is not None and not take:
            page.put({"type": "elsewhere"})
            return None
        if sitting is None:
            try:
                participant = self.register.get(code) or await self._admit(code)
            except UserError as error:
                page.put({"type": "refused", "text": str(error)})
                return None
            except OSError:
                page.put({"type": "refused", "text": _UNAVAILABLE})
                return None
            # While it was written, another page may have come with the same code.
            sitting = self._sittings.setdefault(participant.code, Sitting(participant, self))
        await sitting.come(page)
        return sitting

    async def _admit(self, code: str) -> Participant:
        self.register.check(code)  # what is no code takes nobody's turn
        now = time.monotonic()
        while self._joined and now - self._joined[0] > 60.0:
            self._joined.popleft()
        if len(self._joined) >= self.register.study.joining.a_minute:
            raise Refused(_UNAVAILABLE)
        self._joined.append(now)
        return await self.clerk(lambda: self.register.get(code) or self.register.admit(code))

    # --- the experimenter

    async def look(self, websocket: WebSocket) -> None:
        """One page of the experimenter."""
        self._tick_on()
        page = Page(websocket)
        self._lookers.add(page)

        async def hear(command: Command) -> None:
            try:
                await self._order(command, page)
            except (UserError, OSError) as error:
                page.put({"type": "problem", "text": str(error)})
            self._report()

        page.put(self._people())
        try:
            await attended(websocket, page, lambda text: parse(text, EXPERIMENTER, LONGEST), hear)
        finally:
            self._lookers.discard(page)
            await leave(websocket, page)

    async def _order(self, command: Command, page: Page) -> None:
        code = command.values["code"]
        sitting = self._sittings.get(code)
        if code and self.register.get(code) is None:
            raise UserError(f"nobody has the code {code!r} any more")
        match command.type:
            case "pause" if not code:
                self.held = command.values["on"]
                for each in self._sittings.values():
                    each.hold()
            case "pause" if sitting is not None:
                sitting.held = command.values["on"]
                sitting.hold()
            case "pause":
                raise UserError(f"{code} is not here now: there is nothing to pause")
            case "stop":
                for each in [code] if code else [one.code for one in self.register if one.step is not None]:
                    await self._stop(each)
            case "delete" if code:
                await self._empty(code)
                removed = await self.clerk(self.register.delete, code)
                page.put({"type": "deleted", "code": code, "removed": removed})

    async def _empty(self, code: str) -> None:
        """Nobody sits there, and nothing of the participant will be written any more."""
        participant = self.register.get(code)
        while participant is not None:
            if (sitting := self._sittings.get(code)) is not None:
                with contextlib.suppress(OSError):  # a full disk: of who is deleted no end is to be written
                    await sitting.stop()
                self._sittings.pop(code, None)
                await sitting.close()
                sitting.page = None  # that it goes is nothing to write down
            await asyncio.to_thread(self.hall.await_left, participant.folder)
            if code not in self._sittings:  # nobody came again meanwhile
                return

    async def _stop(self, code: str) -> None:
        sitting, participant = self._sittings.get(code), self.register.get(code)
        if sitting is not None:
            await sitting.stop()
        elif participant is not None and participant.step is not None:
            await self.clerk(participant.end, "stopped")

    def _people(self) -> dict[str, Any]:
        """What the experimenter sees."""
        rows = [self._row(each) for each in self.register]
        seats = sum(each.seat is not None for each in self._sittings.values())
        return {
            "type": "people",
            "title": self.register.study.title,
            "held": self.held,
            "free": self.register.free,
            "slots": len(self.register.study.slots),
            "seats": seats,
            "places": self.places,
            "faults": list(self._faults),
            "rows": rows,
        }

    def _row(self, one: Participant) -> dict[str, Any]:
        row: dict[str, Any] = {**line_of(one), "here": False, "held": False, "problem": "", "lesson": None}
        sitting = self._sittings.get(one.code)
        if sitting is not None:
            row |= {"here": sitting.page is not None, "held": sitting.held, "hidden": sitting.hidden}
            row["problem"] = sitting.problem
            if sitting.seat is not None:
                row["lesson"] = lesson_of(sitting.seat.standing, sitting.state)
        return row

    def _report(self) -> None:
        if self._lookers:
            people = self._people()
            for page in self._lookers:
                page.put(people)

    # --- time

    def _tick_on(self) -> None:
        if self._ticking is None or self._ticking.done():
            self._ticking = asyncio.get_running_loop().create_task(self._tick())

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(SECOND)
            for code, sitting in list(self._sittings.items()):
                await self._guarded(self._second_of(code, sitting))
            await self._guarded(self._expire())
            self._report()

    async def _guarded(self, doing: Awaitable[None]) -> None:
        """What goes wrong with one is told: others have their second, and the next one comes all the same."""
        try:
            await doing
        except Exception as error:
            self.fault(f"{type(error).__name__}: {error}")

    async def _second_of(self, code: str, sitting: Sitting) -> None:
        if not await sitting.tick() and self._sittings.get(code) is sitting and sitting.page is None:
            del self._sittings[code]

    async def _expire(self) -> None:
        if time.monotonic() - self._expired > EXPIRE_EVERY:
            self._expired = time.monotonic()
            await self.clerk(self.register.expire)

    async def close(self) -> None:
        """Gives all seats back; what was to be written is written."""
        if self._ticking is not None:
            self._ticking.cancel()
        for sitting in list(self._sittings.values()):
            await sitting.close()
        await self.clerk(lambda: None)
