"""What the card of a built-in learner says, its settings that are no arrays, and the shapes that follow from them.

`gpcjax.learners.packed` keeps the arrays beside it; other learners' cards are of `gpcjax.learners.recipes`.
"""

import functools
import json
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax.allowed import COUNT, SWITCH, OneOf, checked, shown
from gpcjax.errors import UserError
from gpcjax.gp.posterior import Posterior
from gpcjax.gp.process import GaussianProcess
from gpcjax.gp.renormalised import Renormalised
from gpcjax.learners.base import Learner, State
from gpcjax.learners.coach import COACH
from gpcjax.learners.dcoach import DCoach
from gpcjax.learners.descriptions import CAPACITY, D_COACH, ON_FULL
from gpcjax.learners.factory import ALLOWED, make_learner
from gpcjax.learners.gpc import GPC, GPCState

_SIZES_OF_D_COACH = {each.name: each.allowed for each in D_COACH.settings if each.compiled == "value"}
"""The settings of D-COACH that the shapes of its state, and how it learns, follow from; the others are arrays."""

_SCALES = ("scaling", "human_scaling")
"""What GPC and GPC-NS multiply inputs by: on a card, whether there are arrays of it beyond those that all have."""


def settings_of(learner: Learner, state: State) -> dict[str, Any]:
    """What of a learner and its state is no array. Raises UserError."""
    sizes = {"obs_size": learner.obs_size, "action_size": learner.action_size}
    if isinstance(learner, COACH):
        return {"algo": "coach", **sizes, "counts": list(learner.grid.counts)}
    if isinstance(learner, DCoach):
        return {"algo": "d-coach", **sizes, **{name: getattr(learner, name) for name in _SIZES_OF_D_COACH}}
    assert isinstance(learner, GPC)
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
        "static": not np.isnan(learner.static_rate).all(),
        "sparsify": learner.sparsify,
        "on_full": learner.on_full,
        "policy_capacity": learner.policy_capacity,
        "human_capacity": learner.human_capacity,
        **{name: True for name in _SCALES if _is_given(learner, name)},
        "capacities": capacities,
    }


def _is_given(learner: GPC, name: str) -> bool:
    """Whether a learner has arrays of its own for a scaling, which most have not."""
    model = learner.policy if name == "scaling" else learner.human
    if isinstance(model, Renormalised):
        return model.scaling is not None
    return name == "human_scaling" and learner.human_scaling is not None


def checked_settings(card: Mapping[str, Any]) -> dict[str, Any]:
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
        **{name: True for name in _SCALES if checked(name, card.get(name, False), bool, SWITCH)},
        # It may have grown beyond what a new one begins with; the arrays must have this size.
        "capacities": {
            name: checked(f"capacity of {name}", capacities[name], int, COUNT) for name in ("policy", "human")
        },
    }


def template_with(settings: Mapping[str, Any]) -> tuple[Learner, State]:
    """The shape of a learner and its state with these settings; nothing of its size is made."""
    learner, state = _idle(json.dumps({name: settings[name] for name in settings if name != "capacities"}))
    capacities = settings.get("capacities")
    return learner, state if capacities is None else shapes_of_state(learner, capacities)


@functools.lru_cache(maxsize=256)
def _idle(text: str) -> tuple[Learner, State]:
    """The learner with these settings (JSON), and the shape of its first state. Raises UserError or TypeError."""
    values = json.loads(text)
    static = values.pop("static", False)
    if static:
        values["static_rate"] = 1.0
    values |= {name: 1.0 for name in _SCALES if values.pop(name, False)}
    if values["algo"] == "coach":
        size = values["obs_size"]
        values |= {"lower": -1.0, "upper": 1.0}
        if size > len(values["counts"]):
            raise UserError(f"{len(values['counts'])} counts for obs_size {size}")
    learner = make_learner(**values)
    return learner, jax.eval_shape(learner.init)


def shapes_of_state(learner: Learner, capacities: Mapping[str, int]) -> GPCState:
    """The shape of a state with other room than `init` makes; it may be more or less."""
    assert isinstance(learner, GPC)

    def models(process: GaussianProcess, capacity: int, size: int) -> Posterior:
        one = _shapes_of_model(jax.tree.structure(process), capacity, size)
        form = lambda leaf: jax.ShapeDtypeStruct((learner.action_size, *leaf.shape), leaf.dtype)  # noqa: E731
        return jax.tree.map(form, one)

    return GPCState(
        policy=models(learner.policy, capacities["policy"], learner.obs_size),
        human=models(learner.human, capacities["human"], learner.obs_size + 1),
    )


@functools.lru_cache(maxsize=4096)
def _shapes_of_model(process: Any, capacity: int, size: int) -> Posterior:
    """The shape of the empty dictionary of a process of this structure.

    What is kept has any number of points: each costs milliseconds once, and not for every pair of both models.
    """
    numbers = process.unflatten([jnp.zeros(())] * process.num_leaves)
    return jax.eval_shape(lambda: numbers.init(capacity, jnp.ones(size)))
