"""What a saved learner tells of the lesson that goes on with it: its task, who learns, with what settings. No jax."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gpcjax.describe import LearnerSpec
from gpcjax.errors import UserError
from gpcjax.lateness import CREDIT
from gpcjax.registry import find
from gpcjax.sweep.sources import RELATIVES, contents_of
from gpcjax.teach.course import COURSE, SAVES, Course

_FIELDS = {
    "policy_variance": "policy.kernel.variance",
    "policy_length_scale": "policy.kernel.length_scale",
    "human_variance": "human.kernel.variance",
    "human_length_scale": "human.kernel.length_scale",
    "noise": "policy.noise",
    "human_noise": "human.noise",
    "coach_constant": "constant",
}
"""Where a built-in learner has a setting, if not in a field of its name."""

_NOISE = 1e-7
"""`gpcjax.learners.factory.DEFAULT_NOISE`, which would load jax."""


class Saved(NamedTuple):
    """What a saved learner says of itself."""

    folder: Path
    env: str | None
    """What it learned, if it says so."""
    algo: str
    """Who is to go on; what was saved may be of a relative."""
    settings: Mapping[str, float]
    """Those that this learner has not anyway."""


def of_saved(folder: Path, algo: str | None, env: str | None) -> Saved:
    """What a person means by the folder of a saved learner.

    Args:
        folder: of `save_learner`, `Session.save` or a lesson.
        algo: who is to go on, if that was said; a relative's state will do.
        env: what is to be taught, likewise. With another learner or another task its settings are not those that were
            saved, but its own.

    Raises:
        UserError: it is no such folder, or damaged, or means nothing to this learner, or has a setting of each action
            dimension, which no lesson has.
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
    settings = {}
    if alike and taught is not None:
        settings = _settings(place, find("learner", held), taught, card, contents.arrays(state, "--from"))
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


def _settings(
    place: str, spec: LearnerSpec, env: str, card: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
) -> dict[str, float]:
    """The settings of a learner that are others than those it has on this task."""
    usual = {"noise": _NOISE, **spec.defaults, **find("task", env).presets.get(spec.name, {})}
    usual["human_noise"] = arrays.get("learner.policy.noise")
    if "learner.static_rate" in arrays:
        usual["constant_rate"] = arrays.get("learner.constant_rate")  # beside it, that one changes nothing
    made = {**card, **_table(card, "recipe", "settings"), **_table(card, "provenance", "session", "settings")}
    settings: dict[str, float] = {}
    kinds = {each.name: each.kind for each in spec.settings} | dict.fromkeys(CREDIT, float)
    for name, kind in kinds.items():
        value = arrays.get(f"learner.{_FIELDS.get(name, name)}", made.get(name))
        if value is None or not np.issubdtype(np.asarray(value).dtype, np.number):
            continue
        if usual.get(name) is not None and np.all(np.equal(value, usual[name])):
            continue
        values = np.unique(value)
        if len(values) != 1:
            raise UserError(
                f"{place}: its {name} is another one in each action dimension, and a lesson has one for all: give "
                "another folder"
            )
        settings[name] = kind(values[0])
    return settings


def _table(card: Mapping[str, Any], *names: str) -> Mapping[str, Any]:
    """A table within a table of a card; nothing where there is none."""
    found: Any = card
    for name in names:
        found = found.get(name) if isinstance(found, Mapping) else None
    return found if isinstance(found, Mapping) else {}
