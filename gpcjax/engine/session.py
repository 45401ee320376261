"""Teaching in a program of one's own: a person at a keyboard, a robot's control loop, another simulator.

The steps are those of the engine's own loops, on a block of one lane: `propose` is what acts there, and what follows
advice is `gpcjax.engine.correcting.correct`, with the same reckoning for advice that comes late.
"""

import contextlib
import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gpcjax._x64 import set_public_methods_under_own_settings, under_own_settings
from gpcjax.allowed import NON_NEGATIVE, POSITIVE, Numbers, checked, shown
from gpcjax.engine.correcting import idle_is_due
from gpcjax.engine.history import Credit
from gpcjax.engine.lanes import Lane
from gpcjax.engine.single import (
    acts,
    acts_at,
    advised,
    cleared,
    grown,
    has_room,
    idled,
    measured,
    place_of,
    placed,
    points_of,
    single,
    state_of,
    stepped,
    told,
    uncertain,
)
from gpcjax.errors import UserError
from gpcjax.gp.threads import one_thread
from gpcjax.learners.base import Info, Learner, State
from gpcjax.learners.saved import load_learner, save_learner
from gpcjax.policies.base import Policy, Vector, check_executed, vector
from gpcjax.policies.folder import read_card
from gpcjax.recording import Recording

_NUMBERS = {
    "credit": (float, NON_NEGATIVE),
    "credit_longest": (float, NON_NEGATIVE),
    "credit_shape": (float, POSITIVE),
    "time_step": (float, POSITIVE),
    "seed": (int, Numbers(0, 2**63 - 1, whole=True)),
    "undos": (int, Numbers(0, 1_000, whole=True)),
}


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
        self.learner: Learner = learner
        late = {"credit": credit, "credit_longest": credit_longest, "credit_shape": credit_shape}
        given = {**late, "time_step": time_step, "seed": seed, "undos": undos}
        self._settings: dict[str, Any] = {
            name: None if name in late and value is None else checked(name, value, *_NUMBERS[name])
            for name, value in given.items()
        }
        self._lock = threading.RLock()
        self._undos: deque[tuple[Lane, int]] = deque(maxlen=self._settings["undos"])
        self._begun = self._begins = False
        self._proposed = np.zeros(learner.action_size)
        self.corrections = 0
        """Advice that was learned, and not undone, counted for each action dimension."""
        names = (*late, "time_step")
        credits = Credit.of(*(self._settings[name] for name in names))
        self._block = single(learner, state, credits, self._settings["seed"])
        self._recording: Recording | None = None
        self._records_since = time.monotonic()
        if record is not None:
            self._record(record)

    @property
    def episode(self) -> int:
        """Of the latest step, from 0."""
        return int(np.asarray(self._block.episode)[0])

    @property
    def step(self) -> int:
        """The latest step of the episode, from 0; -1 before the first."""
        return int(np.asarray(self._block.env.time)[0]) if self._begun else -1

    @property
    def obs(self) -> Float[np.ndarray, " obs"]:
        """Of the latest step."""
        return np.array(np.asarray(self._block.env.obs)[:, 0])

    @property
    def action(self) -> Float[np.ndarray, " action"]:
        """What was executed at the latest step."""
        return np.array(np.asarray(self._block.action)[:, 0])

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
        return state_of(self._block)

    def propose(self, obs: Vector) -> Float[np.ndarray, " action"]:
        """The action to execute at `obs` (obs_size,): (action_size,), in [-1, 1]. It begins a step.

        The step before is over then, and was executed as proposed, unless `executed` told otherwise.

        Raises:
            ValueError: another shape, or what is no number, in `obs` or as the policy's action.
        """
        obs = self._numbers("obs", obs, self.learner.obs_size)
        with self._lock:
            block = self._block
            if self._begun and self.learner.idle_every and idle_is_due(self.learner, block.env.time)[0]:
                block = cleared(idled(block))
            begins, another = self._begins or not self._begun, self._begun and self._begins
            block, proposed, finite = stepped(block, obs, begins, another)
            if not finite:
                raise UserError(f"the policy's action at {shown(obs.tolist())} is no number")
            action = np.array(np.asarray(block.action)[:, 0])
            with self._recorded():
                self._block, self._begun, self._begins = block, True, False
                self._proposed = proposed
                self._keep("propose", obs=obs.tolist(), action=action.tolist())
            return action

    def act(self, obs: Vector) -> Float[np.ndarray, " action"]:
        """What the policy does at `obs` (obs_size,) now: (action_size,), in [-1, 1]. No step begins."""
        obs = self._numbers("obs", obs, self.learner.obs_size)
        return np.array(acts(self._block.controller, obs))

    def act_at(self, obs: Float[np.ndarray, "obs points"]) -> Float[np.ndarray, "action points"]:
        """The same at many observations."""
        return np.array(acts_at(self._block.controller, np.asarray(obs, float)))

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
                self._block = dataclasses.replace(self._block, action=jnp.asarray(action)[:, None])
                self._keep("executed", action=action.tolist())

    def advise(self, advice: Vector | float) -> Info:
        """Learns from advice: -1 for less, 1 for more, 0 for none, for each action dimension; or one number for one.

        Returns what was done, each field (action_size,); with credit for several steps, at the latest of them. A
        dictionary that is full is given twice the room first.

        Raises:
            ValueError: another shape or value, or no step has begun.
        """
        entries: Any = [advice] if np.ndim(advice) == 0 else advice
        given = np.asarray(vector("advice", entries, self.learner.action_size, "this learner"))
        if not np.isin(given, (-1.0, 0.0, 1.0)).all():
            raise UserError(f"advice {shown(given.tolist())}: each entry must be -1, 0 or 1")
        with self._lock:
            self._check_begun()
            before = self._block, self.corrections
            self._make_room()
            with one_thread() if self.learner.factorises else contextlib.nullcontext():
                block = jax.block_until_ready(advised(self._block, given[:, None]))
            with self._recorded():
                self.corrections += int(np.asarray(block.tally.corrections)[0])
                self._block = cleared(block)
                self._keep("advise", advice=given.astype(int).tolist())
            self._undos.append(before)
            return told(block)

    def undo(self) -> bool:
        """Takes the latest advice back, with all that was learned since; False if there is none to take back."""
        with self._lock:
            if not self._undos:
                return False
            before, corrections = self._undos[-1]
            with self._recorded():
                self.corrections = corrections
                self._block = dataclasses.replace(
                    self._block, state=before.state, controller=before.controller
                )
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
        return np.asarray(uncertain(self._block))  # nobody waits for it: a block is never changed

    def warm_up(self, *, ahead: bool = False) -> None:
        """Compiles all that steps and advice need, which otherwise happens when they come first; nothing is learned.

        It may run in a thread of its own while others go on.

        Args:
            ahead: not for the room that there is in the dictionaries, but for twice of it, which is given when they
                are full.
        """
        with self._lock:
            block = self._block
        if ahead:
            larger = grown(block) if self.learner.wants_room else None
            if larger is None:
                return
            block = larger
        block, _, _ = stepped(block, np.zeros(self.learner.obs_size), True, False)
        if self.learner.idle_every:
            cleared(idled(block))
        has_room(block, self._corrections_at_once)
        block = advised(block, np.zeros((self.learner.action_size, 1)))
        told(block)
        for look in (uncertain, points_of, measured):
            look(block)
        acts(block.controller, np.zeros(self.learner.obs_size))

    @property
    def points(self) -> tuple[int, int]:
        """Points held by the policies and by the human models, over all action dimensions; 0, 0 without any."""
        policy, human = points_of(self._block)
        return int(policy), int(human)

    def measure(self) -> dict[str, float]:
        """What the learner measures of itself, by name (`Learner.measure`)."""
        return {name: float(value) for name, value in measured(self._block).items()}

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
            session._record(record)
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
    ) -> "Session":
        """The session whose events are in the file `record`, made again: the same to the bit, on the same machine.

        Args:
            record: what a session with `record=` has written, also one whose program has died.
            learner, state: those that it was begun with.
            go_on: append what follows to the same file.
            told: called after each event with the session, the event, and what its method gave.

        Raises:
            ValueError: the file cannot be read, is no recording, or one of another kind of learner; or an action is
                another one than was recorded, as on another kind of machine. The message names line and step.
        """
        first, events = Recording.read(record)
        session = cls._at(str(record), learner, state, first)
        for number, event in enumerate(events, 2):
            try:
                outcome = session._again(event)
            except UserError as error:
                raise UserError(f"{record}, line {number}: {error}") from None
            if (session.episode, session.step) != (event["episode"], event["step"]):
                raise UserError(f"{record}, line {number}: lines before it are missing, or were changed")
            if told is not None:
                told(session, event, outcome)
        if go_on:
            session._recording = Recording.again(record)
        return session

    @classmethod
    def _at(cls, source: str, learner: Learner, state: State | None, kept: Mapping[str, Any]) -> "Session":
        """A session with these settings, at this place: what `save` and a recording keep. `source` begins messages."""
        try:
            settings, place = dict(kept["settings"]), dict(kept["place"])
            if settings.keys() != _NUMBERS.keys():
                raise UserError("its settings are those of another version")
            session = cls(learner, state, **settings)
            session._move(place)
        except UserError as error:
            raise UserError(f"{source}: {error}") from None
        except (KeyError, TypeError, ValueError):
            raise UserError(f"{source}: this is no session of such a learner") from None
        return session

    def _place(self) -> dict[str, Any]:
        """Where the session stands, as JSON knows it: all that is neither settings nor the learner's state."""
        own = {"begun": self._begun, "begins": self._begins, "corrections": self.corrections}
        return {**place_of(self._block), **own}

    def _move(self, place: Mapping[str, Any]) -> None:
        """To a place that `_place` gave. Raises KeyError, TypeError or ValueError for another one."""
        self._block = placed(self._block, place)
        self._begun, self._begins = bool(place["begun"]), bool(place["begins"])
        self.corrections = int(place["corrections"])

    def _again(self, event: Mapping[str, Any]) -> Any:
        """Does what an event of a recording tells of, and gives what that gave."""
        match event:
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

    @property
    def _corrections_at_once(self) -> int:
        return 1 if self._block.credit is None else self._block.credit.moments

    def _make_room(self) -> None:
        while self.learner.wants_room and not has_room(self._block, self._corrections_at_once):
            larger = grown(self._block)
            if larger is None:
                return
            self._block = larger

    def _numbers(self, name: str, value: Vector, size: int) -> np.ndarray:
        numbers = np.asarray(vector(name, value, size, "this learner"))
        if not np.isfinite(numbers).all():
            raise UserError(f"{name} {shown(numbers.tolist())}: each entry must be finite")
        return numbers

    def _check_begun(self) -> None:
        if not self._begun or self._begins:
            raise UserError("no step of this episode has begun: call propose first")

    def _record(self, path: Any) -> None:
        self._recording = Recording.new(path, self._settings, self._place())

    @contextlib.contextmanager
    def _recorded(self) -> Iterator[None]:
        """What cannot be written down has not happened."""
        names = ("_block", "_begun", "_begins", "_proposed", "corrections")
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


Told = Callable[[Session, Mapping[str, Any], Any], None]


set_public_methods_under_own_settings(Session)
