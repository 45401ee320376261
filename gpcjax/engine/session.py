"""Teaching in a program of one's own: a person at a keyboard, a robot's control loop, another simulator.

The steps are those of the engine's own loops, on a block of one lane: `propose` is what acts there, and what follows
advice is `gpcjax.engine.correcting.correct`, with the same reckoning for advice that comes late. A session among others
in a classroom does the same on one lane of many (`gpcjax.engine.classroom`).
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gpcjax._x64 import set_public_methods_under_own_settings, under_own_settings
from gpcjax.allowed import NON_NEGATIVE, POSITIVE, Numbers, checked, shown
from gpcjax.engine.classroom import Classroom, Pupil, idle, propose, rooms_of
from gpcjax.engine.desk import Advised, Alone, Desk
from gpcjax.engine.history import Credit
from gpcjax.engine.single import single
from gpcjax.errors import UserError
from gpcjax.gp.threads import one_thread
from gpcjax.learners.base import Info, Learner, State
from gpcjax.learners.saved import load_learner, save_learner
from gpcjax.policies.base import Policy, Vector, check_executed, vector
from gpcjax.policies.folder import read_card
from gpcjax.recording import Deferred, Recording

_NUMBERS = {
    "credit": (float, NON_NEGATIVE),
    "credit_longest": (float, NON_NEGATIVE),
    "credit_shape": (float, POSITIVE),
    "time_step": (float, POSITIVE),
    "seed": (int, Numbers(0, 2**63 - 1, whole=True)),
    "undos": (int, Numbers(0, 1_000, whole=True)),
}

ROOMS = "rooms"
"""The setting that a session in a classroom has beside: the room of its dictionaries, as it grows."""


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
        late = {"credit": credit, "credit_longest": credit_longest, "credit_shape": credit_shape}
        given = {**late, "time_step": time_step, "seed": seed, "undos": undos}
        settings: dict[str, Any] = {
            name: None if name in late and value is None else checked(name, value, *_NUMBERS[name])
            for name, value in given.items()
        }
        block = single(learner, state, credit_of(settings), settings["seed"])
        self._sit(learner, Alone(learner, block), settings)
        if record is not None:
            self._record(Recording.new(record, self._settings, self._place()))

    def _sit(self, learner: Learner, desk: Desk, settings: dict[str, Any]) -> None:
        self.learner: Learner = learner
        self._desk, self._settings = desk, settings
        self._lock = threading.RLock()
        self._undos: deque[tuple[Desk, int]] = deque(maxlen=settings["undos"])
        self._begun = self._begins = False
        self._proposed = np.zeros(learner.action_size)
        self.corrections = 0
        """Advice that was learned, and not undone, counted for each action dimension."""
        self.latest: tuple[list[float], list[float]] = [], []
        """Observation and action as they were when the latest step was proposed."""
        self._recording: Recording | None = None
        self._records_since = time.monotonic()

    @classmethod
    def _seated(cls, learner: Learner, desk: Desk, settings: Mapping[str, Any]) -> "Session":
        session = cls.__new__(cls)
        session._sit(learner, desk, dict(settings))
        return session

    @property
    def episode(self) -> int:
        """Of the latest step, from 0."""
        return self._desk.episode

    @property
    def step(self) -> int:
        """The latest step of the episode, from 0; -1 before the first."""
        return self._desk.time if self._begun else -1

    @property
    def obs(self) -> Float[np.ndarray, " obs"]:
        """Of the latest step."""
        return self._desk.obs

    @property
    def action(self) -> Float[np.ndarray, " action"]:
        """What was executed at the latest step."""
        return self._desk.action

    @property
    def proposed(self) -> Float[np.ndarray, " action"]:
        """What the policy proposed at the latest step, before it was clipped to [-1, 1]."""
        return self._proposed.copy()

    @property
    def undos(self) -> int:
        """How many of the latest corrections `undo` can take back."""
        return len(self._undos)

    @property
    @under_own_settings
    def state(self) -> State:
        """The learner's state."""
        return self._desk.state

    def propose(self, obs: Vector) -> Float[np.ndarray, " action"]:
        """The action to execute at `obs` (obs_size,): (action_size,), in [-1, 1]. It begins a step.

        The step before is over then, and was executed as proposed, unless `executed` told otherwise.

        Raises:
            ValueError: another shape, or what is no number, in `obs` or as the policy's action.
        """
        obs = self._numbers("obs", obs, self.learner.obs_size)
        with self._lock:
            desk = self._desk
            if self._idles:
                desk = desk.idled()
            return self._proposes(obs, *desk.stepped(obs, *self._flags))

    @property
    def _idles(self) -> bool:
        """Whether the learner is to go on by itself before the next step."""
        return self._begun and self._desk.idle_is_due

    @property
    def _flags(self) -> tuple[bool, bool]:
        """Whether the next step is the first of an episode, and of another one than before."""
        return self._begins or not self._begun, self._begun and self._begins

    def _proposes(
        self, obs: np.ndarray, desk: Desk, proposed: np.ndarray, finite: bool
    ) -> Float[np.ndarray, " action"]:
        """The step that the desk has come to: the rest of `propose`."""
        if not finite:
            raise _no_number(obs)
        with self._recorded():
            self._desk = desk
            action = desk.action
            self._heard(proposed, obs.tolist(), action.tolist())
        return action

    def _heard(self, proposed: np.ndarray, obs: list[float], action: list[float]) -> None:
        """What was proposed at the step that the desk has come to."""
        self._begun, self._begins = True, False
        self._proposed = proposed
        self.latest = obs, action
        self._keep("propose", obs=obs, action=action)

    def act(self, obs: Vector) -> Float[np.ndarray, " action"]:
        """What the policy does at `obs` (obs_size,) now: (action_size,), in [-1, 1]. No step begins."""
        obs = self._numbers("obs", obs, self.learner.obs_size)
        return self._desk.acts(obs)

    def act_at(self, obs: Float[np.ndarray, "obs points"]) -> Float[np.ndarray, "action points"]:
        """The same at many observations."""
        return self._desk.acts_at(np.asarray(obs, float))

    def executed(self, action: Vector) -> None:
        """Says what was executed at the latest step, where that is not what was proposed: advice is about this.

        Raises:
            ValueError: another shape, an entry beyond [-1, 1] or no number, or no step has begun.
        """
        action = self._numbers("action", action, self.learner.action_size)
        check_executed(action)
        with self._lock:
            self._check_begun()
            with self._recorded():
                self._desk = self._desk.executed(action)
                self._keep("executed", action=action.tolist())

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
        with self._lock:
            self._check_begun()
            before = self._desk, self.corrections
            place = None if about is None else self._numbers("about", about, self.learner.obs_size)
            with one_thread() if self.learner.factorises else contextlib.nullcontext():
                desk, done = self._desk.advised(given, place)
            with self._recorded():
                self.corrections += done.corrections
                self._desk = desk
                self._keep("advise", advice=given.astype(int).tolist())
            self._undos.append(before)
            return done

    def undo(self) -> bool:
        """Takes the latest advice back, with all that was learned since; False if there is none to take back."""
        with self._lock:
            if not self._undos:
                return False
            before, corrections = self._undos[-1]
            with self._recorded():
                self.corrections = corrections
                self._desk = self._desk.taken_back(before)
                self._keep("undo")
            self._undos.pop()
            return True

    def end_episode(self) -> None:
        """The next step begins a new episode: advice that comes then is never about this one."""
        with self._lock, self._recorded():
            self._begins = self._begun
            self._keep("end")

    def note(self, **values: Any) -> None:
        """Keeps `values`, as JSON knows them, in the recording, if there is one: when a key was pressed, for one."""
        with self._lock:
            self._keep("note", values=values)

    def flush(self) -> None:
        """Has the recording on the disk, as far as it goes; without it, that is left to the system.

        Raises:
            ValueError: it cannot be written.
        """
        if self._recording is not None:
            self._recording.flush()

    def uncertainty(self) -> Float[np.ndarray, " action"]:
        """sigma_h at the latest step and what was executed there: how little advice was given about it.

        NaN for a learner that does not know it.

        Raises:
            ValueError: no step has begun.
        """
        if not self._begun:
            raise UserError("no step has begun: call propose first")
        return self._desk.uncertain()

    def warm_up(self, *, ahead: bool = False) -> None:
        """Compiles all that steps and advice need, which otherwise happens when they come first; nothing is learned.

        It may run in a thread of its own while others go on.

        Args:
            ahead: not for the room that there is in the dictionaries, but for twice of it, which is given when they
                are full.
        """
        self._desk.warm_up(ahead)

    @property
    def points(self) -> tuple[int, int]:
        """Points held by the policies and by the human models, over all action dimensions; 0, 0 without any."""
        return self._desk.points

    def measure(self) -> dict[str, float]:
        """What the learner measures of itself, by name (`Learner.measure`)."""
        return self._desk.measured()

    def policy(self) -> Policy:
        """What has been taught so far, as a function of an observation; it stays as it is."""
        return self.learner.policy_of(self.state)

    def save(self, path: Any, **provenance: Any) -> None:
        """Writes learner, state and the steps that late advice may be about into a new folder, for `Session.load`.

        What could be undone is not kept.

        Raises: as `gpcjax.save_learner`.
        """
        with self._lock:
            session = {"settings": self._settings, "place": self._place()}
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
        session = cls._at(str(path), learner, state, kept)
        if record is not None:
            session._record(Recording.new(record, session._settings, session._place()))
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
        told: "Told | None" = None,
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
        session = cls._at(str(record), learner, state, first, classroom)
        try:
            session._replay(record, events, told, check_from)
            if go_on:
                kind = Recording if classroom is None else Deferred
                session._recording = kind.again(record)
        except BaseException:
            if classroom is not None:
                leave(session)
            raise
        return session

    def _replay(
        self, record: Any, events: Sequence[Mapping[str, Any]], told: "Told | None", check_from: int
    ) -> None:
        for number, event in enumerate(events, 2):
            try:
                quickly = event["episode"] < check_from and isinstance(self._desk, Pupil)
                outcome = self._again(event, quickly)
            except UserError as error:
                raise UserError(f"{record}, line {number}: {error}") from None
            if (self.episode, self.step) != (event["episode"], event["step"]):
                raise UserError(f"{record}, line {number}: lines before it are missing, or were changed")
            if told is not None:
                told(self, event, outcome)

    @classmethod
    def _at(
        cls,
        source: str,
        learner: Learner,
        state: State | None,
        kept: Mapping[str, Any],
        classroom: Classroom | None = None,
    ) -> "Session":
        """A session with these settings, at this place: what `save` and a recording keep. `source` begins messages."""
        try:
            settings, place = dict(kept["settings"]), dict(kept["place"])
            rooms = settings.get(ROOMS)
            if settings.keys() - {ROOMS} != _NUMBERS.keys():
                raise UserError("its settings are those of another version")
            if rooms is None:
                session = cls(learner, state, **settings)
            else:
                session = cls._in_classroom(learner, state, settings, classroom)
            session._move(place)
        except UserError as error:
            raise UserError(f"{source}: {error}") from None
        except (KeyError, TypeError, ValueError):
            raise UserError(f"{source}: this is no session of such a learner") from None
        return session

    @classmethod
    def _in_classroom(
        cls,
        learner: Learner,
        state: State | None,
        settings: dict[str, Any],
        classroom: Classroom | None,
    ) -> "Session":
        """A session in a classroom, or in one of its own: to the bit it is the same."""
        credit, rooms = credit_of(settings), rooms_of(settings[ROOMS])
        if classroom is None:
            classroom = Classroom(learner, credit, rooms, 1)
        elif rooms_of(classroom.rooms) != rooms:
            raise UserError("its dictionaries grew in other steps than they do here")
        return cls._seated(learner, classroom.enter(learner, settings["seed"], credit, state), settings)

    def _place(self) -> dict[str, Any]:
        """Where the session stands, as JSON knows it: all that is neither settings nor the learner's state."""
        own = {"begun": self._begun, "begins": self._begins, "corrections": self.corrections}
        return {**self._desk.place(), **own}

    def _move(self, place: Mapping[str, Any]) -> None:
        """To a place that `_place` gave. Raises KeyError, TypeError or ValueError for another one."""
        self._desk = self._desk.placed(place)
        self._begun, self._begins = bool(place["begun"]), bool(place["begins"])
        self.corrections = int(place["corrections"])

    def _follow(self, obs: np.ndarray, action: np.ndarray) -> np.ndarray:
        """The step at which this action was proposed, which is within its bounds: so nothing was clipped."""
        desk = _pupil(self)
        if self._idles:
            desk.idled()
        desk.move(obs, action, *self._flags)
        return self._proposes(obs, desk, action, True)

    def _again(self, event: Mapping[str, Any], quickly: bool = False) -> Any:
        """Does what an event of a recording tells of, and gives what that gave."""
        match event:
            case {"event": "propose", "obs": obs, "action": action} if quickly and np.abs(action).max() < 1.0:
                return self._follow(np.array(obs), np.array(action))
            case {"event": "propose", "obs": obs}:
                action = self.propose(obs)
                recorded = event.get("action", action.tolist())
                if action.tolist() != recorded:
                    place = f"episode {self.episode}, step {self.step}"
                    raise UserError(f"{place}: the action was {recorded}, it is {action.tolist()} here")
                return action
            case {"event": "executed", "action": action}:
                return self.executed(action)
            case {"event": "advise", "advice": advice}:
                return self.advise(advice)
            case {"event": "undo"}:
                return self.undo()
            case {"event": "end"}:
                return self.end_episode()
        return None

    def _numbers(self, name: str, value: Vector, size: int) -> np.ndarray:
        numbers = np.asarray(vector(name, value, size, "this learner"))
        if not np.isfinite(numbers).all():
            raise UserError(f"{name} {shown(numbers.tolist())}: each entry must be finite")
        return numbers

    def _check_begun(self) -> None:
        if not self._begun or self._begins:
            raise UserError("no step of this episode has begun: call propose first")

    def _record(self, recording: Recording) -> None:
        """Every event from now on goes into a file, which was begun with `_settings` and `_place`."""
        self._recording = recording

    @contextlib.contextmanager
    def _recorded(self) -> Iterator[None]:
        """What cannot be written down has not happened."""
        names = ("_desk", "latest", "_begun", "_begins", "_proposed", "corrections")
        before = {name: getattr(self, name) for name in names}
        try:
            yield
        except UserError:
            vars(self).update(before)
            raise

    def _keep(self, event: str, **values: Any) -> None:
        if self._recording is not None:
            now = round(time.monotonic() - self._records_since, 4)
            place = {"episode": self.episode, "step": self.step, "time": now}
            self._recording.append({"event": event, **place, **values})


def credit_of(settings: Mapping[str, Any]) -> Credit | None:
    """How a session with these settings reckons with late advice. Raises UserError: they do not fit together."""
    return Credit.of(*(settings[name] for name in ("credit", "credit_longest", "credit_shape", "time_step")))


def in_classroom(
    classroom: Classroom, learner: Learner, settings: Mapping[str, Any], recording: Path
) -> Session:
    """A new session on a free desk of a classroom, which writes its recording (`Deferred`).

    Args:
        classroom: for learners of this structure.
        learner: with the numbers of this session.
        settings: `credit`, `credit_longest`, `credit_shape`, `time_step` and `seed` of a session.
        recording: as `record` of a session.

    Raises:
        UserError: all places are taken, or the recording cannot be written.
    """
    settings = {**settings, "undos": 0, ROOMS: classroom.rooms}
    desk = classroom.enter(learner, settings["seed"], credit_of(settings))
    session = Session._seated(learner, desk, settings)
    try:
        deferred = Deferred.new(recording, session._settings, session._place())
        deferred.flush()
        session._record(deferred)
    except UserError:
        classroom.leave(desk)
        raise
    return session


def leave(session: Session) -> None:
    """Gives the session's desk in a classroom back: nothing follows."""
    _pupil(session).leave()


def propose_together(
    sessions: Sequence[Session], observations: Float[np.ndarray, "sessions obs"]
) -> list[UserError | None]:
    """`Session.propose` of each session of one classroom at its observation, in one call of its programs.

    Their recordings are deferred. Gives what each of them raised.
    """
    pupils = [_pupil(session) for session in sessions]
    idle([pupil for session, pupil in zip(sessions, pupils, strict=True) if session._idles])
    proposed, finite = propose(pupils, observations)
    rows = zip(
        sessions,
        pupils,
        observations,
        proposed,
        proposed.clip(-1.0, 1.0),
        finite.tolist(),
        strict=True,
    )
    raised: list[UserError | None] = []
    for session, pupil, obs, each, action, sound in rows:
        if sound:
            pupil.move(obs, action, *session._flags)
            session._heard(each, obs.tolist(), action.tolist())
        raised.append(None if sound else _no_number(obs))
    return raised


def _no_number(obs: np.ndarray) -> UserError:
    return UserError(f"the policy's action at {shown(obs.tolist())} is no number")


def _pupil(session: Session) -> Pupil:
    assert isinstance(session._desk, Pupil)
    return session._desk


Told = Callable[[Session, Mapping[str, Any], Any], None]


set_public_methods_under_own_settings(Session)
