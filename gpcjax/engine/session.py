"""Teaching in a program of one's own: a person at a keyboard, a robot's control loop, another simulator.

The steps are those of the engine's own loops, on a block of one lane: `propose` is what acts there, and what follows
advice is `gpcjax.engine.correcting.correct`, with the same reckoning for advice that comes late. A session among others
in a classroom does the same on one lane of many (`gpcjax.engine.seated`).

Over 300 lines: half of them say what its methods do, to those who call them. Where it stands is in
`gpcjax.engine.course`, how it is made again in `gpcjax.engine.reopening`.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gpcjax._x64 import set_public_methods_under_own_settings, under_own_settings
from gpcjax.allowed import is_no_data, shown
from gpcjax.engine.classroom import Classroom
from gpcjax.engine.course import Course, checked_settings, credit_of
from gpcjax.engine.desk import Advised, Alone, Desk
from gpcjax.engine.pupil import Pupil
from gpcjax.engine.reopening import Told, reopened, replay
from gpcjax.engine.single import single
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.gp.threads import one_thread
from gpcjax.learners.base import Info, Learner, State
from gpcjax.learners.compiled import rehearse
from gpcjax.learners.saved import load_learner, save_learner
from gpcjax.policies.base import Policy, Vector, check_executed, vector
from gpcjax.policies.folder import read_card
from gpcjax.policies.vectors import near
from gpcjax.recording import Deferred, Recording, as_json


class Session:
    """One learner, taught while it acts.

        session = gpcjax.Session(gpcjax.make_learner("gpc", "cartpole"))
        action = session.propose(obs)    # what to execute, (action_size,) in [-1, 1]
        session.advise([1])              # "more": learned at once, about the step just proposed

    All methods may be called from several threads: a control loop proposes while a person's key advises.

    Args:
        learner: from `make_learner`, or of one's own.
        state: to go on from; without one, an untaught one.
        credit, credit_longest, credit_shape: seconds between a step and the advice about it, as the settings of a sweep
            of these names have it; without them, all advice is about the latest step.
        time_step: seconds of a step, for these.
        seed: of what the learner draws.
        undos: how many of the latest corrections can be undone.
        record: a file to which every event is appended at once; `Session.replay` makes the session of it again, to the
            bit. It must not exist.

    Raises:
        ValueError: an argument of another kind; the message names it.
    """

    def __init__(
        self,
        learner: Any,
        state: Any = None,
        *,
        credit: Any = None,
        credit_longest: Any = None,
        credit_shape: Any = None,
        time_step: Any = 1.0,
        seed: Any = 0,
        undos: Any = 20,
        record: Any = None,
    ):
        if not isinstance(learner, Learner):
            raise UserError(f"learner {shown(learner)}: give a learner, from make_learner")
        settings = checked_settings(
            {
                "credit": credit,
                "credit_longest": credit_longest,
                "credit_shape": credit_shape,
                "time_step": time_step,
                "seed": seed,
                "undos": undos,
            }
        )
        learner = fixed(learner)
        rehearse(learner, state)
        block = single(learner, state, credit_of(settings), settings["seed"])
        self._sit(learner, Course(Alone(learner, block), settings))
        self._begin_record(record)

    def _sit(self, learner: Learner, course: Course) -> None:
        self.learner: Learner = learner
        self._course = course
        self._lock = threading.RLock()
        self._undos: deque[tuple[Desk, int]] = deque(maxlen=course.settings["undos"])

    @classmethod
    def _seated(cls, learner: Learner, desk: Desk, settings: Mapping[str, Any]) -> "Session":
        session = cls.__new__(cls)
        session._sit(learner, Course(desk, settings))
        return session

    def _begin_record(self, path: Any) -> None:
        if path is not None:
            self._course.record(Recording.new(path, self._course.settings, self._course.place()))

    @property
    def episode(self) -> int:
        """Of the latest step, from 0."""
        return self._course.episode

    @property
    def step(self) -> int:
        """The latest step of the episode, from 0; -1 before the first."""
        return self._course.step

    @property
    def obs(self) -> Float[np.ndarray, " obs"]:
        """Of the latest step."""
        return self._course.desk.obs

    @property
    def action(self) -> Float[np.ndarray, " action"]:
        """What was executed at the latest step."""
        return self._course.desk.action

    @property
    def proposed(self) -> Float[np.ndarray, " action"]:
        """What the policy proposed at the latest step, before it was clipped to [-1, 1]."""
        return self._course.proposed.copy()

    @property
    def corrections(self) -> int:
        """Advice that was learned, and not undone, counted for each action dimension."""
        return self._course.corrections

    @property
    def latest(self) -> tuple[list[float], list[float]]:
        """Observation and action as they were when the latest step was proposed."""
        return self._course.latest

    @property
    def undos(self) -> int:
        """How many of the latest advices `undo` can take back, also those from which nothing was learned."""
        return len(self._undos)

    @property
    @under_own_settings
    def state(self) -> State:
        """The learner's state."""
        return self._course.desk.state

    def propose(self, obs: Vector) -> Float[np.ndarray, " action"]:
        """The action to execute at `obs` (obs_size,): (action_size,), in [-1, 1]. It begins a step.

        The step before is over then, and was executed as proposed, unless `executed` told otherwise.

        Raises:
            ValueError: another shape, or what is no number, in `obs` or as the policy's action.
        """
        obs = near(self._numbers("obs", obs, self.learner.obs_size))
        course = self._course
        with self._lock:
            desk = course.desk.idled() if course.idles else course.desk
            desk, proposed, finite = desk.stepped(obs, *course.flags)
            if not finite:
                raise no_number(obs)
            with course.recorded():
                course.desk = desk
                action = desk.action
                course.stepped(obs.tolist(), proposed, action.tolist())
            return action

    def act(self, obs: Vector) -> Float[np.ndarray, " action"]:
        """What the policy does at `obs` (obs_size,) now: (action_size,), in [-1, 1]. No step begins."""
        obs = near(self._numbers("obs", obs, self.learner.obs_size))
        return self._course.desk.acts(obs)

    def act_at(self, obs: Any) -> Float[np.ndarray, "action points"]:
        """The same at many observations, the columns of `obs` (obs_size, points), an array or lists.

        Raises:
            ValueError: another shape, or what is no number.
        """
        size = self.learner.obs_size
        try:
            given = np.asarray(obs)
        except (TypeError, ValueError):  # of several lengths
            given = np.empty(0)
        if given.ndim != 2 or len(given) != size or given.dtype.kind not in "fiu" or is_no_data(obs):
            raise UserError(f"obs {shown(obs)}: give real numbers of shape ({size}, points)")
        if not np.isfinite(given).all():
            raise UserError(f"obs {shown(obs)}: each entry must be finite")
        return self._course.desk.acts_at(near(given.astype(float)))

    def executed(self, action: Vector) -> None:
        """Says what was executed at the latest step, where that is not what was proposed: advice is about this.

        Raises:
            ValueError: another shape, an entry beyond [-1, 1] or no number, or no step has begun.
        """
        action = self._numbers("action", action, self.learner.action_size)
        check_executed(action)
        course = self._course
        with self._lock:
            course.check_begun()
            with course.recorded():
                course.desk = course.desk.executed(action)
                course.keep("executed", action=action.tolist())

    def advise(self, advice: Vector | float) -> Info:
        """Learns from advice: -1 for less, 1 for more, 0 for none, for each action dimension; or one number for one.

        Returns what was done, each field (action_size,); with credit for several steps, at the latest of them. A
        dictionary that is full is given twice the room first.

        Raises:
            ValueError: another shape or value, or no step has begun.
        """
        return self.advise_about(advice, None).info

    def advise_about(self, advice: Vector | float, about: Vector | None) -> Advised:
        """The same, and what the policy does at `about` (obs_size,) before and after; NaN without one."""
        entries: Any = [advice] if np.ndim(advice) == 0 else advice
        given = np.asarray(vector("advice", entries, self.learner.action_size, "this learner"))
        if not np.isin(given, (-1.0, 0.0, 1.0)).all():
            raise UserError(f"advice {shown(given.tolist())}: each entry must be -1, 0 or 1")
        course = self._course
        with self._lock:
            course.check_begun()
            before = course.desk, course.corrections
            place = None if about is None else self._numbers("about", about, self.learner.obs_size)
            with one_thread() if self.learner.factorises else contextlib.nullcontext():
                desk, done = course.desk.advised(given, place)
            with course.recorded():
                course.corrections += done.corrections
                course.desk = desk
                course.keep("advise", advice=given.astype(int).tolist())
            self._undos.append(before)
            return done

    def undo(self) -> bool:
        """Takes the latest advice back, with all that was learned since; False if there is none to take back.

        Advice from which nothing was learned, as it was zero or there was no room for it, is one to take back, too.
        """
        course = self._course
        with self._lock:
            if not self._undos:
                return False
            before, corrections = self._undos[-1]
            with course.recorded():
                course.corrections = corrections
                course.desk = course.desk.taken_back(before)
                course.keep("undo")
            self._undos.pop()
            return True

    def end_episode(self) -> None:
        """The next step begins a new episode: advice that comes then is never about this one."""
        course = self._course
        with self._lock, course.recorded():
            course.begins = course.begun
            course.keep("end")

    def note(self, **values: Any) -> None:
        """Keeps `values`, as JSON knows them, in the recording, if there is one: when a key was pressed, for one.

        Raises:
            ValueError: JSON knows no such value; of numpy's, numbers and arrays of them are taken.
        """
        known = as_json(values)
        with self._lock:
            self._course.keep("note", values=known)

    def flush(self) -> None:
        """Has the recording on the disk, as far as it goes; without it, that is left to the system.

        Raises:
            ValueError: it cannot be written.
        """
        self._course.flush()

    def uncertainty(self) -> Float[np.ndarray, " action"]:
        """sigma_h at the latest step and what was executed there: how little advice was given about it.

        NaN for a learner that does not know it.

        Raises:
            ValueError: no step has begun.
        """
        if not self._course.begun:
            raise UserError("no step has begun: call propose first")
        return self._course.desk.uncertain()

    def warm_up(self, *, ahead: bool = False) -> None:
        """Compiles all that steps and advice need, which otherwise happens when they come first; nothing is learned.

        It may run in a thread of its own while others go on.

        Args:
            ahead: not for the room that there is in the dictionaries, but for twice of it, which is given when they
                are full.
        """
        self._course.desk.warm_up(ahead)

    @property
    def points(self) -> tuple[int, int]:
        """Points held by the policies and by the human models, over all action dimensions; 0, 0 without any."""
        return self._course.desk.points

    def measure(self) -> dict[str, float]:
        """What the learner measures of itself, by name (`Learner.measure`)."""
        return self._course.desk.measured()

    def policy(self) -> Policy:
        """What has been taught so far, as a function of an observation; it stays as it is."""
        return self.learner.policy_of(self.state)

    def save(self, path: Any, **provenance: Any) -> None:
        """Writes learner, state and the steps that late advice may be about into a new folder, for `Session.load`.

        What could be undone is not kept.

        Raises: as `gpcjax.save_learner`.
        """
        with self._lock:
            session = {"settings": self._course.settings, "place": self._course.place()}
            save_learner(path, self.learner, self.state, session=session, **provenance)

    @classmethod
    @under_own_settings
    def load(cls, path: Any, record: Any = None) -> "Session":
        """The session that `save` wrote, at the same step: what follows is the same to the bit.

        Args:
            path: the folder.
            record: as of a new session. To replay it takes the learner and the state in the folder (`load_learner`).

        Raises:
            ValueError: there is no session at `path`, or it is damaged.
        """
        learner, state = load_learner(path)
        kept = read_card(path, "learner").get("provenance", {}).get("session")
        if not isinstance(kept, Mapping):
            raise UserError(f"{path}: this is a learner without a session: give it to gpcjax.Session")
        session = reopened(cls, str(path), learner, state, kept)
        session._begin_record(record)
        return session

    @classmethod
    @under_own_settings
    def replay(
        cls,
        record: Any,
        learner: Learner,
        state: State | None = None,
        *,
        go_on: bool = False,
        told: Told | None = None,
        check_from: int = 0,
        classroom: Classroom | None = None,
    ) -> "Session":
        """The session whose events are in the file `record`, made again: the same to the bit, on the same machine.

        Args:
            record: what a session with `record=` has written, also one whose program has died.
            learner, state: those that it was begun with.
            go_on: append what follows to the same file.
            told: called after each event with the session, the event, and what its method gave.
            check_from: the first episode in which actions are worked out anew. Those before, of a session in a
                classroom, are taken as they were recorded, which is a hundred times as fast.
            classroom: where there is a place for it, of a session in a classroom; without one, in one of its own.

        Raises:
            ValueError: the file cannot be read, is no recording, or one of another kind of learner; or an action is
                another one than was recorded, as on another kind of machine. The message names line and step.
        """
        first, events = Recording.read(record)
        session = reopened(cls, str(record), learner, state, first, classroom)
        try:
            replay(session, record, events, told, check_from)
            if go_on:
                kind = Recording if classroom is None else Deferred
                session._course.record(kind.again(record))
        except BaseException:
            desk = session._course.desk
            if classroom is not None and isinstance(desk, Pupil):
                desk.leave()
            raise
        return session

    def _numbers(self, name: str, value: Vector, size: int) -> np.ndarray:
        numbers = np.asarray(vector(name, value, size, "this learner"))
        if not np.isfinite(numbers).all():
            raise UserError(f"{name} {shown(numbers.tolist())}: each entry must be finite")
        return numbers


def no_number(obs: Float[np.ndarray, " obs"]) -> UserError:
    """The error of a policy whose action at an observation is none."""
    return UserError(f"the policy's action at {shown(obs.tolist())} is no number")


set_public_methods_under_own_settings(Session)
