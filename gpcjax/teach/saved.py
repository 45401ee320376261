"""What a saved learner tells of the lesson that goes on with it: its task, who learns, with what settings. No jax."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.sources import RELATIVES, contents_of
from gpcjax.teach.course import COURSE, SAVES, Course
from gpcjax.teach.made_with import made_with, table


class Saved(NamedTuple):
    """What a saved learner says of itself."""

    folder: Path
    env: str | None
    """What it learned, if it says so."""
    algo: str
    """Who is to go on; what was saved may be of a relative."""
    settings: Mapping[str, Any] | None
    """Those that this learner has not anyway (`gpcjax.teach.made_with`); None where they do not count, as another
    learner is to go on, or on another task."""


def of_saved(folder: Path, algo: str | None, env: str | None) -> Saved:
    """What a person means by the folder of a saved learner.

    Args:
        folder: of `save_learner`, `Session.save` or a lesson.
        algo: who is to go on, if that was said; a relative's state will do.
        env: what is to be taught, likewise. With another learner or another task its settings are not those that were
            saved, but its own.

    Raises:
        UserError: it is no such folder, or damaged, or means nothing to this learner, or has a setting that no lesson
            has.
    """
    place = f"--from {folder}"
    contents = contents_of(folder, "--from")
    (state,) = contents.states
    held, card = state.card["algo"], state.card
    if algo is not None and held not in (algo, *RELATIVES.get(algo, ())):
        raise UserError(
            f"{place}: it holds what {held} learned, which means nothing to {algo}: leave --algo out, or give another "
            "folder"
        )
    learned = _env_of(folder, card)
    alike = algo in (None, held) and (env is None or learned in (None, env))
    taught = env if env is not None else learned
    settings = None
    if alike and taught is not None:
        arrays, credit = contents.arrays(state, "--from"), table(card, "provenance", "session", "settings")
        settings = made_with(place, find("learner", held), taught, card, arrays, credit)
    return Saved(folder, learned, algo or held, settings)


def _env_of(folder: Path, card: Mapping[str, Any]) -> str | None:
    """The task that it learned: by its card, or by the lesson that it lies in."""
    told = [card.get("provenance"), card.get("recipe")]
    for each in told:
        if isinstance(each, Mapping) and isinstance(each.get("env"), str):
            return each["env"]
    lesson = folder.absolute().parent
    if lesson.name == SAVES and (lesson.parent / COURSE).is_file():
        return Course.read(lesson.parent).env
    return None
