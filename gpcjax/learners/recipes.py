"""What a learner of a person's own has learned, as named arrays: the leaves of its state, and how it is made again.

Nothing is known of such a learner but its name and its settings; made with these by its own module, it has the shape
that the arrays must have. So it can be unpacked where that module is, and as long as it makes the same.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from gpcjax._x64 import seeded_key, under_own_settings
from gpcjax.allowed import plain
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State
from gpcjax.learners.factory import make_learner
from gpcjax.learners.foreign import arguments
from gpcjax.policies.folder import FORMAT
from gpcjax.registry import find

_MISSING = object()
RECIPE = "recipe"
"""The key of a card that has one."""


@dataclass(frozen=True)
class Recipe:
    """How a learner was made: `make_learner(algo, env, **settings)`; without a task, sizes are among the settings.

    Values are those of JSON; what is not named has the value that the task's presets or the learner itself give it.
    """

    algo: str
    env: str | None
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict, hash=False)

    def made(self) -> Learner:
        """The learner. Raises UserError, or what its own module raises, as ForeignError."""
        return make_learner(self.algo, self.env, **self.settings)


def recipe_of(learner: Learner) -> Recipe:
    """How a learner of somebody's own class can be made again: by that class, with what is compiled in.

    These are whole numbers, truth values and texts; functions have no form. All else that tells it from others is in
    its arrays.

    Raises:
        UserError: its class is not to be found by its name.
    """
    name = f"{type(learner).__module__}:{type(learner).__qualname__}"
    if "<" in name:
        raise UserError(f"learner {name}: its class is defined within a function, define it in a module")
    settings: dict[str, Any] = {"obs_size": learner.obs_size, "action_size": learner.action_size}
    spec = find("learner", name, "learner")
    numeric = {each.name: each.compiled == "value" for each in spec.settings}
    for argument in arguments(spec):
        value = plain(getattr(learner, argument, _MISSING))
        if numeric.get(argument, isinstance(value, str | bool | None)) and value is not _MISSING:
            settings[argument] = np.asarray(value).item() if argument in numeric else value
    return Recipe(name, None, settings)


def other_function(learner: Learner, made: Learner) -> str | None:
    """The name of a field in which a learner has another function than the one that its recipe has made."""
    names = [each.name for each in dataclasses.fields(learner)]
    return next(
        (
            name
            for name in names
            if callable(given := getattr(learner, name)) and given != getattr(made, name, given)
        ),
        None,
    )


def check_plain(place: str, name: str, tree: Any) -> None:
    """Refuses a learner and its state (or their shapes) with a part that is no array of numbers, such as a random key.

    Raises:
        UserError: it begins with `place`, and has the learner's `name`.
    """
    for part, leaf in leaves_of(tree).items():
        if not _is_plain(leaf):
            raise UserError(
                f"{place}: what {name} learns cannot be kept, as its {part} is no array of numbers (of a "
                "random key, jax.random.key_data is one)"
            )


@under_own_settings
def check_recipe(recipe: Recipe, place: str) -> None:
    """Refuses a learner whose state has no form in which it could be kept. Computes nothing of it but shapes.

    Raises:
        UserError: a part of it is no array of numbers, such as a random key; `place` begins the message.
    """
    check_plain(place, recipe.algo, _shapes(recipe.made()))


@under_own_settings
def pack_own(recipe: Recipe, learner: Learner, state: State) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Card and arrays of a learner that `recipe` makes (numbers may be others), and one state of it.

    Numbers that are not finite are kept as they are: what they mean is the learner's own affair.
    """
    leaves = leaves_of((learner, state))
    sizes = {"obs_size": learner.obs_size, "action_size": learner.action_size}
    card = {
        "format": FORMAT,
        "kind": "learner",
        "algo": recipe.algo,
        **sizes,
        RECIPE: dataclasses.asdict(recipe),
    }
    # A dictionary's room is no matter of the recipe: it grows.
    card["shapes"] = {name: list(np.shape(leaf)) for name, leaf in leaves.items()}
    return card, {name: np.asarray(leaf) for name, leaf in leaves.items() if np.size(leaf)}


@under_own_settings
def template_of_own(card: Mapping[str, Any]) -> tuple[Learner, State]:
    """The learner, and the shapes of its state, that a card tells of.

    Raises:
        UserError: its module is not here, or makes something else now.
        KeyError, TypeError: it is no such card.
    """
    told = card[RECIPE]
    env = None if told["env"] is None else str(told["env"])
    recipe = Recipe(str(told["algo"]), env, dict(told["settings"]))
    learner, state = _shapes(recipe.made())
    shapes = {name: tuple(shape) for name, shape in card["shapes"].items()}
    known = {name: np.shape(leaf) for name, leaf in leaves_of((learner, state)).items()}
    # A dictionary has other room, along any axis but that of the action's dimensions.
    grows = find("learner", recipe.algo).dictionary

    def form(shape: tuple[int, ...]) -> tuple[int, ...]:
        return (*shape[:1], len(shape)) if grows else shape

    if {name: form(shape) for name, shape in shapes.items()} != {
        name: form(shape) for name, shape in known.items()
    }:
        raise UserError(f"{recipe.algo} makes a learner of other shapes now than when this was kept")
    names = iter(leaves_of((None, state)))
    return learner, jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(shapes[next(names)], leaf.dtype), state)


def leaves_of(tree: Any) -> dict[str, Any]:
    """Each leaf of (learner, state) by its path, such as `state.policy.points`."""
    paths, _ = jax.tree.flatten_with_path(tree)
    first = ("learner", "state")
    return {first[path[0].idx] + jax.tree_util.keystr(path[1:]): leaf for path, leaf in paths}


def _shapes(learner: Learner) -> tuple[Learner, State]:
    """The learner itself, all of whose numbers are arrays, and the shapes of its first state."""
    learner = jax.tree.map(lambda leaf: leaf if hasattr(leaf, "dtype") else np.asarray(leaf), learner)
    return learner, jax.eval_shape(lambda: learner.init(seeded_key()))


def _is_plain(leaf: Any) -> bool:
    """Whether numpy has this type, so that its bytes can be read again: no random key, no bfloat16."""
    kind = leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype
    return isinstance(kind, np.dtype) and kind.kind in "biufc"
