"""The real-time loop of a lesson: a clock, what the page asks for, and what it is told. Runs in a thread of its own.

Everything that changes what is taught happens in this thread, one thing after the other; what can wait is an errand.
jax is loaded here, so that the page is there before it.
"""

import contextlib
import math
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpcjax.errors import Failure, UserError
from gpcjax.registry import built_in, find
from gpcjax.sweep.lock import held
from gpcjax.sweep.options import accept, option_of
from gpcjax.sweep.spec import Given
from gpcjax.teach.course import COURSE, SAVES, Course, new_folder
from gpcjax.teach.errands import Errands
from gpcjax.teach.protocol import NAME, Command, Press

if TYPE_CHECKING:
    from gpcjax.teach.tally import Episode
    from gpcjax.teach.taught import Evaluation, Taught

Say = Callable[[dict[str, Any] | bytes], None]
"""Takes a message for the page, from any thread."""

USUAL_STEP = 1 / 30
"""Seconds of a step, on a task that has no unit of time."""

LATEST = 0.25
"""Seconds that the clock may be behind; what is beyond is let go, as after a laptop slept."""

PICTURES_APART = 0.04
MAP_APART, SIGMA_APART, KEEP_APART, FLUSH_APART = 0.5, 0.2, 10.0, 1.0

MAIN_SETTINGS = 6
"""Of a learner, that the page offers."""


@dataclass(frozen=True)
class Options:
    """How a lesson is held."""

    repeat: float = 8.0
    """Advices a second while a key is held."""
    speed: float = 1.0
    """Times real time."""
    oracle: str | None = None
    """Whose mean return is drawn as a line; the task's own expert if None."""


class Lesson:
    """One lesson: `submit` what the page says, `say` gets what it is told.

    Args:
        folder: what was taught there before goes on; otherwise it is made.
        course: what is taught, None to go on with what is in the folder.
        origin: a saved state to begin with.
    """

    def __init__(self, folder: Path, course: Course | None, origin: Path | None, options: Options, say: Say):
        self._folder, self._course, self._origin = folder, course, origin
        self._options, self._say_raw = options, say
        self._queue: queue.Queue[Command] = queue.Queue()
        self._closing = contextlib.ExitStack()
        self._errands: Errands | None = None
        self._slow: Errands | None = None
        """What takes seconds: compiling, and whole episodes."""
        self._painter: Errands | None = None
        self._mode, self._paused, self._why, self._speed = "teach", True, "start", options.speed
        self._number, self._first_of_episode, self._painted = 0, 0, 0.0
        self._sigma: list[float] | None = None
        self._prior: float | None = None
        self._lines: dict[str, Any] | None = None
        self._chart: tuple[int, int, int] = (0, 1, 0)
        self._evaluation: Evaluation | None = None
        self._due = self._late = 0.0
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
            self._say_raw({"type": "gone", "reason": _reason(error)})
        finally:
            self._end()
            self.ready.set()

    def _prepare(self) -> None:
        self._tell_preparing("loading jax")
        from gpcjax.teach.taught import Taught

        self._tell_preparing("making the task and the learner")
        self._taught: Taught = self._opened()
        self._tell_preparing("compiling the policy")
        session = self._taught.session
        session.warm_up()
        prior = float(session.learner.largest_sigma())
        self._prior = prior if prior > 0 else None
        self._task = find("task", self._taught.course.env)
        self._size = session.learner.action_size
        self._axes()
        self._mode, self._paused, self._why = "teach", True, "start"
        self._errands, self._slow, self._painter = (Errands(self._failed) for _ in range(3))
        self._room = session.room
        self.ready.set()
        self._joined()
        self._ask_chart()
        self._slow.ask("ahead", lambda: session.warm_up(ahead=True))
        self._slow.ask("lines", self._measure_lines)

    def _opened(self) -> "Taught":
        from gpcjax.teach.taught import Taught

        self._closing.enter_context(held(self._folder))
        if (self._folder / COURSE).exists():
            if self._origin is not None:
                raise UserError(f"{self._folder}: something is taught there already, give a new folder")
            return Taught.resume(self._folder, self._tell_preparing)
        if self._course is None:
            raise UserError(f"{self._folder}: nothing is taught there, give an env")
        return Taught.begin(self._folder, self._course, self._origin)

    def _turn(self) -> None:
        """Obeys one command, or makes one step, whichever comes first."""
        now = time.perf_counter()
        wait = None if self._paused else max(0.0, self._due - now)
        with contextlib.suppress(queue.Empty):
            self._obey(
                self._queue.get(timeout=wait) if wait is None or wait > 0 else self._queue.get_nowait()
            )
        now = time.perf_counter()
        if self._paused or self._over or now < self._due:
            return
        self._late = 1000 * (now - self._due)
        if now - self._due > LATEST:
            self._due = now
        self._due += self._seconds / self._speed
        self._tick()

    @property
    def _seconds(self) -> float:
        return USUAL_STEP if self._task.time_step is None else self._task.time_step

    def _tick(self) -> None:
        if self._evaluation is not None:
            if self._evaluation.step():
                self._tell_episode(self._evaluation.index, self._evaluation, 0, "over")
                self._evaluation.again()
            self._tell_frame()
            return
        with self._resting_on_problems():
            ended = self._taught.step()
            if ended is not None:
                self._episode_over(ended, "over")
            self._tell_frame()

    def _episode_over(self, ended: "Episode", why: str) -> None:
        self._first_of_episode = self._number + 1
        self._tell_episode(self._taught.episode - 1, ended, ended.corrections, why)
        self._ask_keep(KEEP_APART)

    @contextlib.contextmanager
    def _resting_on_problems(self) -> Any:
        try:
            yield
        except (UserError, OSError) as error:
            self._problem(str(error))
            self._pause("problem")

    # --- what the page asks for

    def _obey(self, command: Command) -> None:
        match command:
            case Command("joined"):
                self._joined()
            case Command("left"):
                self._pause("connection")
            case Command("press", _, Press() as press):
                self._press(press)
            case Command("pause", {"on": True}):
                self._pause("you")
            case Command("pause", {"on": False}):
                self._go_on()
            case Command("step") if self._paused:
                self._late = 0.0
                self._tick()
            case Command("reset"):
                self._reset()
            case Command("undo"):
                self._undo()
            case Command("speed", {"value": value}):
                self._speed = float(value)
                self._due = time.perf_counter()
                self._tell_state()
            case Command("run", {"on": on}):
                self._run_alone(on)
            case Command("map", {"x": x, "y": y, "dim": dim}):
                sizes = self._taught.session.learner.obs_size
                if x < sizes and y < sizes and x != y and dim < self._size:
                    self._chart = (x, y, dim)
                    self._ask_chart()
            case Command("save", {"name": name}):
                self._save(name)
            case Command("open", {"name": name}):
                self._open(name)
            case Command("learner", {"name": name, "settings": settings}):
                self._begin_anew(name, settings)

    def _press(self, press: Press) -> None:
        if self._mode != "teach" or press.dim >= self._size:
            return
        if self._paused and self._why in ("start", "connection"):
            self._go_on()
        if press.shown and press.shown < self._first_of_episode:
            return  # it was about an episode that is over
        with self._resting_on_problems():
            done = self._taught.advise(press, self._credited())
            self._tell_advised(press, done)
            self._learned()

    def _learned(self) -> None:
        """What follows when the policy has changed."""
        session = self._taught.session
        if session.room != self._room:
            self._room = session.room
            assert self._slow is not None
            self._slow.ask("ahead", lambda: session.warm_up(ahead=True))
        self._ask_chart()
        self._ask_sigma()

    def _credited(self) -> int:
        """How many steps back the step is that an advice is shown to be about."""
        seconds = dict(self._taught.course.settings).get("credit", 0.0)
        return math.floor(seconds / self._task.seconds + 0.5)

    def _undo(self) -> None:
        if self._mode != "teach":
            return
        with self._resting_on_problems():
            if self._taught.undo():
                self._say(
                    "undone",
                    corrections=self._taught.tally.corrections,
                    points=list(self._taught.session.points),
                    undos=self._taught.session.undos,
                )
                self._learned()
                self._tell_frame()

    def _reset(self) -> None:
        if self._evaluation is not None:
            self._tell_episode(self._evaluation.index, self._evaluation, 0, "reset")
            self._evaluation.again()
            self._tell_frame()
            return
        with self._resting_on_problems():
            ended = self._taught.end("reset")
            self._episode_over(ended, "reset")
            self._tell_frame()

    def _run_alone(self, on: bool) -> None:
        if on == (self._evaluation is not None):
            return
        if on:
            from gpcjax.teach.taught import Evaluation

            policy = self._taught.session.policy()
            self._evaluation = Evaluation(policy, self._taught.course, self._taught.episode)
            self._mode = "run"
            self._go_on()
        else:
            self._evaluation, self._mode = None, "teach"
            self._pause("you")
        self._tell_frame()

    def _save(self, name: str) -> None:
        with self._resting_on_problems():
            self._taught.save(name)
            self._say("saved", name=name, saves=self._saves())

    def _open(self, name: str) -> None:
        path = self._taught.folder / SAVES / name
        if not path.is_dir():
            self._problem(f"nothing is saved as {name}")
            return
        self._anew(self._taught.course, path)

    def _begin_anew(self, name: str, settings: dict[str, float]) -> None:
        if name not in self._learners():  # a name may be that of any module: the page loads none
            self._problem(f"{name} is no learner that is offered here")
            return
        try:
            spec = find("learner", name)
            known = {setting.name: setting for setting in spec.settings}
            given: dict[str, Any] = {
                "env": Given(self._task.name, "env"),
                "algo": Given((name,), "learner"),
            }
            for each, value in settings.items():
                if each not in known:
                    raise UserError(f"{each} is no setting of {name}")
                number = int(value) if known[each].kind is int and float(value).is_integer() else value
                given[each] = Given(accept(option_of(known[each]), number, each), each)
            mine = {setting.name for setting in spec.settings}
            kept = dict(self._taught.course.settings)
            given |= {
                each: Given((value,), each)
                for each, value in kept.items()
                if each not in mine and each in _CREDIT
            }
            course = Course.of(given, self._taught.course.seed)
        except UserError as error:
            self._problem(str(error))
            return
        self._anew(course, None)

    def _anew(self, course: Course, origin: Path | None) -> None:
        """Ends this lesson and begins another one beside it; if that cannot be, this one goes on."""
        before = self._folder, self._course, self._origin
        self._end(closing=False)
        self._folder, self._course, self._origin = new_folder(course.env, self._folder), course, origin
        self._evaluation = None
        try:
            self._folder.mkdir(parents=True)
            self._prepare()
        except (UserError, OSError) as error:
            self._folder, self._course, self._origin = before
            self._prepare()
            self._problem(str(error))

    def _pause(self, why: str) -> None:
        if not self._paused or why == "problem":
            self._paused, self._why = True, why
            self._ask_keep(0.0)
        self._tell_state()

    def _go_on(self) -> None:
        if self._paused:
            self._paused, self._why = False, ""
            self._due = time.perf_counter()
            assert self._errands is not None
            self._errands.ask("flush", self._flush, FLUSH_APART)
        self._tell_state()

    # --- errands

    def _flush(self) -> None:
        self._taught.session.flush()
        if not self._paused and self._errands is not None:
            self._errands.ask("flush", self._flush, FLUSH_APART)

    def _ask_keep(self, apart: float) -> None:
        if self._errands is not None:
            self._errands.ask("keep", self._taught.keep(), apart)

    def _ask_sigma(self) -> None:
        if self._prior is None or self._errands is None:
            return
        session = self._taught.session

        def measure() -> None:
            self._sigma = session.uncertainty().round(6).tolist()

        self._errands.ask("sigma", measure, SIGMA_APART)

    def _ask_chart(self) -> None:
        from gpcjax.teach.chart import chart

        assert self._errands is not None
        taught, (x, y, dim) = self._taught, self._chart

        def draw() -> None:
            self._say_raw(chart(taught.session.act_at, (x, y), dim, self._bounds(), taught.tally.places()))

        self._errands.ask("map", draw, MAP_APART)

    def _measure_lines(self) -> None:
        from gpcjax.engine.evaluate import evaluate, idle
        from gpcjax.envs.registry import make_env, make_expert

        env = make_env(self._task.name)
        starts = 5 if self._task.on_host else 20
        name = self._options.oracle or next(iter(self._task.experts), None)
        numbers: dict[str, float | None] = {"oracle": None}
        numbers["idle"] = _number(evaluate(env, idle(env), starts).returns.mean())
        self._lines = numbers
        self._say("lines", **numbers)
        if name is not None:
            numbers["oracle"] = _number(
                evaluate(env, make_expert(self._task.name, name), starts).returns.mean()
            )
            self._say("lines", **numbers)

    def _failed(self, error: Exception) -> None:
        self._problem(str(error) or type(error).__name__)

    def _end(self, closing: bool = True) -> None:
        if self._errands is not None:
            with contextlib.suppress(UserError, OSError):
                self._ask_keep(0.0)
            for errands in (self._slow, self._painter, self._errands):
                if errands is not None:
                    errands.close(drop=errands is not self._errands)
        self._errands = self._slow = self._painter = None
        self._closing.close()

    # --- what the page is told

    def _say(self, kind: str, **values: Any) -> None:
        self._say_raw({"type": kind, **values})

    def _problem(self, text: str) -> None:
        self._say("problem", text=text)

    def _tell_preparing(self, what: str) -> None:
        self._say("preparing", what=what)

    def _joined(self) -> None:
        """Everything, for a page that knows nothing yet."""
        self._say_raw(self._task_message())
        self._say("ready")
        self._tell_state()
        self._tell_frame()
        if self._lines is not None:
            self._say("lines", **self._lines)
        if self._errands is not None:
            self._ask_chart()

    def _task_message(self) -> dict[str, Any]:
        from gpcjax.teach.telling import described_learner, described_task, episode_of

        taught = self._taught
        tally, course = taught.tally, taught.course
        return {
            "type": "task",
            "task": described_task(self._task, taught.session.learner, self._bounds(), self._axes()),
            "learner": described_learner(course.algo, self._task, dict(course.settings)),
            "learners": [described_learner(name, self._task, {}) for name in self._learners()],
            "repeat": self._options.repeat,
            "credit": dict(course.settings).get("credit"),
            "folder": str(taught.folder),
            "saves": self._saves(),
            "episodes": [episode_of(index, each) for index, each in enumerate(tally.finished)],
            "first": tally.finished[0].obs if tally.finished else [],
            "corrections": tally.corrections,
            "points": list(taught.session.points),
            "rate": tally.latest_rate,
            "lines": self._lines,
        }

    def _learners(self) -> list[str]:
        names = [*built_in("learner"), self._taught.course.algo]
        fits = [name for name in names if name != "coach" or "coach" in self._task.presets]
        return list(dict.fromkeys(fits))

    def _saves(self) -> list[str]:
        folder = self._taught.folder / SAVES
        names = (path.name for path in folder.iterdir()) if folder.is_dir() else ()
        return sorted(name for name in names if NAME.fullmatch(name))

    def _axes(self) -> tuple[int, int]:
        x, y = self._task.view.axes
        size = self._taught.session.learner.obs_size
        axes = (x, y) if max(x, y) < size else (0, min(1, size - 1))
        if (self._chart[:2] != axes and max(self._chart[:2]) >= size) or self._number == 0:
            self._chart = (axes[0], axes[1], 0)
        return axes

    def _bounds(self) -> Any:
        from gpcjax.teach.telling import bounds

        return bounds(self._task, self._taught.session.learner.obs_size, self._taught.tally)

    def _tell_state(self) -> None:
        self._say(
            "state",
            mode=self._mode,
            paused=self._paused,
            why=self._why if self._paused else "",
            speed=self._speed,
            undos=self._taught.session.undos,
        )

    def _tell_frame(self) -> None:
        self._number += 1
        taught, alone = self._taught, self._evaluation
        if alone is not None:
            obs, action, total = alone.obs, alone.action, alone.total
            episode, step = alone.index, alone.length
        else:
            obs, action, total = taught.session.obs, taught.session.action, taught.present.total
            episode, step = taught.episode, taught.present.length
            self._ask_sigma()
        self._say(
            "frame",
            n=self._number,
            episode=episode,
            step=step,
            obs=obs.tolist(),
            action=action.tolist(),
            total=total,
            sigma=self._sigma if alone is None else None,
            prior=self._prior,
            mode=self._mode,
            late=round(self._late, 2),
        )
        now = time.perf_counter()
        if self._task.view.scene == "" and now - self._painted > PICTURES_APART:
            self._painted = now
            self._paint()

    def _paint(self) -> None:
        """A picture of the task as it is now: made here, as its libraries want one thread, and packed elsewhere."""
        from gpcjax.teach.telling import packed

        image = (self._evaluation or self._taught).picture()
        if image is not None and self._painter is not None:
            number = self._number
            self._painter.ask("picture", lambda: self._say_raw(packed(number, image)))

    def _tell_advised(self, press: Press, done: Any) -> None:
        from gpcjax.teach.telling import advised_of

        session = self._taught.session
        self._say(
            "advised",
            n=self._number,
            episode=self._taught.episode,
            step=done.step,
            corrections=self._taught.tally.corrections,
            points=list(session.points),
            undos=session.undos,
            **advised_of(press, done),
        )

    def _tell_episode(self, index: int, ended: Any, corrections: int, why: str) -> None:
        self._say(
            "episode",
            index=index,
            total=ended.total,
            steps=ended.length,
            corrections=corrections,
            mode=self._mode,
            why=why,
        )


_CREDIT = ("credit", "credit_longest", "credit_shape")


def _number(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None


def _reason(error: BaseException) -> str:
    return str(error) if isinstance(error, UserError | Failure | OSError) else f"a fault of gpcjax: {error!r}"
