"""One participant at the server: the page, the step, and in a run the seat. Belongs to the server's event loop.

What changes a participant is written by one clerk's thread before anything of it is shown. A seat blocks nobody: what
it says comes when it is ready.

Over 300 lines: one class, the answers to all that a page, a seat and the experimenter may say.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any, Protocol

from gpcjax.errors import UserError
from gpcjax.study.blind import PROBLEM, blinded
from gpcjax.study.mailbox import Mailbox
from gpcjax.study.needed import Needed
from gpcjax.study.participant import Participant
from gpcjax.study.showing import present, wrong
from gpcjax.study.steps import Step
from gpcjax.teach.pages import Page
from gpcjax.teach.protocol import Command, Press

if TYPE_CHECKING:
    from gpcjax.study.hall import Hall, Run, Seat

GRACE = 60.0
"""Seconds for which the seat of somebody without a page stays taken: a reload finds it as it was."""
AGAIN = 2.0
"""Seconds after which a seat is asked for once more where there was none."""

WAITING = "All places are taken at the moment. Please wait: you go on as soon as one is free."

Say = Callable[[dict[str, Any] | bytes], None]


class Surroundings(Protocol):
    """What a sitting needs of the server."""

    hall: "Hall"
    held: bool
    """Whether the experimenter has paused all."""

    @property
    def mailbox(self) -> Mailbox:
        """What seats say comes through it."""
        ...

    def clerk(self, do: Callable[..., Any], *given: Any) -> Awaitable[Any]:
        """Does something on the disk, one thing after the other, in a thread of its own."""
        ...

    def run_of(self, participant: Participant, step: Step) -> "Run":
        """What a step has taught."""
        ...


class Sitting:
    """A participant, from the first page to the last.

    Args:
        participant: who.
        reception: of the server.
    """

    def __init__(self, participant: Participant, reception: Surroundings):
        self.participant, self._reception = participant, reception
        self.page: Page | None = None
        self.seat: Seat | None = None
        self.held = False
        """Whether the experimenter has paused this one."""
        self.hidden = False
        self.problem = ""
        """The latest."""
        self.state: dict[str, Any] = {"paused": True, "why": "start"}
        self._loop, self._mailbox = asyncio.get_running_loop(), reception.mailbox
        self._lock = asyncio.Lock()
        self._generation = 0
        self._asked = self._gone = self._acted = self._rested = 0.0
        self._sits = False
        """Whether the seat is prepared."""
        self._goes_on = True
        """Whether what was shown is a step, and no end."""
        self._needed = Needed()
        self._tasks: set[asyncio.Task[None]] = set()

    # --- pages

    async def come(self, page: Page) -> None:
        """A page shows this participant from now on; another one is told so and closed."""
        if self.page is not None:
            self.page.close("took over")
            if self.seat is not None:
                self.seat.pause("connection")
        self.page, self.hidden = page, False
        self._log("here")
        async with self._lock:
            await self._show()

    async def go(self, page: Page) -> None:
        """A page is gone."""
        if self.page is not page:
            return
        self.page, self._gone = None, time.monotonic()
        if self.seat is not None:
            self.seat.pause("connection")
        self._log("gone")
        try:
            await self._reception.clerk(self.participant.save)
        except OSError as error:  # the page goes all the same
            self.problem = str(error)

    def tell(self, message: dict[str, Any] | bytes) -> None:
        """Says something to the page, if there is one."""
        if self.page is not None:
            self.page.put(message)

    async def _show(self) -> None:
        """Tells the page where it is, and has a seat where one is needed."""
        step = self.participant.step
        self._goes_on = step is not None
        self.tell(present(self.participant, self._rested - time.monotonic()))
        self.tell({"type": "held", "on": self.is_held})
        if step is None or step.kind not in ("run", "trial"):
            self._release()
        elif self.seat is not None:
            self.seat.everything()
        else:
            self._take_seat(step)

    def _take_seat(self, step: Step) -> None:
        self._release()
        self._asked = time.monotonic()
        self.state, self._needed, self._sits = {"paused": True, "why": "start"}, Needed(), False
        try:
            run = self._reception.run_of(self.participant, step)
            self.seat = self._reception.hall.seat(run, self._said_by(self._generation))
        except UserError as error:
            self._trouble(str(error))
            self.tell({"type": "waiting", "text": WAITING})

    def _release(self) -> None:
        seat, self.seat = self.seat, None
        self._generation += 1  # what it still says is about something that is over
        if seat is not None:
            seat.leave()

    # --- what a seat says

    def _said_by(self, generation: int) -> Say:
        """Takes the messages of one seat, from any thread."""
        return lambda message: self._mailbox.post(self._hear_seat, generation, message)

    def _hear_seat(self, generation: int, message: dict[str, Any] | bytes) -> None:
        if generation != self._generation:
            return
        if isinstance(message, bytes):
            self.tell(message)
            return
        match message["type"]:
            case "over":
                self._later(self._over(generation))
                return
            case "task":
                self._sits = True
                if self._is_trial:
                    self._ask_for_keys(message["task"])
            case "state":
                self.state = message
            case "problem":
                self._trouble(str(message.get("text", "")))
                if not self._sits:  # it could not be prepared: another try comes with a later tick
                    self._release()
            case "episode" if self._is_trial:
                trial = self.participant.study.trial
                if trial is not None and trial.passes == "return" and message["total"] >= trial.total:
                    self._later(self._pass())
        told = blinded(message, self._cue)
        if told is not None:
            self.tell(told)

    async def _over(self, generation: int) -> None:
        """A run is complete and written."""
        async with self._lock:
            if generation != self._generation:
                return
            self._release()
            if self._is_trial:
                await self._reception.clerk(self.participant.attempted, False)
            else:
                await self._reception.clerk(self.participant.advance, "run")
                self._rested = time.monotonic() + self.participant.study.runs.rest
            await self._show()

    @property
    def _is_trial(self) -> bool:
        step = self.participant.step
        return step is not None and step.kind == "trial"

    @property
    def _cue(self) -> bool:
        step, study = self.participant.step, self.participant.study
        return step is not None and step.run is not None and study.arm(step.run.treatment.arm).cue

    # --- the trial

    def _ask_for_keys(self, task: dict[str, Any]) -> None:
        trial = self.participant.study.trial
        if trial is not None and trial.passes == "keys":
            self._needed.begin(task, trial.presses)
            self._loop.call_soon(self._tell_needed)  # behind the task that it is about

    def _tell_needed(self) -> None:
        if (message := self._needed.message()) is not None:
            self.tell(message)

    async def _pass(self) -> None:
        async with self._lock:
            if self._is_trial:
                self._release()
                await self._reception.clerk(self.participant.attempted, True)
                await self._show()

    # --- what the page says

    async def hear(self, command: Command) -> None:
        """One command of the page."""
        self.participant.touch()
        match command:
            case Command("press", _, Press() as press):
                self._press(press)
            case Command("pause", {"on": on}):
                self._pause(on)
            case Command("hidden", {"on": on}):
                self._hide(on)
            case _:
                async with self._lock:
                    await self._move(command)

    async def _move(self, command: Command) -> None:
        """What may lead to another step; what does not fit to the present one comes from a page that is behind."""
        one, step = self.participant, self.participant.step
        if step is None:
            return
        try:
            match command.type, step.kind:
                case "agree", "consent":
                    agreed = command.values["on"]
                    await (
                        self._reception.clerk(one.advance, "consent")
                        if agreed
                        else self._reception.clerk(one.end, "declined", "gave no consent")
                    )
                case "measured", "check":
                    passed = not wrong(one.study.check, command.values)
                    await self._reception.clerk(one.checked, command.values, passed)
                case "go_on", "instructions":
                    await self._reception.clerk(one.advance, "instructions")
                case "answers", "questions":
                    await self._reception.clerk(one.answered, command.values["values"])
                case "leave", _:
                    await self._reception.clerk(one.end, "declined")
                case _:
                    return
        except UserError as error:
            self.tell({"type": "problem", "text": str(error)})
            return
        except OSError as error:  # a full disk: nothing has changed
            self._trouble(str(error))
            self.tell({"type": "problem", "text": PROBLEM})
            return
        await self._show()

    def _press(self, press: Press) -> None:
        seat, step = self.seat, self.participant.step
        if seat is None or step is None or self.state["paused"]:
            return
        self._acted = time.monotonic()
        delay = 0.0 if step.run is None else self.participant.study.arm(step.run.treatment.arm).delay
        if delay > 0:
            self._loop.call_later(delay, lambda: self.seat is seat and seat.press(press))
        else:
            seat.press(press)
        if self._is_trial and self._needed.counts(press):
            self._tell_needed()
            if self._needed.passed:
                self._later(self._pass())

    def _pause(self, on: bool) -> None:
        if self.seat is None:
            return
        if on:
            self.seat.pause("you")
        elif not self.is_held and not self.hidden and time.monotonic() >= self._rested:
            self._acted = time.monotonic()
            self.seat.go_on()

    def _hide(self, on: bool) -> None:
        if self.hidden == on:
            return
        self.hidden = on
        if self.runs:
            self._log("away" if on else "back")
        if on and self.seat is not None and not self.state["paused"]:
            self.seat.pause("away")

    # --- what the experimenter wants

    @property
    def is_held(self) -> bool:
        """Whether the experimenter has paused this one, or all."""
        return self.held or self._reception.held

    @property
    def runs(self) -> bool:
        """Whether there is a lesson at this step."""
        return self.seat is not None

    def hold(self) -> None:
        """Rests, or may go on, as the experimenter has it now."""
        if self.is_held and self.seat is not None and not self.state["paused"]:
            self.seat.pause("experimenter")
        self.tell({"type": "held", "on": self.is_held})
        self._log("held" if self.is_held else "let go")

    async def stop(self) -> None:
        """Ends it all, by the experimenter."""
        async with self._lock:
            self._release()
            if self.participant.step is not None:
                await self._reception.clerk(self.participant.end, "stopped")
            await self._show()

    async def close(self) -> None:
        """Gives the seat back, and closes the page."""
        async with self._lock:
            self._release()
        if self.page is not None:
            self.page.close("the study has ended")

    async def tick(self) -> bool:
        """What a second brings; False when nothing is here any more."""
        now = time.monotonic()
        idle = self.participant.study.runs.idle
        if self.seat is not None and not self.state["paused"] and idle and now - self._acted > idle:
            self.seat.pause("idle")
            self._acted = now
            self._log("idle")
        if self.page is None and now - self._gone > GRACE:
            async with self._lock:
                if self.page is None:
                    self._release()
            return self.page is not None or self.seat is not None
        step = self.participant.step
        wants = step is not None and step.kind in ("run", "trial") and self.seat is None
        ended = self._goes_on and step is None  # as the time to come back has run out
        asks = self.page is not None and wants and now - self._asked > AGAIN
        if (ended or asks) and not self._lock.locked():
            async with self._lock:
                await self._show()
        return True

    # --- the disk

    def _trouble(self, text: str) -> None:
        self.problem = text
        self._log("problem", text=text)

    def _log(self, event: str, **values: Any) -> None:
        step = self.participant.step
        given = {"step": None if step is None else step.name, **values}
        self._later(self._reception.clerk(lambda: self.participant.log(event, **given)))

    def _later(self, doing: Awaitable[Any]) -> None:
        """Has something done soon; what it raises is told to the experimenter."""

        async def done() -> None:
            try:
                await doing
            except (OSError, UserError) as error:
                self.problem = str(error)

        task = self._loop.create_task(done())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
