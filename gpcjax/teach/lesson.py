"""The real-time loop of a lesson: a clock, and what the page asks for. Runs in a thread of its own.

Everything that changes what is taught happens in this thread, one thing after the other; what can wait is an errand.
jax is loaded here, so that the page is there before it.

Over 300 lines: each command of the page is obeyed here, between steps.
"""

import contextlib
import gc
import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpcjax.errors import Failure, ForeignError, UserError
from gpcjax.lateness import CREDIT
from gpcjax.registry import built_in, find
from gpcjax.sweep.given import Given
from gpcjax.sweep.lock import held
from gpcjax.sweep.options import accept, option_of
from gpcjax.teach.course import COURSE, SAVES, Course, new_folder, seconds_of
from gpcjax.teach.origin import Origin
from gpcjax.teach.protocol import Command, Press

if TYPE_CHECKING:
    from gpcjax.teach.evaluation import Evaluation
    from gpcjax.teach.tally import Episode
    from gpcjax.teach.taught import Taught
    from gpcjax.teach.teller import Teller

Say = Callable[[dict[str, Any] | bytes], None]
"""Takes a message for the page, from any thread."""

LATEST = 0.25
"""Seconds that the clock may be behind; what is beyond is let go, as after a laptop slept."""


@dataclass(frozen=True)
class Options:
    """How a lesson is held."""

    repeat: float = 8.0
    """Advices a second while a key is held."""
    speed: float = 1.0
    """Times real time."""
    oracle: str | None = None
    """Whose mean return is drawn as a line; the task's own expert if None."""


@dataclass
class Standing:
    """How a lesson stands: what the message `state` tells."""

    speed: float
    mode: str = "teach"
    paused: bool = True
    why: str = "start"
    late: float = 0.0
    """Milliseconds that the present step was behind its time."""


class Lesson:
    """One lesson: `submit` what the page says, `say` gets what it is told.

    Args:
        folder: what was taught there before goes on; otherwise it is made.
        course: what is taught, None to go on with what is in the folder.
        origin: what to begin with: a saved learner, or a run.
        options: how it is held.
        say: takes a message for the page, from any thread.
    """

    def __init__(
        self,
        folder: Path,
        course: Course | None,
        origin: Origin | None,
        options: Options,
        say: Say,
    ):
        self._folder, self._course, self._origin = folder, course, origin
        self._options, self._say = options, say
        self._standing = Standing(options.speed)
        self._queue: queue.Queue[Command] = queue.Queue()
        self._locked = contextlib.ExitStack()
        self._teller: Teller | None = None
        self._first_of_episode, self._due, self._over = 0, 0.0, False
        self._evaluation: Evaluation | None = None
        self.failure: BaseException | None = None
        """What ended it, if anything did."""
        self.ready = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="lesson")

    def start(self) -> None:
        """Begins to prepare."""
        self._thread.start()

    def submit(self, command: Command) -> None:
        """Takes what the page says, from any thread: besides, `joined` and `left` when a page came or went."""
        self._queue.put(command)

    def close(self) -> None:
        """Writes what there is, and ends."""
        self._over = True
        self.submit(Command("close"))
        if self._thread.is_alive():
            self._thread.join()

    def join(self) -> None:
        """Waits until it has ended."""
        self._thread.join()

    @property
    def folder(self) -> Path:
        """Where the present lesson is kept."""
        return self._folder

    # --- the thread

    def _run(self) -> None:
        try:
            self._prepare()
            while not self._over:
                self._turn()
        except BaseException as error:  # it is told where the thread was started
            self.failure = error
            self._say({"type": "gone", "reason": _reason(error)})
        finally:
            self._end()
            self.ready.set()

    def _prepare(self) -> None:
        self._tell_preparing("loading jax")
        from gpcjax.teach.teller import Teller

        self._tell_preparing("making the task and the learner")
        self._taught: Taught = self._opened()
        self._tell_preparing("compiling the policy")
        self._taught.session.warm_up()
        self._standing.mode, self._standing.paused, self._standing.why = "teach", True, "start"
        self._evaluation, self._first_of_episode = None, 0
        self._teller = Teller(self._taught, self._standing, self._options, self._say)
        self._seconds = seconds_of(self._teller.task)
        self._tell_preparing("measuring the expert, and doing nothing")
        self._teller.begin()
        gc.collect()
        gc.freeze()  # what was loaded stays: to look through it takes longer than many steps
        self.ready.set()

    def _opened(self) -> "Taught":
        from gpcjax.teach.taught import Taught

        self._locked.enter_context(held(self._folder))
        if (self._folder / COURSE).exists():
            if self._origin is not None:
                raise UserError(f"{self._folder}: something is taught there already, give a new folder")
            return Taught.resume(self._folder, self._tell_preparing)
        if self._course is None:
            raise UserError(f"{self._folder}: nothing is taught there, give an env")
        return Taught.begin(self._folder, self._course, self._origin)

    def _end(self) -> None:
        if self._teller is not None:
            self._teller.close()
        self._teller = None
        self._locked.close()
        gc.unfreeze()

    def _turn(self) -> None:
        """Obeys one command, or makes one step, whichever comes first."""
        standing = self._standing
        wait = None if standing.paused else self._due - time.perf_counter()
        with contextlib.suppress(queue.Empty):
            self._obey(
                self._queue.get(timeout=wait) if wait is None or wait > 0 else self._queue.get_nowait()
            )
        behind = time.perf_counter() - self._due
        if standing.paused or self._over or behind < 0:
            return
        standing.late = 1000 * behind
        if behind > LATEST:
            self._due += behind
        self._due += self._seconds / standing.speed
        self._tick()

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

    @property
    def _tell(self) -> "Teller":
        assert self._teller is not None
        return self._teller

    def _told(self, ended: "Episode | None") -> None:
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
            self._tell.problem(_problem(raised, self._taught.course))
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

    def _tell_preparing(self, what: str) -> None:
        self._say({"type": "preparing", "what": what})

    # --- what the page asks for

    def _obey(self, command: Command) -> None:
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
            case Command("open", {"name": name}):
                self._open(name)
            case Command("learner", {"name": name, "settings": settings}):
                self._begin_anew(name, settings)

    def _press(self, press: Press) -> None:
        standing = self._standing
        if standing.mode != "teach" or press.dim >= self._taught.session.learner.action_size:
            return
        if standing.paused and standing.why in ("start", "connection"):
            self._go_on()
        if press.shown and press.shown < self._first_of_episode:
            return  # it was about an episode that is over
        with self._resting_on_problems():
            if self._catch_up():
                return  # so is the episode that it was about
            self._tell.advised(press, self._taught.advise(press, self._credited()))

    def _catch_up(self) -> bool:
        """Writes down and shows what could not be written before; whether an episode ended with it."""
        if not self._taught.behind:
            return False
        ended = self._taught.catch_up()
        self._told(ended)
        self._tell.frame(None)
        return ended is not None

    def _credited(self) -> int:
        """How many steps back the step is that an advice is shown to be about."""
        seconds = dict(self._taught.course.settings).get("credit", 0.0)
        return math.floor(seconds / self._tell.task.seconds + 0.5)

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
            from gpcjax.teach.evaluation import Evaluation

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

    def _open(self, name: str) -> None:
        path = self._taught.folder / SAVES / name
        if path.is_dir():
            self._anew(self._taught.course, path)
        else:
            self._tell.problem(f"nothing is saved as {name}")

    def _begin_anew(self, name: str, settings: dict[str, float]) -> None:
        if name not in self._tell.learners():  # a name may be that of any module: the page loads none
            self._tell.problem(f"{name} is no learner that is offered here")
            return
        try:
            course = _course_with(self._taught.course, name, settings)
        except UserError as error:
            self._tell.problem(str(error))
            return
        self._anew(course, None)

    def _anew(self, course: Course, origin: Origin | None) -> None:
        """Ends this lesson and begins another one beside it; if that cannot be, this one goes on."""
        before = self._folder, self._course, self._origin
        self._end()
        self._folder, self._course, self._origin = new_folder(course.env, self._folder), course, origin
        try:
            self._folder.mkdir(parents=True)
            self._prepare()
        except Exception as raised:
            problem = _problem(raised, course)
            self._end()
            with contextlib.suppress(OSError):
                self._folder.rmdir()  # nothing was begun in it
            self._folder, self._course, self._origin = before
            self._prepare()
            self._tell.problem(problem)


def _course_with(course: Course, name: str, settings: dict[str, float]) -> Course:
    """The same task for another learner, with these settings of it.

    Raises:
        UserError: there is no such learner, or it has no such settings.
    """
    known = {setting.name: setting for setting in find("learner", name).settings}
    given: dict[str, Any] = {"env": Given(course.env, "env"), "algo": Given((name,), "learner")}
    for each, value in settings.items():
        if each not in known:
            raise UserError(f"{each} is no setting of {name}")
        number = int(value) if known[each].kind is int and float(value).is_integer() else value
        given[each] = Given(accept(option_of(known[each]), number, each), each)
    given |= {each: Given((value,), each) for each, value in course.settings if each in CREDIT}
    return Course.of(given, course.seed)


def _problem(raised: Exception, course: Course) -> str:
    """What the page is told of something that cannot be done; the terminal is told where code of theirs failed.

    Raises:
        Exception: the same, a fault of ours.
    """
    error = _of_theirs(raised, course)
    if not isinstance(error, UserError | OSError):
        raise raised
    if isinstance(error, ForeignError) and error.details:
        print(error.details, file=sys.stderr, flush=True)
    return str(error)


def _of_theirs(error: BaseException, course: Course) -> BaseException:
    """What was raised; of a learner of a person's own as its own. A task's is told by `World`."""
    told = isinstance(error, UserError | Failure | OSError) or not isinstance(error, Exception)
    if told or course.algo in built_in("learner"):
        return error
    return ForeignError(f"algo {course.algo}: it fails", error)


def _reason(error: BaseException) -> str:
    return str(error) if isinstance(error, UserError | Failure | OSError) else f"a fault of gpcjax: {error!r}"
