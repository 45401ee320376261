"""What a learner's methods compute, compiled when they are called from Python; and what refuses another one's state."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PyTree

from gpcjax._x64 import seeded_key
from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.learners.calls import NUMBERS, Called, check_arrays, check_kept
from gpcjax.learners.forms import check, does_not_fit, worded
from gpcjax.learners.info import Info
from gpcjax.moment import Moment
from gpcjax.policies.vectors import near

Learner = Any
"""A `gpcjax.learners.base.Learner`, whose methods call these."""
State = PyTree


@Called
def act(learner: Learner, state: State, obs: Float[Array, " obs"]) -> Float[Array, " action"]:
    """The action at `obs`, in [-1, 1]."""
    _check_precision(learner, state)
    action = learner.controller(state)(near(obs))
    check(f"{type(learner).__name__}.propose", "an action", action, _an_action(learner))
    return jnp.clip(action, -1.0, 1.0)


@Called
def uncertainty(
    learner: Learner, state: State, obs: Float[Array, " obs"], action: Float[Array, " action"]
) -> Float[Array, " action"]:
    """sigma_h at (obs, action)."""
    _check_precision(learner, state)
    return learner._uncertainty(state, (), near(obs), action)


@Called
def correct(
    learner: Learner,
    state: State,
    obs: Float[Array, " obs"],
    action: Float[Array, " action"],
    advice: Float[Array, " action"],
) -> tuple[State, Info]:
    """What `state` becomes with one correction of arguments that were checked, and what was done."""
    # One dimension after the other, as in the engine: each is a correction of its own.
    _check_precision(learner, state)
    obs = jnp.where(jnp.isfinite(obs), near(obs), obs)  # nothing is learned of what is infinite
    if learner.joint:
        here = Moment(obs=obs, action=action, episode=jnp.int32(0), step=jnp.int32(0))
        return learner._learn(state, here, advice, seeded_key())

    def one(state: State, given: tuple[Array, Array, Array]) -> tuple[State, Info]:
        dimension, action, advice = given
        change, info = learner._correct(state, (dimension,), obs, action, advice)
        return learner._write(state, (dimension,), change), info

    state, info = lax.scan(one, state, (jnp.arange(learner.action_size), action, advice))
    return state, dataclasses.replace(info, status=info.status.max())


def rehearse(learner: Learner, state: State) -> None:
    """Traces what a learner of a person's own does with a state, its first one if it is None; ours are known.

    Raises:
        UserError: it is no state of this learner.
        ForeignError: a method gives something of another shape or type than it should.
    """
    if type(learner).__module__.startswith("gpcjax."):
        return
    check_fields(learner)
    _first_form(learner)
    if state is None:
        state = learner.init(seeded_key())
    check_arrays(state)
    obs, none = jnp.zeros(learner.obs_size), jnp.zeros(learner.action_size)
    eqx.filter_eval_shape(act.function, learner, state, obs)
    eqx.filter_eval_shape(correct.function, learner, state, obs, none, none)


def check_state(learner: Learner, state: State) -> None:
    """Refuses what is no state of this kind of learner. Where a function is traced: a call pays nothing."""
    check_kept(state)
    check_arrays(state)
    expected = _first_form(learner)
    shapes = list(map(_shape, jax.tree.leaves(state)))
    if jax.tree.structure(state) == jax.tree.structure(expected) and None not in shapes:
        expected = jax.eval_shape(lambda: learner._like(state))
        if shapes == [leaf.shape for leaf in jax.tree.leaves(expected)]:
            return
    raise UserError(f"state {shown(state)}: give a state of this learner, from its init or its correct")


def _first_form(learner: Learner) -> State:
    """The shapes and types of what `init` gives. Raises ForeignError: there are other things in it than arrays."""
    init = lambda: learner.init(seeded_key())  # noqa: E731
    try:
        return jax.eval_shape(init)
    except TypeError:
        for path, leaf in jax.tree.leaves_with_path(eqx.filter_eval_shape(init)):
            if _shape(leaf) is None:
                what = f"its state{jax.tree_util.keystr(path)} is {worded(leaf)}, it should be an array"
                raise does_not_fit(f"{type(learner).__name__}.init", what) from None
        raise


def check_fields(learner: Learner) -> None:
    """Refuses a learner whose numbers cannot be traced: functions or texts are in one field with some of them."""
    for path, leaf in jax.tree.leaves_with_path(fixed(learner)):
        if not isinstance(leaf, NUMBERS | np.ndarray | jax.Array):
            name = f"{type(learner).__name__}{jax.tree_util.keystr(path)}"
            raise UserError(f"{name} {shown(leaf)}: there are numbers beside it, give it a field of its own")


def _shape(leaf: Any) -> tuple[int, ...] | None:
    """Of an array, or of a number of Python's, as `init` may give them."""
    return () if isinstance(leaf, bool | int | float | complex) else getattr(leaf, "shape", None)


def _an_action(learner: Learner) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((learner.action_size,), jnp.float64)


def _check_precision(learner: Learner, state: State) -> None:
    """Refuses a state whose numbers were cast, whoever did it, or of another kind."""
    check_state(learner, state)
    given, kept = (
        {leaf.dtype.name for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.inexact)}
        for tree in (eqx.filter(state, eqx.is_array), _first_form(learner))
    )
    if given - kept:
        raise UserError(
            f"the learner's state holds {', '.join(sorted(given))}, where init gives {', '.join(sorted(kept))}: "
            "cast it back, or teach from the start"
        )
