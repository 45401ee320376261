"""The thread of a lesson: it prepares one, obeys the page or makes a step, whichever comes first, and begins others.

Everything that changes what is taught happens in this thread, one thing after the other (`teaching`). jax is loaded
here, so that the page is there before it.
"""

import contextlib
import gc
import queue
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpcjax.errors import UserError
from gpcjax.lateness import CREDIT
from gpcjax.registry import find
from gpcjax.sweep.given import Given
from gpcjax.sweep.lock import held
from gpcjax.sweep.options import accept, option_of
from gpcjax.teach.course import COURSE, SAVES, Course, new_folder
from gpcjax.teach.origin import Origin
from gpcjax.teach.problems import problem, reason
from gpcjax.teach.protocol import Command
from gpcjax.teach.standing import Options, Say, Standing

if TYPE_CHECKING:
    from gpcjax.teach.taught import Taught
    from gpcjax.teach.teller import Teller


_OF_ANY_LESSON = ("joined", "left", "close", "take")
"""What is said of pages, and not of what is taught."""


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
        self._frames = 0
        """That pages were told of, in all lessons: what is said about an earlier one's is known by their numbers."""
        self._over = False
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
            self._say({"type": "gone", "reason": reason(error)})
        finally:
            self._end()
            self.ready.set()

    def _prepare(self) -> None:
        self._tell_preparing("loading jax")
        from gpcjax.teach.teaching import Teaching
        from gpcjax.teach.teller import Teller

        self._tell_preparing("making the task and the learner")
        self._taught: Taught = self._opened()
        self._tell_preparing("compiling the policy")
        self._taught.session.warm_up()
        self._standing.mode, self._standing.paused, self._standing.why = "teach", True, "start"
        self._teller = Teller(self._taught, self._standing, self._options, self._say, self._frames)
        self._teaching: Teaching = Teaching(self._taught, self._standing, self._teller)
        self._tell_preparing("measuring the expert, and doing nothing")
        self._teller.begin()
        self._forget_what_was_asked()
        self._teller.everything()
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
            self._frames = self._teller.number
            self._teller.close()
        self._teller = None
        self._locked.close()
        gc.unfreeze()

    def _forget_what_was_asked(self) -> None:
        """Of what waits it leaves what is no matter of a lesson: the rest was meant for the one before this."""
        for _ in range(self._queue.qsize()):
            command = self._queue.get_nowait()  # nobody else takes any
            if command.type in _OF_ANY_LESSON:
                self._queue.put(command)

    def _turn(self) -> None:
        """Obeys one command, or makes one step, whichever comes first."""
        wait = self._teaching.wait
        with contextlib.suppress(queue.Empty):
            self._obey(
                self._queue.get(timeout=wait) if wait is None or wait > 0 else self._queue.get_nowait()
            )
        if not self._over:
            self._teaching.step_if_due()

    @property
    def _tell(self) -> "Teller":
        assert self._teller is not None
        return self._teller

    def _tell_preparing(self, what: str) -> None:
        self._say({"type": "preparing", "what": what})

    # --- what the page asks for

    def _obey(self, command: Command) -> None:
        match command:
            case Command("open", {"name": name}):
                self._open(name)
            case Command("learner", {"name": name, "settings": settings}):
                self._begin_anew(name, settings)
            case _:
                self._teaching.obey(command)

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
        self._tell_preparing("ending the lesson so far")
        self._end()
        self._folder, self._course, self._origin = new_folder(course.env, self._folder), course, origin
        try:
            self._folder.mkdir(parents=True)
            self._prepare()
        except Exception as raised:
            what = problem(raised, course)
            self._end()
            with contextlib.suppress(OSError):
                self._folder.rmdir()  # nothing was begun in it
            self._folder, self._course, self._origin = before
            self._prepare()
            self._tell.problem(what)


def _course_with(course: Course, name: str, settings: dict[str, float]) -> Course:
    """The same task for another learner, with these settings of it; the same one keeps those that no page shows.

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
    from gpcjax.teach.telling import described_learner

    is_same, task = name == course.algo, find("task", course.env)
    shown = {each["name"] for each in described_learner(name, task, dict(course.settings))["settings"]}
    for each, value in course.settings:
        if each in CREDIT or (is_same and each not in shown | given.keys()):
            given[each] = Given((value,), each)
    if is_same:
        given |= {each: Given(value, each) for each, value in course.variants}
    return Course.of(given, course.seed)
