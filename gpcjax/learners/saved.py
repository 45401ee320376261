"""Saving what a learner has learned: its policy alone, or all of it, to go on teaching.

A learner and its state are a folder as a policy is (`gpcjax.policies.folder`). The card names the algorithm, the sizes
and the other settings that are no arrays; from them the shape of everything follows, and the arrays must have it.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import COUNT, SWITCH, OneOf, checked, shown
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State
from gpcjax.learners.coach import COACH
from gpcjax.learners.dcoach import DCoach
from gpcjax.learners.descriptions import CAPACITY, D_COACH, ON_FULL
from gpcjax.learners.factory import ALLOWED, make_learner
from gpcjax.learners.gpc import GPC
from gpcjax.policies.folder import CARD, first_line, read_arrays, read_card, write_folder
from gpcjax.policies.saved import save_controller

_SIZES_OF_D_COACH = {each.name: each.allowed for each in D_COACH.settings if each.compiled == "value"}
"""The settings of D-COACH that the shapes of its state, and how it learns, follow from; the others are arrays."""

_OWN = ("learner", "obs_size", "action_size")
"""What the card of a policy says of its learner."""


@under_own_settings
def save_policy(path: Any, learner: Any, state: State, **provenance: Any) -> None:
    """Writes the policy of `state` into a new folder, for `load_policy`.

    Args:
        path: the folder; it must not exist.
        learner, state: whose policy.
        **provenance: JSON values for the card, such as `env="cartpole"` or `teacher="Ada"`; numpy's numbers too.

    Raises:
        FileExistsError: there is something at `path`.
        ValueError: `learner` is none, its policy is not finite, or provenance has values that are not.
        TypeError: provenance has values that JSON does not know.
    """
    learner = _checked_learner(learner)
    taken = sorted(provenance.keys() & set(_OWN))
    if taken:
        raise UserError(f"{taken[0]}: the learner says it itself, leave it out")
    sizes = {"obs_size": learner.obs_size, "action_size": learner.action_size}
    save_controller(
        path, learner.policy_of(state).controller, {"learner": type(learner).__name__, **sizes, **provenance}
    )


@under_own_settings
def save_learner(path: Any, learner: Any, state: State, **provenance: Any) -> None:
    """Writes a learner and its state into a new folder, for `load_learner`: all that is needed to go on teaching.

    Args:
        path: the folder; it must not exist.
        learner, state: from `make_learner` (numbers may be others), and one state of it, no batch.
        **provenance: JSON values for the card, such as `env="cartpole"` or `teacher="Ada"`; numpy's numbers too.

    Raises:
        FileExistsError: there is something at `path`.
        ValueError: a learner or a state that has no format, that is not finite, or not the learner's.
        TypeError: provenance has values that JSON does not know.
    """
    settings = _settings(_checked_learner(learner), state)
    template = _template(settings)
    given, expected = _leaves((learner, state)), _leaves(template)
    same = jax.tree.structure((learner, state)) == jax.tree.structure(template)
    if not same or {name: _kind(leaf) for name, leaf in given.items()} != {
        name: _kind(leaf) for name, leaf in expected.items()
    }:
        raise UserError(
            "this learner and this state cannot be saved: give a learner as make_learner makes it, and one state of it"
        )
    # Nothing is kept of arrays without entries, which the checkpoint does not take.
    arrays = {name: np.asarray(leaf) for name, leaf in given.items() if leaf.size}
    odd = _not_finite(arrays)
    if odd:
        raise UserError(f"this learner cannot be saved: {odd} is not finite")
    write_folder(path, {"kind": "learner", **settings, "provenance": provenance}, arrays)


@under_own_settings
def load_learner(path: Any) -> tuple[Learner, State]:
    """The learner and the state that `save_learner` wrote: corrections go on to the bit as if nothing had been between.

    Raises:
        ValueError: there is no learner at `path`, one of another format, or one that is damaged; the message names the
            file.
    """
    card = read_card(path, "learner")
    file = Path(path) / CARD
    if card.get("kind") != "learner" or card["format"] == 1:
        raise UserError(f"{file}: this is not a learner's card (its kind is {shown(card.get('kind'))})")
    try:
        template = _template(_checked_settings(card))
    except (UserError, KeyError, TypeError) as error:
        raise UserError(f"{file}: this is not a learner's card ({first_line(error)})") from None
    expected = _leaves(template)
    empty = {name: np.zeros(leaf.shape, leaf.dtype) for name, leaf in expected.items() if not leaf.size}
    arrays = empty | read_arrays(path, card, "learner")
    odd = next(
        (name for name in expected if name not in arrays or _kind(arrays[name]) != _kind(expected[name])), ""
    )
    odd = odd or next(iter(arrays.keys() - expected.keys()), "") or _not_finite(arrays)
    if odd:
        raise UserError(f"{Path(path)}: this learner is damaged ({odd} is not what the card says)")
    leaves = [jnp.asarray(arrays[name]) for name in expected]
    return jax.tree.unflatten(jax.tree.structure(template), leaves)


def _checked_learner(learner: Any) -> Learner:
    if not isinstance(learner, Learner):
        raise UserError(f"learner {shown(learner)}: give a learner, from make_learner")
    return learner


def _settings(learner: Learner, state: State) -> dict[str, Any]:
    """What of a learner and its state is no array."""
    sizes = {"obs_size": learner.obs_size, "action_size": learner.action_size}
    if isinstance(learner, COACH):
        return {"algo": "coach", **sizes, "counts": list(learner.grid.counts)}
    if isinstance(learner, DCoach):
        return {"algo": "d-coach", **sizes, **{name: getattr(learner, name) for name in _SIZES_OF_D_COACH}}
    if not isinstance(learner, GPC):
        raise UserError(
            f"there is no format for a {type(learner).__name__}: give a learner from make_learner"
        )
    try:
        capacities = {
            "policy": int(state.policy.points.shape[1]),
            "human": int(state.human.points.shape[1]),
        }
    except (AttributeError, IndexError):
        raise UserError(f"state {shown(state)}: give a state of this learner") from None
    return {
        "algo": "gpc-ns" if learner.policy.normalise else "gpc",
        **sizes,
        "policy_nu": learner.policy.kernel.smoothness,
        "static": learner.static_rate is not None,
        "sparsify": learner.sparsify,
        "on_full": learner.on_full,
        "policy_capacity": learner.policy_capacity,
        "human_capacity": learner.human_capacity,
        "capacities": capacities,
    }


def _checked_settings(card: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a card. Raises UserError or KeyError."""
    sizes = {name: checked(name, card[name], int, COUNT) for name in ("obs_size", "action_size")}
    algo = checked("algo", card["algo"], str, OneOf(("gpc", "gpc-ns", "coach", "d-coach")))
    if algo == "d-coach":
        whole = {name: checked(name, card[name], int, _SIZES_OF_D_COACH[name]) for name in _SIZES_OF_D_COACH}
        return {"algo": algo, **sizes, **whole}
    if algo == "coach":
        counts = card["counts"]
        if not isinstance(counts, list):
            raise UserError(f"counts {shown(counts)}: give a list")
        return {"algo": algo, **sizes, "counts": counts}
    capacities = card["capacities"]
    if not isinstance(capacities, dict):
        raise UserError(f"capacities {shown(capacities)}: give those of policy and human")
    return {
        "algo": algo,
        **sizes,
        "policy_nu": checked("policy_nu", card["policy_nu"], float, ALLOWED["policy_nu"]),
        "static": checked("static", card["static"], bool, SWITCH),
        "sparsify": checked("sparsify", card["sparsify"], bool, SWITCH),
        "on_full": checked("on_full", card["on_full"], str, OneOf(ON_FULL)),
        **{name: checked(name, card[name], int, CAPACITY) for name in ("policy_capacity", "human_capacity")},
        # It may have grown beyond what a new one begins with; the arrays must have this size.
        "capacities": {
            name: checked(f"capacity of {name}", capacities[name], int, COUNT) for name in ("policy", "human")
        },
    }


def _template(settings: Mapping[str, Any]) -> tuple[Learner, State]:
    """The shape of a learner and its state with these settings; nothing of its size is made."""
    values = dict(settings)
    capacities, static = values.pop("capacities", None), values.pop("static", False)
    if static:
        values["static_rate"] = 1.0
    if values["algo"] == "coach":
        size = values["obs_size"]
        values |= {"lower": -1.0, "upper": 1.0}
        if size > len(values["counts"]):
            raise UserError(f"{len(values['counts'])} counts for obs_size {size}")
    learner = make_learner(**values)

    def state() -> State:
        new = learner.init()
        return new if capacities is None else _sized(learner, capacities)

    return learner, jax.eval_shape(state)


def _sized(learner: Learner, capacities: Mapping[str, int]) -> State:
    """The idle state with other room than `init` makes; it may be more or less."""
    assert isinstance(learner, GPC)
    other = dataclasses.replace(
        learner, policy_capacity=capacities["policy"], human_capacity=capacities["human"]
    )
    return other.init()


def _leaves(tree: Any) -> dict[str, Any]:
    """Each leaf by its path, such as `state.policy.points`."""
    paths, _ = jax.tree.flatten_with_path(tree)
    first = ("learner", "state")
    return {first[path[0].idx] + jax.tree_util.keystr(path[1:]): leaf for path, leaf in paths}


def _kind(leaf: Any) -> tuple[tuple[int, ...], np.dtype]:
    return tuple(np.shape(leaf)), np.dtype(leaf.dtype)


def _not_finite(arrays: Mapping[str, np.ndarray]) -> str:
    """The first array with other than finite numbers, or nothing."""
    return next((name for name, value in arrays.items() if not np.isfinite(value).all()), "")
