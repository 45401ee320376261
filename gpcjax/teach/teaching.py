"""What is being taught, between two steps: what the page asks for, and what a step brings.

Over in a moment, as the clock waits meanwhile; what can wait is an errand of the `Teller`. What fails of a person's own
code, or cannot be written, rests the lesson and is told.
"""

import contextlib
import time
from collections.abc import Iterator

from gpcjax.teach.course import seconds_of
from gpcjax.teach.evaluation import Evaluation
from gpcjax.teach.problems import problem
from gpcjax.teach.protocol import Command, Press
from gpcjax.teach.standing import Standing
from gpcjax.teach.tally import Episode
from gpcjax.teach.taught import Taught
from gpcjax.teach.teller import Teller

LATEST = 0.25
"""Seconds that the clock may be behind; what is beyond is let go, as after a laptop slept."""


class Teaching:
    """A course that is taught now. Its methods belong to the lesson's thread.

    Args:
        taught: what is taught, and kept.
        standing: how the lesson stands, which is changed here.
        tell: who tells the page.
    """

    def __init__(self, taught: Taught, standing: Standing, tell: Teller):
        self._taught, self._standing, self._tell = taught, standing, tell
        self._seconds = seconds_of(tell.task)
        self._first_of_episode, self._due = tell.number + 1, 0.0
        self._evaluation: Evaluation | None = None

    @property
    def wait(self) -> float | None:
        """Seconds until the next step is due; None while it rests."""
        return None if self._standing.paused else self._due - time.perf_counter()

    def step_if_due(self) -> None:
        """One step, once its time has come."""
        standing, behind = self._standing, time.perf_counter() - self._due
        if standing.paused or behind < 0:
            return
        standing.late = 1000 * behind
        if behind > LATEST:
            self._due += behind
        self._due += self._seconds / standing.speed
        self._tick()

    def obey(self, command: Command) -> None:
        """Does what the page asks for; what is no matter of this course is left alone."""
        match command:
            case Command("joined"):
                self._tell.everything()
            case Command("left"):
                self._pause("connection")
            case Command("press", _, Press() as press):
                self._press(press)
            case Command("pause", {"on": True}):
                self._pause("you")
            case Command("pause", {"on": False}):
                self._go_on()
            case Command("step") if self._standing.paused:
                self._standing.late = 0.0
                self._tick()
            case Command("reset"):
                self._reset()
            case Command("undo"):
                self._undo()
            case Command("speed", {"value": value}):
                self._standing.speed = float(value)
                self._due = time.perf_counter()
                self._tell.state()
            case Command("run", {"on": on}):
                self._run_alone(on)
            case Command("map", {"x": x, "y": y, "dim": dim}):
                self._tell.ask_chart(x, y, dim)
            case Command("save", {"name": name}):
                with self._resting_on_problems():
                    self._taught.save(name)
                    self._tell.saved(name)

    def _tick(self) -> None:
        alone = self._evaluation
        if alone is None:
            with self._resting_on_problems():
                self._told(self._taught.step())
                self._tell.frame(None)
            if self._taught.broken:
                with self._resting_on_problems():
                    self._catch_up()
            return
        with self._teaching_again_on_problems():
            if alone.step():
                self._tell.episode(alone.index, alone, 0, "over")
                alone.again()
            self._tell.frame(alone)

    def _told(self, ended: Episode | None) -> None:
        """Tells of an episode, if one has ended."""
        if ended is not None:
            self._first_of_episode = self._tell.number + 1
            self._tell.episode(self._taught.episode - 1, ended, ended.corrections, ended.why)
            self._tell.keep()

    @contextlib.contextmanager
    def _resting_on_problems(self) -> Iterator[None]:
        try:
            yield
        except Exception as raised:
            self._tell.problem(problem(raised, self._taught.course))
            self._pause("problem")

    @contextlib.contextmanager
    def _teaching_again_on_problems(self) -> Iterator[None]:
        """The same where the policy runs alone: then it does no longer."""
        with self._resting_on_problems():
            try:
                yield
            except Exception:
                self._evaluation, self._standing.mode = None, "teach"
                self._tell.frame(None)
                raise

    def _press(self, press: Press) -> None:
        standing = self._standing
        if standing.mode != "teach" or press.dim >= self._taught.session.learner.action_size:
            return
        if press.shown and press.shown < self._first_of_episode:
            return  # it was about an episode that is over, or another lesson
        if standing.paused and standing.why in ("start", "connection"):
            self._go_on()
        with self._resting_on_problems():
            if self._catch_up():
                return  # so is the episode that it was about
            self._tell.advised(press, self._taught.advise(press))

    def _catch_up(self) -> bool:
        """Writes down and shows what could not be written before; whether an episode ended with it."""
        if not self._taught.behind:
            return False
        ended = self._taught.catch_up()
        self._told(ended)
        self._tell.frame(None)
        return ended is not None

    def _undo(self) -> None:
        if self._standing.mode != "teach":
            return
        with self._resting_on_problems():
            if self._taught.undo():
                self._tell.undone()
            if not self._taught.behind:
                self._tell.frame(None)
            self._catch_up()  # afterwards, as it may be this advice with which the policy comes to no action

    def _reset(self) -> None:
        alone = self._evaluation
        if alone is not None:
            with self._teaching_again_on_problems():
                self._tell.episode(alone.index, alone, 0, "reset")
                alone.again()
                self._tell.frame(alone)
            return
        with self._resting_on_problems():
            if self._taught.ending:
                self._catch_up()
                return
            self._told(self._taught.end("reset"))
            self._tell.frame(None)

    def _run_alone(self, on: bool) -> None:
        if on == (self._evaluation is not None):
            return
        if on:
            with self._teaching_again_on_problems():
                policy = self._taught.session.policy()
                self._evaluation = Evaluation(policy, self._taught.course, self._taught.episode)
                self._standing.mode = "run"
                self._go_on()
                self._tell.frame(self._evaluation)
            return
        self._evaluation, self._standing.mode = None, "teach"
        self._pause("you")
        self._tell.frame(None)

    def _pause(self, why: str) -> None:
        standing = self._standing
        if not standing.paused or why == "problem":
            standing.paused, standing.why = True, why
            self._tell.keep(0.0)
        self._tell.state()

    def _go_on(self) -> None:
        standing = self._standing
        if standing.paused:
            standing.paused, standing.why = False, ""
            self._due = time.perf_counter()
            self._tell.flush()
        self._tell.state()
