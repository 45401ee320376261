"""One run of a participant, in a hall with others: what the page may do, and what it is told.

Nothing that is told names the learner, or lets it be guessed: of what an advice did only the policy's action before and
after is told, and sigma_h only where the run is one with that cue.
"""

import contextlib
import threading
from typing import TYPE_CHECKING, Any

from gpcjax.engine.session import Session
from gpcjax.errors import UserError
from gpcjax.study.standing import Run, Say, Standing
from gpcjax.teach.protocol import Press
from gpcjax.teach.taught import Advised, Taught
from gpcjax.teach.telling import episode_of, frame_of
from gpcjax.teach.world import Moved, World
from gpcjax.teach.worlds import Place

if TYPE_CHECKING:
    from gpcjax.study.hall import Hall
    from gpcjax.study.kind import Kind


class Seat:
    """A participant's place in a hall, from `Hall.seat`. All methods may be called from any thread; none blocks."""

    def __init__(self, hall: "Hall", kind: "Kind", run: Run, say: Say):
        self.run, self.kind, self.say = run, kind, say
        self._hall = hall
        self.lock = threading.Lock()
        """Held by who moves this run: its steps, or a correction."""
        self.behind = False
        """The task has made a step, and the policy not yet: a correction was under way."""
        self.taught: Taught | None = None
        self.next: Any = None
        """What is seen of the task at the step to come."""
        self._ends, self._told = "", None
        self.over = self.left = self.broken = False
        """Complete; given back; at a step from which it cannot go on."""
        self._paused, self._why, self._problem = True, "preparing", None
        self.released = False
        """The place is free again."""
        self.gone = threading.Event()
        """Set when all is written, too."""
        self.sigma: list[float] | None = None
        self.sigma_asked = 0.0
        self.held = contextlib.ExitStack()
        """The lock of its folder."""
        self._number = self._first_of_episode = self._steps = 0

    # --- for the page

    def press(self, press: Press) -> None:
        """An advice; one while it rests, or about an episode that is over, is none."""
        if self.runs:
            self._hall.learns(lambda: self._learn(press))

    def go_on(self) -> None:
        """Runs, from the next tick on."""
        self._hall.does(lambda: self._rest(None))

    def pause(self, why: str) -> None:
        """Rests until `go_on`."""
        self._hall.does(lambda: self._rest(why))

    def everything(self) -> None:
        """Has all told that a page needs which knows nothing yet."""
        self._hall.does(self._tell_everything)

    def leave(self) -> None:
        """Gives the place back. What was taught is on the disk: a later seat with the same run goes on from there."""
        self._hall.does(lambda: self._hall.leaves(self))

    # --- for the hall

    @property
    def session(self) -> Session:
        """Of what is taught."""
        assert self.taught is not None
        return self.taught.session

    @property
    def world(self) -> World | Place:
        """Where its task is."""
        assert self.taught is not None
        return self.taught.world

    @property
    def episode(self) -> int:
        """Index of the present one."""
        return self._finished

    @property
    def runs(self) -> bool:
        """Whether its steps are due."""
        return not self._paused

    @property
    def standing(self) -> Standing:
        """As it is now."""
        taught, rests = self.taught, (self._paused, self._why if self._paused else "", self._problem)
        if taught is None:
            return Standing(0, 0, 0.0, 0, *rests)
        present = taught.present
        return Standing(self._finished, present.length, present.total, taught.session.corrections, *rests)

    def sits(self, taught: Taught) -> None:
        """What was prepared: from here on it rests, and is told."""
        self.taught = taught
        self._steps = sum(episode.length for episode in taught.tally.finished) + taught.present.length
        self.over = self._is_over
        self._why = "over" if self.over else "start"
        self._tell_everything()

    def breaks(self, text: str) -> None:
        """Rests for good: task and learner are no longer at the same step. A later seat begins before it."""
        self.broken = True
        self.problem(text)

    def moves(self, moved: Moved) -> None:
        """Counts a step of the task: whether the episode ends there, and what is seen. Raises: as `Taught.moved`."""
        assert self.taught is not None
        self.taught.moved(moved)
        self._steps += 1
        self._ends = "over" if moved.over else "time" if self._time_is_up else ""
        self.next = None if self._ends else moved.obs

    @property
    def goes_on_after(self) -> bool:
        """Whether the episode ends at this step, and another one follows."""
        return bool(self._ends) and not (self._finished + 1 >= self.run.episodes or self._time_is_up)

    def is_taken_by_clock(self) -> bool:
        """Has the lock, or is behind from here on: who has it sees that when it is done."""
        self.behind = True
        if not self.lock.acquire(blocking=False):
            return False
        self.behind = False
        return True

    def closes(self) -> None:
        """Ends the episode, if it does."""
        if self._ends:
            assert self.taught is not None
            ended = self.taught.close(self._ends)
            self._told = {"type": "episode", **episode_of(self.episode - 1, ended), "why": self._ends}
            self._ends = ""
            self._first_of_episode = self._number + 1
            self.over = self._is_over

    def proposes(self, error: UserError | None) -> None:
        """Counts what was proposed at the next step."""
        assert self.taught is not None
        self.next = None
        if error is None:
            self.taught.proposed()
        else:
            self.breaks(str(error))

    def tells_step(self, late: float) -> None:
        """The step that was just made, and the episode that ended before; after the last one it rests for good."""
        told, self._told = self._told, None
        if told is not None:
            self._tell(told)
            if not self.over:
                self._hall.keeps(self)
        if self.over:
            self.rests("over")
        elif not self.broken:
            self._frame(late)

    def rests(self, why: str) -> None:
        """It rests from now on."""
        self._paused, self._why = True, why
        self._state()

    def problem(self, text: str) -> None:
        """Rests, for something that cannot be done."""
        self._paused, self._why, self._problem = True, "problem", text
        self._tell({"type": "problem", "text": text})
        self._state()

    @property
    def _time_is_up(self) -> bool:
        """Whether no more steps fit into the run."""
        return self.run.seconds is not None and self._steps * self.kind.seconds >= self.run.seconds - 1e-9

    @property
    def _is_over(self) -> bool:
        """Whether no step is to come, at the end of an episode."""
        return self._finished >= self.run.episodes or self._time_is_up

    def tell_over(self) -> None:
        """All is written."""
        self._tell({"type": "over"})

    @property
    def _finished(self) -> int:
        assert self.taught is not None
        return len(self.taught.tally.finished)

    def _learn(self, press: Press) -> None:
        with self.lock:
            taught = self.taught
            if taught is None or not self.runs or self.left or press.dim >= self.kind.action_size:
                return
            if press.shown and press.shown < self._first_of_episode:
                return
            try:
                self._tell(self._advised(press, taught.advise(press)))
            except UserError as error:
                text = str(error)
                self._hall.does(lambda: self.problem(text))
        self.catch_up()

    def catch_up(self) -> None:
        """Has the step made that was due while this run was held, if one was."""
        if self.behind:
            self._hall.does(lambda: self._hall.catch_up(self))

    def _rest(self, why: str | None) -> None:
        if self.taught is None or self.left:
            return
        if self.over or self.broken:
            self._state()
        elif why is not None:
            self.rests(why)
            self._hall.keeps(self, 0.0)
        elif self._why != "problem" or self._hall.writes(self):
            self._paused, self._why = False, ""
            self._hall.wakes(self.kind)
            self._state()

    def measure_sigma(self) -> None:
        """For the frames that follow."""
        if self.taught is not None and not self.left:
            self.sigma = self.session.uncertainty().round(6).tolist()

    # --- messages

    def _tell(self, message: dict[str, Any]) -> None:
        if self.left:
            return
        try:
            self.say(message)
        except Exception as error:  # the page's affair: others go on
            self._hall.fault(error)

    def _tell_everything(self) -> None:
        taught = self.taught
        if taught is None:
            self._tell({"type": "preparing", "what": "preparing the task"})
            return
        tally = taught.tally
        self._tell(
            {
                "type": "task",
                "task": self.kind.described,
                "credit": None,
                "episodes": [episode_of(index, each) for index, each in enumerate(tally.finished)],
                "corrections": tally.corrections,
                "first": [],
            }
        )
        self._tell({"type": "ready"})
        self._state()
        self._frame(0.0)
        if self.over:
            self._hall.completes(self)

    def _state(self) -> None:
        state = {"type": "state", "mode": "teach", "paused": self._paused, "why": self._why}
        self._tell({**state, "speed": 1.0, "undos": 0})

    def _frame(self, late: float) -> None:
        taught = self.taught
        assert taught is not None
        self._number += 1
        frame = frame_of(self._number, taught.session, taught.present, self._finished, "teach", late)
        if self.run.cue:
            frame |= {"sigma": self.sigma, "prior": self.kind.prior}
        self._tell(frame)

    def _advised(self, press: Press, done: Advised) -> dict[str, Any]:
        return {
            "type": "advised",
            "id": press.id,
            "n": self._number,
            "episode": self._finished,
            "step": done.step,
            "dim": press.dim,
            "h": press.h,
            "before": done.before,
            "after": done.after,
            "corrections": self.session.corrections,
        }
