"""One path from a key to a row: a session on a task, recorded as it happens, and replayed to the bit.

Over 300 lines: what happens live and what is made again count alike, and are read beside each other.
"""

import contextlib
import math
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from gpcjax.engine.classroom import Classroom
from gpcjax.engine.session import Session
from gpcjax.envs.registry import make_env
from gpcjax.errors import ForeignError, UserError
from gpcjax.lateness import CREDIT
from gpcjax.learners.base import Info
from gpcjax.learners.recipes import check_recipe
from gpcjax.policies.folder import write_folder
from gpcjax.policies.vectors import near
from gpcjax.recording import Recording
from gpcjax.registry import built_in, find
from gpcjax.sweep.build import pack_learned, recipe_of
from gpcjax.teach.beginning import beginning, put
from gpcjax.teach.course import COURSE, RECORD, SAVES, START, Course
from gpcjax.teach.credit import credited
from gpcjax.teach.evaluation import world_of
from gpcjax.teach.kept import Kept, plain, replaced
from gpcjax.teach.origin import Origin
from gpcjax.teach.protocol import Press
from gpcjax.teach.sound import check_end, rooms_in
from gpcjax.teach.tally import Episode, Tally
from gpcjax.teach.world import Moved, World
from gpcjax.teach.worlds import Place, Worlds

UNDOS = 20
"""How many of the latest corrections can be taken back: each keeps a state, of 16 MiB for an action dimension."""

Say = Callable[[str], None]


class Places(Protocol):
    """Where there are others."""

    @property
    def classroom(self) -> Classroom:
        """For the learner."""
        ...

    @property
    def worlds(self) -> Worlds:
        """For the task."""
        ...


class Advised(NamedTuple):
    """What an advice did."""

    info: Info
    step: int
    obs: np.ndarray
    before: float
    """The policy's action there, of the advised dimension."""
    after: float


class Taught:
    """What a person teaches in one folder. Its methods belong to one thread."""

    def __init__(self, folder: Path, course: Course, session: Session, world: World | Place, tally: Tally):
        self.folder, self.course, self.session, self.tally = folder, course, session, tally
        self.world = world
        self._moved: Moved | None = None
        """What the task has come to, as long as that could not be written down."""
        self.broken = False
        """The task has failed at a step: the episode is to end there, as long as that could not be written down."""
        self._noted, self._closed = "", False
        """How far the end of an episode is written down, as long as that is not done: why it ends, and that it has."""

    @classmethod
    def begin(cls, folder: Path, course: Course, origin: Origin | None = None) -> "Taught":
        """A new folder, which exists and is empty; `origin` is what was saved or kept elsewhere, to go on from.

        Raises:
            UserError: it cannot be written, or `origin` is of another task, or means nothing to this learner.
        """
        try:
            start = None
            if origin is not None:
                start = folder / START
                put(origin, start, course)
            course.write(folder)
            learner, state = beginning(course, start)
            session = Session(learner, state, **settings_of(course), record=folder / RECORD)
            taught = cls(folder, course, session, world_of(course, pictures=True), Tally(credited(course)))
            taught.begin_episode()
        except BaseException:  # what never began is no lesson to go on with
            shutil.rmtree(folder / START, ignore_errors=True)
            for name in (COURSE, RECORD):
                (folder / name).unlink(missing_ok=True)
            raise
        return taught

    @classmethod
    def resume(
        cls, folder: Path, say: Say, *, whole: bool = False, places: "Places | None" = None
    ) -> "Taught":
        """What was taught in a folder before, made again from its recording.

        Args:
            folder: made by `begin`.
            say: takes a line for the person, now and then.
            whole: check every step of the task, too, and write nothing; otherwise the steps of the last episode are
                made again, and it goes on from there.
            places: among others, where what was recorded in a classroom goes on. There no episode is begun.

        Raises:
            UserError: it is damaged, or the same events lead elsewhere here; the message names the step.
        """
        course = Course.read(folder)
        record, tally = folder / RECORD, Tally(credited(course))
        first, events = Recording.read(record)
        rooms = rooms_in(record, first["settings"])
        classroom = None
        if rooms is None:
            world = world_of(course, pictures=not whole)
        elif places is None:
            world = Worlds(make_env(course.env), 1).enter(course.seed)
        else:
            world, classroom = places.worlds.enter(course.seed), places.classroom
        last = max((event["episode"] for event in events), default=0)
        ended = any(event["event"] == "end" for event in events[-1:])
        progress = _Progress(say, len(events))

        def told(session: Session, event: Mapping[str, Any], outcome: Any) -> None:
            progress.tell()
            check_end(record, session, event, len(tally.finished))
            if event["event"] == "propose" and (whole or event["episode"] == last):
                taught._follow(session, event["obs"])
            if whole and event["event"] == "note":
                taught._compare(event["values"])
            tally.hear(session, event, outcome)

        start = folder / START if (folder / START).exists() else None
        learner, state = beginning(course, start, rooms[0][0] if rooms else None)
        taught = cls(folder, course, Session(learner, state, **settings_of(course)), world, tally)
        again = {"go_on": not whole, "check_from": 0 if whole else last, "classroom": classroom}
        try:
            taught.session = Session.replay(record, learner, state, told=told, **again)
        except BaseException:
            if places is not None:
                places.worlds.leave(world)
            raise
        if whole:
            return taught
        if not tally.present.obs:
            if events and not ended:  # it was killed after the episode's last line but one
                taught.session.end_episode()
            if places is None:
                taught.begin_episode()
        return taught

    @property
    def episode(self) -> int:
        """Index of the present episode."""
        return len(self.tally.finished)

    @property
    def present(self) -> Episode:
        """The present episode."""
        return self.tally.present

    def step(self) -> Episode | None:
        """Executes what is proposed, and proposes at what comes of it; gives the episode if that has ended.

        A step that was executed and could not be written down is written down by the next call, and none is executed.
        A step at which the task fails is none, and the next call ends the episode there.

        Raises:
            UserError: the task fails, or gives something else than it declares, or the recording cannot be written.
        """
        if not self.behind:
            try:
                moved = self.world.step(self.session.action)
                self.moved(moved)
            except UserError:
                self.broken = True
                raise
            self._moved = moved
        return self.catch_up()

    @property
    def behind(self) -> bool:
        """Whether something has happened that could not be written down yet."""
        return self._moved is not None or self.ending

    @property
    def ending(self) -> bool:
        """Whether that is the end of an episode, or the beginning of the next."""
        over = self._moved is not None and self._moved.over
        return self.broken or over or bool(self._noted) or self._closed

    def catch_up(self) -> Episode | None:
        """Writes down what could not be before; gives the episode if that has ended then.

        Raises:
            UserError: it cannot be written yet.
        """
        if self.ending:
            return self.end("problem" if self.broken else "over")
        if self._moved is not None:
            self._propose(self._moved.obs)
            self._moved = None
        return None

    def moved(self, moved: Moved) -> None:
        """Counts a step of the task: the first part of `step`.

        Raises:
            UserError: its reward leads beyond all numbers: of no return that could be written down.
        """
        total = self.present.total + moved.reward
        if not math.isfinite(total):
            raise UserError(
                f"a step of the task gave the reward {moved.reward}, with which those of the episode add up to {total}"
            )
        self.present.total = total
        self.present.length += 1

    def proposed(self) -> None:
        """Counts what the session has proposed: the last part of `step`."""
        self.tally.hear(self.session, {"event": "propose"}, None)

    def end(self, why: str) -> Episode:
        """Ends the episode and begins the next one.

        Raises:
            UserError: it cannot be written down; the next call goes on where this one came to.
        """
        self._close(why)
        self.begin_episode()
        self._closed = False
        return self.tally.finished[-1]

    def begin_episode(self) -> None:
        """Proposes at the first step of the present episode."""
        self._propose(self.world.begin(self.episode))

    def close(self, why: str) -> Episode:
        """Ends the episode, and begins none."""
        present = self.present
        values = {"ended": self._noted or why, "total": present.total, "length": present.length}
        if not self._noted:
            self.session.note(**values)
            self._noted = why
        self.session.end_episode()
        self._noted = ""
        self.tally.hear(self.session, {"event": "note", "values": values}, None)
        return present

    def advise(self, press: Press) -> Advised:
        """Learns from a key.

        Raises:
            UserError: it cannot be written down; nothing was learned then.
        """
        size = self.session.learner.action_size
        advice = np.zeros(size)
        advice[press.dim] = press.h
        about = self.tally.about()
        self.session.note(press=list(press))
        done = self.session.advise_about(advice, about)
        self.tally.hear(self.session, {"event": "advise", "advice": advice.astype(int).tolist()}, done.info)
        before, after = (float(action[press.dim]) for action in (done.before, done.after))
        return Advised(done.info, self.session.step, np.asarray(about), before, after)

    def undo(self) -> bool:
        """Takes the latest advice back; False if there is none.

        Raises:
            UserError: it cannot be written down; nothing was taken back then.
        """
        if self._noted:  # what the note says of the episode is as it was before
            self._close(self._noted)
        done = self.session.undo()
        self.tally.hear(self.session, {"event": "undo"}, done)
        return done

    def picture(self) -> np.ndarray | None:
        """What the task looks like now, (height, width, 3) uint8; None if it makes no pictures."""
        return self.world.picture()

    def save(self, name: str) -> None:
        """Keeps the learner under a name, in place of what was kept there before.

        Raises:
            UserError: it cannot be written, or what a learner of one's own learns has no form in which it could be.
        """
        session, place = self.session, self.folder / SAVES / name
        if self.course.algo in built_in("learner"):
            replaced(place, lambda path: session.save(path, env=self.course.env))
            return
        cell = self.course.cell(1)
        check_recipe(recipe_of(cell), f"save {name}")
        card, arrays = pack_learned(cell, session.learner, session.state)
        card["provenance"] = {"env": self.course.env}
        replaced(place, lambda path: write_folder(path, card, arrays))

    def keep(self) -> Callable[[], None]:
        """What writes the rows as they are now and the policy, whenever it is called, in whatever thread.

        The policy is that of then: to take its state out of a session is a copy of megabytes, for which no step waits.
        """
        kept = self.kept()
        return lambda: kept(self.session).write()

    def kept(self) -> "Callable[[Session], Kept]":
        """The same, as something that another process may write; the session is asked for its state."""
        tally = self.tally
        measured = tally.measurements(), tally.own(), tally.log()

        def kept(session: Session) -> Kept:
            state = jax.tree.map(plain, session.state)
            return Kept(self.folder, self.course, session.learner, state, session.corrections, measured)

        return kept

    def _close(self, why: str) -> None:
        if not self._closed:
            self.close(why)
            self._closed, self.broken, self._moved = True, False, None

    def _propose(self, obs: np.ndarray) -> None:
        self.session.propose(obs)
        self.proposed()

    def _follow(self, session: Session, recorded: list[float]) -> None:
        """Moves the task to the step that a recording tells of."""
        place = f"episode {session.episode}, step {session.step}"
        if session.step == 0:
            with _at(place):
                obs = self.world.begin(session.episode)
        else:
            with _at(place):
                moved = self.world.step(np.asarray(self.present.actions[-1]))
            obs = moved.obs
            self.present.total += moved.reward
            self.present.length += 1
        if (here := near(obs).tolist()) != recorded:  # as `Session.propose` has it recorded
            raise UserError(f"{place}: the task was at {recorded}, here it is at {here}")

    def _compare(self, values: Mapping[str, Any]) -> None:
        """That an episode came to what was written down of it."""
        if "ended" not in values or not self.present.obs:
            return
        total = self.present.total
        if values["length"] == len(self.present.obs):  # the last step was executed, too
            with _at(f"episode {self.episode}, its last step"):
                total += self.world.step(np.asarray(self.present.actions[-1])).reward
        if total != values["total"]:
            raise UserError(f"episode {self.episode}: it returned {values['total']}, it is {total} here")


@contextlib.contextmanager
def _at(place: str) -> Iterator[None]:
    """What a task refuses while it is made again is told with its place."""
    try:
        yield
    except ForeignError as error:
        message, *rest = error.arguments
        raise ForeignError(f"{place}: {message}", *rest) from None
    except UserError as error:
        raise UserError(f"{place}: {error}") from None


class _Progress:
    """Says how far a recording is made again, every second."""

    def __init__(self, say: Say, events: int):
        self._say, self._events, self._done, self._said = say, events, 0, time.monotonic()

    def tell(self) -> None:
        self._done += 1
        if time.monotonic() - self._said > 1.0:
            self._said = time.monotonic()
            self._say(f"making the recording again: {self._done:,} of {self._events:,} events")


def settings_of(course: Course) -> dict[str, Any]:
    """Those of the session of a course."""
    given = dict(course.settings)
    credit = {name: given.get(name) for name in CREDIT}
    seconds = find("task", course.env).seconds
    return {**credit, "time_step": seconds, "seed": course.seed, "undos": UNDOS}
