"""The learner and the state that a lesson begins with."""

from pathlib import Path

import equinox as eqx

from gpcjax.learners.base import Learner, State
from gpcjax.learners.carried import carried
from gpcjax.learners.saved import load_learner
from gpcjax.policies.folder import write_folder
from gpcjax.registry import built_in
from gpcjax.sweep.build import learner_of, pack_learned
from gpcjax.sweep.learned import learned_of
from gpcjax.sweep.rehearsal import check_columns, rehearse_learner
from gpcjax.teach.course import DICTIONARY, Course
from gpcjax.teach.origin import Origin


def beginning(course: Course, start: Path | None, room: int | None = None) -> tuple[Learner, State | None]:
    """Those in the folder `start`; without one an untaught learner, whose first state is its own affair.

    `room` is for how many points it has room at first; for as many as there will be without.

    Raises:
        UserError: what is in `start` is damaged, or a measurement has the name of a column that there is.
        ForeignError: a method of a learner of a person's own fails, or gives something else than it should.
    """
    if start is None:
        learner, state = learner_of(course.cell(1), DICTIONARY if room is None else room), None
    else:
        learner, state = load_learner(start)
    if course.algo not in built_in("learner"):
        rehearse_learner(course.algo, learner)
        check_columns(course.cell(1), learner, ())
    return learner, state


def put(origin: Origin, start: Path, course: Course) -> None:
    """Makes the folder `start` of what a lesson shall begin with.

    It holds what `gpcjax.save_learner` would have written of the learner of this course at that point: what is taught
    is what the course says, and has the room of any lesson.

    Raises:
        UserError: what was learned is damaged, or means nothing to this learner.
    """
    if isinstance(origin, Path):
        folder, (source, state) = origin, load_learner(origin)
        whence = {"saved": folder.name}
    else:
        folder, (source, state) = origin.folder, learned_of(origin.folder, "state", origin.row)
        whence = {"run": folder.name, "seed": origin.seed, "episode": int(origin.row["episode"])}
    cell = course.cell(1)
    learner = learner_of(cell, DICTIONARY)
    # How the dictionary of another's learner grows is its own affair: an equal one goes on with what it has.
    if course.algo in built_in("learner") or not eqx.tree_equal(source, learner):
        state = carried(source, state, learner, (DICTIONARY, DICTIONARY), f"--from {folder}")
    card, arrays = pack_learned(cell, learner, state)
    write_folder(start, {**card, "provenance": {"env": course.env, **whence}}, arrays)
