"""What one learner has learned, as the state of another one: other numbers, another size of its dictionary, a relative.

| from | to | what becomes of it |
|---|---|---|
| GPC, GPC-NS | GPC, GPC-NS | points and targets stay; all else is kept where it would be the same, or computed anew |
| COACH | COACH with the same grid | the weights of both models |
| D-COACH | D-COACH of the same sizes and scaling | the network and the buffer |
| one of a person's own | the same, if a state has the same shapes | the state |

Nothing else has a meaning: weights of features or of a network are no points, and points are no weights.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gpcjax._x64 import seeded_key, under_own_settings
from gpcjax.errors import UserError
from gpcjax.gp.posterior import Posterior
from gpcjax.gp.process import GaussianProcess
from gpcjax.learners.base import Learner, State
from gpcjax.learners.coach import COACH
from gpcjax.learners.dcoach import DCoach
from gpcjax.learners.gpc import GPC, GPCState

_BASIS = {COACH: ("grid",), DCoach: ("scaling",)}
"""Fields of a learner without which its weights mean something else."""


def points_of(learner: Learner, state: State) -> tuple[int, int]:
    """How many points the largest policy and the largest human model of a state hold; 0, 0 without a dictionary."""
    if not isinstance(learner, GPC):
        return 0, 0
    policy, human = (int(np.max(each.count)) for each in (state.policy, state.human))
    return policy, human


@under_own_settings
def carried(
    source: Learner, state: State, learner: Learner, room: tuple[int, int], told: str = "state"
) -> State:
    """The state of `learner` that knows what `source` had learned with `state`.

    Args:
        source, state: from `unpack_learner`, `load_learner`, or any corrections.
        learner: who is to go on. What follows from its hyperparameters is computed anew where they are others.
        room: for how many points of each policy and of each human model.
        told: begins the messages.

    Raises:
        UserError: sizes differ, what was learned means nothing to this learner, or there is too little room.
    """
    for name, what in (("obs_size", "numbers of an observation"), ("action_size", "action dimensions")):
        old, new = getattr(source, name), getattr(learner, name)
        if old != new:
            raise UserError(f"{told}: it was learned with {old} {what}, the task has {new}")
    if isinstance(source, GPC) and isinstance(learner, GPC):
        return _dictionaries(source, state, learner, room, told)
    names = _BASIS.get(type(learner), ())
    alike = type(source) is type(learner) and all(
        _same(getattr(source, name), getattr(learner, name)) for name in names
    )
    if not alike or _forms(state) != _forms(jax.eval_shape(lambda: learner.init(seeded_key()))):
        names = " and another ".join(("size", *names))
        what = f"of another {names}" if type(source) is type(learner) else "of another kind"
        raise UserError(
            f"{told}: it is of a {type(source).__name__} {what} than the learner that is to go on with it"
        )
    return state


def _dictionaries(source: GPC, state: GPCState, learner: GPC, room: tuple[int, int], told: str) -> GPCState:
    held = points_of(source, state)
    if any(points > most for points, most in zip(held, room, strict=True)):
        raise UserError(
            f"{told}: its dictionaries hold {held[0]} and {held[1]} points, here is room for {room}"
        )
    policy, human = room
    learner = jax.tree.map(jnp.asarray, learner)  # a sweep has them on the host
    empty = dataclasses.replace(learner, policy_capacity=policy, human_capacity=human).init()
    scales = _same((source.scaling, source.human_scaling), (learner.scaling, learner.human_scaling))
    new = GPCState(
        policy=_model(source.policy, state.policy, learner.policy, empty.policy, scales),
        human=_model(source.human, state.human, learner.human, empty.human, scales),
    )
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(new)):
        raise UserError(f"{told}: with these hyperparameters its points make no model, give others")
    return new


def _model(
    old: GaussianProcess, posteriors: Posterior, new: GaussianProcess, empty: Posterior, scales: bool
) -> Posterior:
    """The posteriors of one model after the other's, in the room of `empty`; `scales` says that w is the same."""
    if _same(old, new) and (scales or new.normalise):
        return jax.tree.map(_put_into, posteriors, empty)
    data = dataclasses.replace(
        empty,
        points=jnp.asarray(_put_into(posteriors.points, empty.points)),
        targets=jnp.asarray(_put_into(posteriors.targets, empty.targets)),
        count=jnp.asarray(posteriors.count),
    )
    return jax.tree.map(np.asarray, _renewed(new, data))


@eqx.filter_jit
def _renewed(process: GaussianProcess, data: Posterior) -> Posterior:
    # One after the other: the matrices of several action dimensions at once are many times as large.
    return jax.lax.map(process.renewed, data)


def _put_into(values: Any, room: Any) -> np.ndarray:
    """The array with more room, or with less where there is nothing there; on the host, as sizes are many."""
    values, filled = np.asarray(values), np.array(room)
    box = tuple(slice(min(sizes)) for sizes in zip(values.shape, filled.shape, strict=True))
    filled[box] = values[box]
    return filled


def _same(one: Any, other: Any) -> bool:
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


def _forms(state: State) -> list[tuple[Any, ...]]:
    return [
        (jax.tree_util.keystr(path), tuple(leaf.shape), np.dtype(leaf.dtype))
        for path, leaf in jax.tree_util.tree_leaves_with_path(state)
    ]
