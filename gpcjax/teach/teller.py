"""What the page is told of a lesson, and what can wait: the map, sigma_h, the lines, pictures, rows.

Over 300 lines: one class, as what is told now and what is told later share the time between two steps.
"""

import contextlib
import time
from typing import TYPE_CHECKING, Any

from gpcjax.engine.evaluate import evaluate, idle
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.errors import UserError
from gpcjax.registry import built_in, find
from gpcjax.sweep.fitting import lacking
from gpcjax.teach.chart import chart
from gpcjax.teach.clerk import Clerk
from gpcjax.teach.course import SAVES
from gpcjax.teach.errands import Errands
from gpcjax.teach.evaluation import Evaluation
from gpcjax.teach.protocol import NAME, Press
from gpcjax.teach.standing import Options, Say, Standing
from gpcjax.teach.taught import Advised, Taught
from gpcjax.teach.telling import (
    advised_of,
    axes_of,
    bounds,
    described_learner,
    described_task,
    episode_of,
    finite,
    packed,
)
from gpcjax.teach.world import Picture

if TYPE_CHECKING:
    from gpcjax.teach.tally import Episode

PICTURES_APART = 0.04
MAP_APART, SIGMA_APART, KEEP_APART, FLUSH_APART = 0.5, 0.2, 10.0, 1.0
"""Seconds between two of a kind."""

STARTS, STARTS_ON_HOST = 20, 5
"""Episodes of which a line is the mean."""


class Teller:
    """Of one lesson. Its methods belong to the lesson's thread, but for what its errands do.

    Args:
        taught: the lesson.
        standing: how it stands; the lesson changes it.
        options: how it is held.
        say: takes the messages.
        frames: how many there were before, of other lessons.
    """

    def __init__(self, taught: Taught, standing: Standing, options: Options, say: Say, frames: int = 0):
        self._taught, self._standing, self._options, self._say_raw = taught, standing, options, say
        session = taught.session
        self.task = find("task", taught.course.env)
        self.number = frames
        """Of the latest frame."""
        self._sigma: list[float] | None = None
        prior = float(session.learner.largest_sigma())
        self._prior = prior if prior > 0 else None
        self._lines: dict[str, float | None] | None = None
        self._painted, self._pictures = 0.0, self.task.view.scene == ""
        self._axes = axes_of(self.task, session.learner.obs_size)
        self._chart = (*self._axes, 0)
        self._quick, self._painter, self._papers = (Errands(self._failed) for _ in range(3))
        self._clerk: Clerk | None = None
        self._closed = False

    def begin(self) -> None:
        """Compiles and measures what is told, before anybody waits for a step."""
        self._clerk = Clerk()
        self._draw_chart()
        if self._pictures:
            self._pictures = self._picture(self._taught) is not None
        try:
            self._measure_lines()
        except Exception as error:  # of a task or an expert of a person's own: it is taught without
            self.problem(f"the lines of the expert and of doing nothing are missing: {_words(error)}")

    def close(self) -> None:
        """Has written what there is; what nobody wants any more is left."""
        self._closed = True
        with contextlib.suppress(UserError, OSError):
            self.keep(0.0)
        self._painter.close(drop=True)
        self._quick.close()
        self._papers.close()
        if self._clerk is not None:
            self._clerk.close()

    # --- messages

    def say(self, kind: str, **values: Any) -> None:
        """A message of this type."""
        self._say_raw({"type": kind, **values})

    def problem(self, text: str) -> None:
        """Something that was asked for cannot be done."""
        self.say("problem", text=text)

    def everything(self) -> None:
        """For a page that knows nothing yet."""
        self._say_raw(self._task_message())
        self.say("ready")
        self.state()
        self.frame(None)
        if self._lines is not None:
            self.say("lines", **self._lines)
        self.ask_chart()

    def state(self) -> None:
        """How it stands."""
        now = self._standing
        why = now.why if now.paused else ""
        undos = self._taught.session.undos
        self.say("state", mode=now.mode, paused=now.paused, why=why, speed=now.speed, undos=undos)

    def frame(self, alone: Evaluation | None) -> None:
        """The present step, of the policy alone where there is an evaluation."""
        self.number += 1
        taught = self._taught
        if alone is not None:
            obs, action, total = alone.obs, alone.action, alone.total
            episode, step = alone.index, alone.length
        else:
            obs, action, total = taught.session.obs, taught.session.action, taught.present.total
            episode, step = taught.episode, taught.present.length
            self.ask_sigma()
        self.say(
            "frame",
            n=self.number,
            episode=episode,
            step=step,
            obs=obs.tolist(),
            action=action.tolist(),
            total=total,
            sigma=self._sigma if alone is None else None,
            prior=self._prior,
            mode=self._standing.mode,
            late=round(self._standing.late, 2),
        )
        now = time.perf_counter()
        if self._pictures and now - self._painted > PICTURES_APART:
            self._painted = now
            self._paint(alone or taught)

    def advised(self, press: Press, done: Advised) -> None:
        """What an advice did; and what follows from a policy that has changed."""
        taught = self._taught
        self.say(
            "advised",
            n=self.number,
            episode=taught.episode,
            step=done.step,
            corrections=taught.tally.corrections,
            points=list(taught.session.points),
            undos=taught.session.undos,
            **advised_of(press, done),
        )
        self._changed()

    def undone(self) -> None:
        """What is left after an advice was taken back."""
        taught = self._taught
        self.say(
            "undone",
            corrections=taught.tally.corrections,
            points=list(taught.session.points),
            undos=taught.session.undos,
        )
        self._changed()

    def episode(self, index: int, ended: "Episode | Evaluation", corrections: int, why: str) -> None:
        """An episode that has ended."""
        self.say(
            "episode",
            index=index,
            total=ended.total,
            steps=ended.length,
            corrections=corrections,
            mode=self._standing.mode,
            why=why,
        )

    def saved(self, name: str) -> None:
        """What is saved now."""
        self.say("saved", name=name, saves=self._saves())

    def _task_message(self) -> dict[str, Any]:
        taught = self._taught
        tally, course = taught.tally, taught.course
        return {
            "type": "task",
            "task": described_task(
                self.task, taught.session.learner, self._bounds(), self._axes, self._pictures
            ),
            "learner": described_learner(course.algo, self.task, dict(course.settings)),
            "learners": [described_learner(name, self.task, {}) for name in self.learners()],
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

    def learners(self) -> list[str]:
        """Who can be chosen to learn."""
        names = [*built_in("learner"), self._taught.course.algo]
        return list(dict.fromkeys(name for name in names if not lacking(find("learner", name), self.task)))

    def _saves(self) -> list[str]:
        folder = self._taught.folder / SAVES
        names = (path.name for path in folder.iterdir()) if folder.is_dir() else ()
        return sorted(name for name in names if NAME.fullmatch(name))

    def _bounds(self) -> Any:
        return bounds(self.task, self._taught.session.learner.obs_size, self._taught.tally)

    # --- errands

    def keep(self, apart: float = KEEP_APART) -> None:
        """Has policy and rows written as they are now."""
        kept = self._taught.kept()

        def write() -> None:
            now = kept(self._taught.session)
            if self._clerk is None:
                now.write()
            else:
                self._clerk.write(now)

        self._papers.ask("keep", write, apart)

    def flush(self) -> None:
        """Has the recording on the disk each second, as long as the lesson goes on."""

        def flush() -> None:
            self._taught.session.flush()
            if not self._standing.paused and not self._closed:
                self.flush()

        self._quick.ask("flush", flush, FLUSH_APART)

    def ask_sigma(self) -> None:
        """Has sigma_h measured, for the frames that follow."""
        if self._prior is not None:
            self._quick.ask("sigma", self._measure_sigma, SIGMA_APART)

    def ask_chart(self, x: int | None = None, y: int | None = None, dim: int = 0) -> None:
        """Has the map drawn, over these two numbers of an observation from now on if they are given."""
        learner = self._taught.session.learner
        if x is not None and y is not None:
            if max(x, y) >= learner.obs_size or x == y or dim >= learner.action_size:
                return
            self._chart = (x, y, dim)
        self._quick.ask("map", self._draw_chart, MAP_APART)

    def _changed(self) -> None:
        self.ask_chart()
        self.ask_sigma()

    def _measure_sigma(self) -> None:
        self._sigma = self._taught.session.uncertainty().round(6).tolist()

    def _draw_chart(self) -> None:
        x, y, dim = self._chart
        taught = self._taught
        self._say_raw(chart(taught.session.act_at, (x, y), dim, self._bounds(), taught.tally.places()))

    def _measure_lines(self) -> None:
        env = make_env(self.task.name)
        starts = STARTS_ON_HOST if self.task.on_host else STARTS
        name = self._options.oracle or next(iter(self.task.experts), None)
        numbers: dict[str, float | None] = {"oracle": None}
        numbers["idle"] = finite(evaluate(env, idle(env), starts).returns.mean())
        self._lines = numbers
        if name is not None:
            expert = make_expert(self.task.name, name)
            numbers["oracle"] = finite(evaluate(env, expert, starts).returns.mean())

    def _paint(self, shown: Taught | Evaluation) -> None:
        """A picture of the task as it is now: made here, as its libraries want one thread, and packed elsewhere."""
        image, number = self._picture(shown), self.number
        if image is not None:
            self._painter.ask("picture", lambda: self._say_raw(packed(number, image)))

    def _picture(self, shown: Taught | Evaluation) -> Picture | None:
        try:
            return shown.picture()
        except UserError as error:  # it is taught without, and not asked at each step
            self._pictures = False
            self.problem(f"there are no pictures: {error}")
            return None

    def _failed(self, error: Exception) -> None:
        self.problem(_words(error))


def _words(error: Exception) -> str:
    told = isinstance(error, UserError | OSError) and str(error)
    return str(error) if told else f"{type(error).__name__}: {error}"
