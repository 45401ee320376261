"""All that a learner has learned as named arrays and a card of JSON values.

The card names the algorithm, the sizes and the other settings that are no arrays; from them the shape of everything
follows, and the arrays must have it. `gpcjax.learners.saved` keeps them in folders, others elsewhere. The policy alone
is a controller, which a lane has: see `gpcjax.policies.saved.pack_controller`. For learners that are not built in see
`gpcjax.learners.recipes`.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.learners.base import Learner, State
from gpcjax.learners.calls import check_kept
from gpcjax.learners.cards import checked_settings, settings_of, shapes_of_state, template_with
from gpcjax.learners.coach import COACH
from gpcjax.learners.compiled import check_fields
from gpcjax.learners.dcoach import DCoach
from gpcjax.learners.gpc import GPC
from gpcjax.learners.recipes import (
    RECIPE,
    check_plain,
    differing,
    leaves_of,
    made_again,
    pack_own,
    recipe_of,
    shapes_of,
    template_of_own,
    unsaid,
)
from gpcjax.policies.checkpoint import first_line
from gpcjax.policies.folder import FORMAT

_BUILT_IN = (GPC, COACH, DCoach)

_ANOTHER = "this learner and this state cannot be saved: give a learner as make_learner makes it, and one state of it"


@under_own_settings
def pack_learner(learner: Any, state: State) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a folder keeps of a learner and its state, for whoever keeps it elsewhere.

    That is a card of JSON values, and named arrays of at least one entry each, with all their room (see `compact`).

    One of a person's own is made again by its class, which must be found by its name in a module.

    Raises:
        ValueError: a learner or a state that has no format, that is not finite, or not the learner's.
    """
    learner = checked_learner(learner)
    check_kept(state)
    if type(learner) not in _BUILT_IN:
        return _packed_own(fixed(learner), state)
    settings = settings_of(learner, state)
    template = template_with(settings)
    given, expected = leaves_of((learner, state)), leaves_of(template)
    same = jax.tree.structure((learner, state)) == jax.tree.structure(template)
    if not same or {name: _kind(leaf) for name, leaf in given.items()} != {
        name: _kind(leaf) for name, leaf in expected.items()
    }:
        raise UserError(_ANOTHER)
    # Nothing is kept of arrays without entries, which the checkpoint does not take, nor of what nobody gave.
    left_out = unsaid(template[0])
    arrays = {name: np.asarray(leaf) for name, leaf in given.items() if leaf.size and name not in left_out}
    odd = _not_finite(arrays)
    if odd:
        raise UserError(f"this learner cannot be saved: {odd} is not finite")
    return {"format": FORMAT, "kind": "learner", **settings}, arrays


def _packed_own(learner: Learner, state: State) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The same of a learner of somebody's own, if its class makes such a one again, whose numbers fit into it."""
    recipe = recipe_of(learner)
    check_fields(learner)
    check_plain("this learner cannot be saved", recipe.algo, (learner, state))
    try:
        template, odd = made_again(recipe, shapes_of((learner, state)))
    except UserError as error:
        raise UserError(f"{_ANOTHER} ({error})") from None
    check_plain("this learner cannot be saved", recipe.algo, template)
    odd = odd or differing(learner, template[0])
    if not odd and jax.tree.structure((learner, state)) != jax.tree.structure(template):
        odd = f"its state is another structure than {recipe.algo} makes"
    card, arrays = pack_own(recipe, learner, state)
    if not odd:
        arrays, odd = _fitted(template, arrays)
        odd = odd and f"{odd} holds numbers that {_kind(leaves_of(template)[odd])[1]} cannot hold"
    if odd:
        raise UserError(f"{_ANOTHER} ({odd})")
    return card, {name: value for name, value in arrays.items() if value.size}


@under_own_settings
def compact(learner: Learner, state: State) -> State:
    """The same state (arrays on the host) with room for no more points than it has, one at least.

    `learner.resize` gives it back to the bit: what it adds is always the same. Room for anything but points stays.
    """
    if not isinstance(learner, GPC):
        return state
    used = (max(1, int(np.max(each.count))) for each in (state.policy, state.human))
    shapes = shapes_of_state(learner, dict(zip(("policy", "human"), used, strict=True)))
    return jax.tree.map(lambda leaf, least: np.asarray(leaf)[tuple(map(slice, least.shape))], state, shapes)


@under_own_settings
def unpack_learner(
    card: Mapping[str, Any], arrays: Mapping[str, np.ndarray], source: Any = "packed"
) -> tuple[Learner, State]:
    """The learner and the state that were packed (`pack_learner`).

    Raises:
        ValueError: card and arrays make none; the message begins with the `source`.
    """
    if card.get("kind") != "learner" or card.get("format") != FORMAT:
        raise UserError(f"{source}: this is not a learner's card of format {FORMAT}")
    return unpacked(template_of(card, source), arrays, source)


def template_of(card: Mapping[str, Any], source: Any) -> tuple[Learner, State]:
    """The shape that a card tells of. Raises UserError."""
    try:
        if RECIPE in card:
            return template_of_own(card)
        return template_with(checked_settings(card))
    except (UserError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{source}: this is not a learner's card ({first_line(error)})") from None


def unpacked(
    template: tuple[Learner, State], arrays: Mapping[str, np.ndarray], source: Any
) -> tuple[Learner, State]:
    """These arrays in the structure of `template`, if they have its names, shapes and types. Raises UserError.

    Those of a built-in learner must be finite.
    """
    arrays, odd = _fitted(template, arrays)
    if not odd and type(template[0]) in _BUILT_IN:
        left_out = unsaid(template[0])
        odd = _not_finite({name: value for name, value in arrays.items() if name not in left_out})
        odd = odd or next((name for name in left_out if not np.isnan(arrays[name])), "")
    if odd:
        raise UserError(f"{source}: this learner is damaged ({odd} is not what the card says)")
    leaves = [jnp.asarray(arrays[name]) for name in leaves_of(template)]
    return jax.tree.unflatten(jax.tree.structure(template), leaves)


def _fitted(
    template: tuple[Learner, State], arrays: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], str]:
    """All arrays that `template` has, and the first name whose array is of another shape or type, or "".

    A learner of a person's own may hold numbers of another type, which become the same ones of this type.
    """
    expected = leaves_of(template)
    empty = {name: np.zeros(leaf.shape, leaf.dtype) for name, leaf in expected.items() if not leaf.size}
    arrays = empty | unsaid(template[0]) | dict(arrays)
    if type(template[0]) not in _BUILT_IN:
        arrays = {
            name: _cast(value, expected[name].dtype) if name in expected else value
            for name, value in arrays.items()
        }
    odd = next(
        (name for name in expected if name not in arrays or _kind(arrays[name]) != _kind(expected[name])), ""
    )
    return arrays, odd or next(iter(arrays.keys() - expected.keys()), "")


def _cast(value: np.ndarray, kind: np.dtype) -> np.ndarray:
    """The same numbers in another type, or `value` itself where they would be others."""
    if value.dtype == kind or not np.can_cast(value.dtype, kind, "same_kind"):
        return value
    with np.errstate(all="ignore"):
        cast = value.astype(kind)
        same = np.array_equal(cast.astype(value.dtype), value, equal_nan=True)
    return cast if same else value


def checked_learner(learner: Any) -> Learner:
    """What was given, if it is a learner. Raises UserError."""
    if not isinstance(learner, Learner):
        raise UserError(f"learner {shown(learner)}: give a learner, from make_learner")
    return learner


def _kind(leaf: Any) -> tuple[tuple[int, ...], np.dtype]:
    return tuple(np.shape(leaf)), np.dtype(leaf.dtype)


def _not_finite(arrays: Mapping[str, np.ndarray]) -> str:
    """The first array with other than finite numbers, or nothing."""
    return next((name for name, value in arrays.items() if not np.isfinite(value).all()), "")
