"""One kind of run in a hall: its classroom, its simulations and its clock."""

import math
from typing import Any

from gpcjax.engine.classroom import ROOMS, Classroom, Rooms
from gpcjax.engine.course import credit_of
from gpcjax.engine.seated import in_classroom, leave
from gpcjax.envs.registry import make_env
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner
from gpcjax.registry import find
from gpcjax.study.standing import Run
from gpcjax.teach.beginning import beginning
from gpcjax.teach.course import COURSE, RECORD, Course, seconds_of
from gpcjax.teach.credit import credited
from gpcjax.teach.tally import Tally
from gpcjax.teach.taught import Taught, settings_of
from gpcjax.teach.telling import axes_of, bounds, described_task
from gpcjax.teach.worlds import Worlds


class Kind:
    """Runs of one task with learners of one structure.

    Args:
        course: one of them.
        places: how many at most.
    """

    def __init__(self, course: Course, places: int):
        learner, settings = self.learner_of(course), settings_of(course)
        self._classroom = Classroom(learner, credit_of(settings), _rooms(course), places)
        self._worlds = Worlds(make_env(course.env), places)
        task = find("task", course.env)
        self.seconds = seconds_of(task)
        """Of a step."""
        self.action_size = learner.action_size
        prior = float(learner.largest_sigma())
        self.prior = prior if prior > 0 else None
        size = learner.obs_size
        axes = axes_of(task, size)
        # Without pictures: each takes longer than the steps of all.
        self.described: dict[str, Any] = described_task(
            task, learner, bounds(task, size, Tally()), axes, pictures=False
        )
        self.due = math.inf
        """When the next step of all is, by `time.perf_counter`."""

    @property
    def classroom(self) -> Classroom:
        """Where the learners are."""
        return self._classroom

    @property
    def worlds(self) -> Worlds:
        """Where the tasks are."""
        return self._worlds

    @staticmethod
    def learner_of(course: Course) -> Learner:
        """That of a course, with room for what it learns at first."""
        rooms = _rooms(course)
        return beginning(course, None, rooms[0][0] if rooms else None)[0]

    def compile(self) -> None:
        """All that a run needs, whatever it comes to."""
        self._worlds.compile()
        self._classroom.compile()

    def prepare(self, run: Run) -> Taught:
        """What is taught in a run: begun, or made again from its recording, in a place of this kind.

        Raises:
            UserError: it cannot be written, or what there is of it is damaged.
        """
        record = run.folder / RECORD
        if record.exists() and record.stat().st_size == 0:  # its process died as it was begun
            record.unlink()
        if (run.folder / COURSE).exists() and Course.read(run.folder) != run.course:
            raise UserError(f"{run.folder}: something else is taught there, give a new folder")
        if record.exists():
            return self._resumed(run)
        run.course.write(run.folder)
        settings = settings_of(run.course)
        session = in_classroom(self._classroom, self.learner_of(run.course), settings, record)
        taught = Taught(
            run.folder, run.course, session, self._worlds.enter(run.course.seed), Tally(credited(run.course))
        )
        try:
            taught.begin_episode()
        except UserError:
            self.release(taught)
            raise
        return taught

    def release(self, taught: Taught) -> None:
        """Gives the place back."""
        leave(taught.session)
        self._worlds.leave(taught.world)

    def _resumed(self, run: Run) -> Taught:
        taught = Taught.resume(run.folder, lambda line: None, places=self)
        try:
            if not taught.present.obs and len(taught.tally.finished) < run.episodes:
                taught.begin_episode()
        except UserError:
            self.release(taught)
            raise
        return taught


def _rooms(course: Course) -> Rooms:
    return ROOMS if find("learner", course.algo).dictionary else ()
