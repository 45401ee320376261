"""What a learner of a person's own has learned, as named arrays: the leaves of its state, and how it is made again.

Nothing is known of such a learner but its name and its settings; made with these by its own module, it has the shape
that the arrays must have. So it can be unpacked where that module is, and as long as it makes the same.
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np

from gpcjax._x64 import seeded_key, under_own_settings
from gpcjax.allowed import plain, shown
from gpcjax.errors import ForeignError, UserError
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
    for argument, default in arguments(spec).items():
        value = plain(getattr(learner, argument, _MISSING))
        if numeric.get(argument, _is_told(value, default)) and value is not _MISSING:
            settings[argument] = np.asarray(value).item() if argument in numeric else value
    return Recipe(name, None, settings)


def _is_told(value: object, default: object) -> bool:
    """Whether an argument that is no setting is part of how a learner is made again."""
    # A number where there usually is nothing, too: the class makes no array there that it could be put into.
    is_number = isinstance(value, int | float) and math.isfinite(value)
    return isinstance(value, str | bool | None) or (default is None and is_number)


def differing(learner: Learner, made: Learner) -> str:
    """In which field a learner is another one than its recipe has made, as far as its arrays do not tell it, or ""."""
    for field in dataclasses.fields(learner):
        given, other = getattr(learner, field.name), getattr(made, field.name)
        same = given == other if field.metadata.get("static") else _form(given) == _form(other)
        if not same and isinstance(given, eqx.Module):
            return f"{field.name} has another structure than its class gives it"
        if not same and callable(given):
            return f"{field.name} is another function than its class has: write a class that has it"
        if not same:
            return f"{field.name} {shown(given)} is {shown(other)} as its class makes it"
    return ""


def _form(value: Any) -> Any:
    return value if callable(value) and not isinstance(value, eqx.Module) else jax.tree.structure(value)


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
    check_plain(place, recipe.algo, _shapes(recipe.made(), {}))


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
    card["shapes"] = {name: list(shape) for name, shape in shapes_of((learner, state)).items()}
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
    template, odd = made_again(recipe, {name: tuple(shape) for name, shape in card["shapes"].items()})
    if odd:
        raise UserError(f"{recipe.algo} makes a learner of other shapes now than when this was kept: {odd}")
    return template


def made_again(recipe: Recipe, shapes: Mapping[str, tuple[int, ...]]) -> tuple[tuple[Learner, State], str]:
    """The learner of a recipe and the form of its state, in arrays of these shapes, and what has none of them, or "".

    Those of the learner itself may be of any shape; one of its state is as `init` makes it, or as it has grown.
    """
    learner, state = _shapes(recipe.made(), shapes)
    known, shapes = shapes_of((learner, state)), {**dict.fromkeys(unsaid(learner), ()), **shapes}
    odd = next((name for name in {**known, **shapes} if known.get(name) != shapes.get(name)), "")
    if not odd:
        return (learner, state), ""
    if known.keys() == shapes.keys():
        names = iter(leaves_of((None, state)))
        form = lambda leaf: jax.ShapeDtypeStruct(shapes[next(names)], leaf.dtype)  # noqa: E731
        grown = jax.tree.map(form, state)
        if _grows(recipe, known, shapes) or shapes_of((learner, _like(learner, grown))) == shapes:
            return (learner, grown), ""
    told, made = (f"of shape {each[odd]}" if odd in each else "not there" for each in (shapes, known))
    return (learner, state), f"{odd} is {told}, and {made} as {recipe.algo} makes it"


def _grows(recipe: Recipe, known: Mapping[str, Any], shapes: Mapping[str, Any]) -> bool:
    """Whether they differ as dictionaries do, which have other room along any axis but that of the dimensions."""
    return find("learner", recipe.algo).dictionary and all(
        (*known[name][:1], len(known[name])) == (*shapes[name][:1], len(shapes[name])) for name in known
    )


def _like(learner: Learner, state: State) -> State:
    """The form of a state with the room of this one, which is one of this learner's if that is its own form."""
    try:
        return jax.eval_shape(lambda state: learner._like(state), state)
    except Exception as error:  # of a person's own method
        raise ForeignError(f"{type(learner).__name__} cannot be asked for a larger state", error) from None


def leaves_of(tree: Any) -> dict[str, Any]:
    """Each leaf of (learner, state) by its path, such as `state.policy.points`."""
    paths, _ = jax.tree.flatten_with_path(tree)
    first = ("learner", "state")
    return {first[path[0].idx] + jax.tree_util.keystr(path[1:]): leaf for path, leaf in paths}


def unsaid(learner: Learner) -> dict[str, np.ndarray]:
    """The single numbers of a learner that are NaN, which is one that nobody gave, such as GPC's `static_rate`.

    What is kept may have no array of it: 0.2.0 had none in the learner either.
    """
    single = {name: leaf for name, leaf in leaves_of((learner, None)).items() if np.shape(leaf) == ()}
    known = {
        name: np.asarray(leaf) for name, leaf in single.items() if not isinstance(leaf, jax.ShapeDtypeStruct)
    }
    return {name: number for name, number in known.items() if number.dtype.kind == "f" and np.isnan(number)}


def shapes_of(tree: tuple[Learner, State]) -> dict[str, tuple[int, ...]]:
    """That of each leaf, by its path."""
    return {name: np.shape(leaf) for name, leaf in leaves_of(tree).items()}


def in_arrays(learner: Learner) -> Learner:
    """The same learner, all of whose numbers are arrays: one of a person's own may have numbers of Python's."""
    return jax.tree.map(lambda leaf: leaf if hasattr(leaf, "dtype") else np.asarray(leaf), learner)


def _shapes(learner: Learner, shapes: Mapping[str, tuple[int, ...]]) -> tuple[Learner, State]:
    """The learner itself, all of whose numbers are arrays, and the form of its first state.

    Where it is to have other `shapes` there are forms in place of its arrays.
    """
    learner = in_arrays(learner)
    leaves = leaves_of((learner, None))
    others = {
        name: jax.ShapeDtypeStruct(shapes[name], leaf.dtype)
        for name, leaf in leaves.items()
        if shapes.get(name, np.shape(leaf)) != np.shape(leaf)
    }
    made = lambda others: jax.tree.unflatten(jax.tree.structure(learner), ({**leaves, **others}).values())  # noqa: E731
    return made(others), jax.eval_shape(lambda others: made(others).init(seeded_key()), others)


def _is_plain(leaf: Any) -> bool:
    """Whether numpy has this type, so that its bytes can be read again: no random key, no bfloat16."""
    kind = leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype
    return isinstance(kind, np.dtype) and kind.kind in "biufc"
