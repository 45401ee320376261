"""The learner and the state that a lesson begins with."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State
from gpcjax.learners.carried import carried
from gpcjax.learners.recipes import Recipe
from gpcjax.learners.saved import load_learner
from gpcjax.policies.folder import write_folder
from gpcjax.registry import built_in
from gpcjax.sweep.build import learner_of, pack_learned, recipe_of
from gpcjax.sweep.given import Given
from gpcjax.sweep.learned import learned_of
from gpcjax.sweep.rehearsal import check_columns, rehearse_learner
from gpcjax.teach.course import DICTIONARY, Course
from gpcjax.teach.made_with import as_given
from gpcjax.teach.origin import Origin
from gpcjax.teach.saved import of_saved

_ROOM = ("policy_capacity", "human_capacity", "on_full")
"""Options of a dictionary that are those of any lesson."""


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
        found = of_saved(origin, course.algo, course.env)
        folder, (source, state) = origin, load_learner(origin)
        whence = {"saved": folder.name}
    else:
        found = origin
        folder, (source, state) = origin.folder, learned_of(origin.folder, "state", origin.row, grown=False)
        whence = {"run": folder.name, "seed": origin.seed, "episode": int(origin.row["episode"])}
    place = f"--from {folder}"
    cell = course.cell(1)
    learner = learner_of(cell, DICTIONARY)
    # How the dictionary of another's learner grows is its own affair: an equal one goes on with what it has.
    if course.algo in built_in("learner") or not _is_same(source, learner):
        state = carried(source, state, learner, (DICTIONARY, DICTIONARY), place)
    if found.settings is not None and found.algo == course.algo and found.env in (None, course.env):
        _check_made_by(place, found.settings, course, source)
    card, arrays = pack_learned(cell, learner, state)
    write_folder(start, {**card, "provenance": {"env": course.env, **whence}}, arrays)


def _check_made_by(place: str, settings: Mapping[str, Any], course: Course, source: Learner) -> None:
    """Refuses a learner that is another one than these settings make, as a lesson could not say what it teaches.

    Raises:
        UserError: it is; the message names in what.
    """
    given = {"env": Given(course.env, place), "algo": Given((course.algo,), place)}
    recipe = recipe_of(Course.of({**given, **as_given(place, settings)}).cell(1))
    room = {
        name: getattr(source, name) for name in _ROOM if name in recipe.settings and hasattr(source, name)
    }
    made = Recipe(recipe.algo, recipe.env, {**recipe.settings, **room}).made()
    for each in dataclasses.fields(source):
        old, new = (getattr(learner, each.name, None) for learner in (source, made))
        if not _is_same(old, new):
            raise UserError(
                f"{place}: its {each.name} is {shown(old)}, and no setting of a lesson says so (it would be "
                f"{shown(new)}): make a class or a function of your own that has it, or give another folder"
            )


def _is_same(one: Any, other: Any) -> bool:
    """Whether all is the same, whatever its numbers are kept in; one that nobody gave, NaN, is one that nobody gave."""
    (mine, form), (theirs, other_form) = (
        jax.tree.flatten(jax.tree.map(np.asarray, each)) for each in (one, other)
    )
    return form == other_form and all(
        a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
        for a, b in zip(mine, theirs, strict=True)
    )
