"""What a learner is: a frozen module of hyperparameters whose pure methods move a state.

Over 300 lines: half of them say what each method is given and gives, to whoever writes a learner or calls one.
"""

import abc
import dataclasses
import threading
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, PyTree

from gpcjax._x64 import seeded_key
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.gp.threads import one_thread
from gpcjax.learners import compiled
from gpcjax.learners.calls import check_kept
from gpcjax.learners.forms import check_learned
from gpcjax.learners.info import Info as Info
from gpcjax.learners.info import Status as Status
from gpcjax.moment import Moment
from gpcjax.policies.base import (
    ByIdentity,
    Controller,
    Policy,
    Vector,
    beyond,
    check_executed,
    vector,
)

State = PyTree
Change = PyTree
"""What a correction changes in a state, with as little as possible of what it leaves as it is."""


_ADVICE = frozenset((-1.0, 0.0, 1.0))
_TAKER = "this learner"
_LOOPED = frozenset(("act", "correct"))


class Learner(ByIdentity):
    """Learns a policy from advice.

    Methods are pure, compile themselves when they are called directly, and may be used inside jit, vmap and scan.
    Numbers are leaves, so that a grid over hyperparameters is a vmap; sizes and names are static.

    A learner of one's own writes `init`, `learn`, and `propose` (or `controller`, where something can be computed once
    for many steps); all else has a default. Its fields that are numbers become settings of a sweep by themselves. What
    is no number to trace, whole numbers, truth values, texts, functions, is compiled in (`gpcjax.fixed`). A state is a
    pytree of arrays whose shapes stay what `init` makes them.
    """

    obs_size: int = eqx.field(static=True, kw_only=True)
    """Numbers of an observation."""
    action_size: int = eqx.field(static=True, kw_only=True)
    """Dimensions of an action, each in [-1, 1]."""

    joint: ClassVar[bool] = True
    """One call of `learn` takes all action dimensions. Otherwise `_correct` takes them one after the other, and every
    leaf of a state has them as its first axis."""

    @abc.abstractmethod
    def init(self, key: PRNGKeyArray | None = None) -> State:
        """The state before the first correction. `key` is for what is drawn; without one, that is drawn from seed 0."""

    def propose(self, state: State, obs: Float[Array, " obs"]) -> Float[Array, " action"]:
        """The action at `obs`, before it is clipped: what `controller` does if it is not written."""
        raise NotImplementedError(
            f"{type(self).__name__} has neither propose nor controller: write one of them"
        )

    def learn(
        self, state: State, moment: Moment, advice: Float[Array, " action"], key: PRNGKeyArray
    ) -> tuple[State, Info]:
        """What `state` becomes with one correction, and what was done (`Info.of`).

        `advice` has -1, 0 or 1 for each action dimension, one of them other than 0; parts of these where credit for
        late advice goes to several steps. What is not finite needs not to be kept out: a state with such a thing where
        there was a number is dropped, and the correction has `Status.NON_FINITE`.
        """
        raise NotImplementedError(f"{type(self).__name__} has no learn: write it")

    idle_every: ClassVar[int] = 0
    """Steps of an episode between two calls of `idle`, which comes after a correction; 0 is never. Static."""

    def idle(self, state: State, key: PRNGKeyArray) -> State:
        """What `state` becomes without advice, for learners that go on learning from what they have kept."""
        return state

    def measure(self, state: State) -> dict[str, Float[Array, ""]]:
        """Numbers by name that become columns of an episode's row, as they are at its end."""
        return {}

    def act(self, state: State, obs: Vector) -> Float[Array, " action"]:
        """The action at `obs` (obs_size,), in [-1, 1] (action_size,).

        Raises:
            ValueError: `obs` has another shape, or holds no real numbers.
        """
        return compiled.act(self, state, vector("obs", obs, self.obs_size, _TAKER))

    def policy_of(self, state: State) -> Policy:
        """What `state` does, as a function obs (obs_size,) -> action (action_size,) in [-1, 1].

        It stays as it is, whatever is learned afterwards. For `gpcjax.evaluate`, or a loop without learning.
        """
        compiled.check_state(self, state)
        compiled.check_fields(self)
        known = {id(leaf) for leaf in jax.tree.leaves(state)}
        # Copied where they are the state's own, which may be given away (`donate`), or written into if it is numpy's.
        own = lambda leaf: jnp.array(leaf) if id(leaf) in known and not isinstance(leaf, Tracer) else leaf  # noqa: E731
        return Policy(jax.tree.map(own, self.controller(state)))

    def uncertainty(self, state: State, obs: Vector, action: Vector) -> Float[Array, " action"]:
        """sigma_h at (obs, action): how little advice was given there (3.6). (action_size,); NaN for COACH.

        Raises:
            ValueError: `obs` is not (obs_size,), `action` not (action_size,), or they hold no real numbers.
        """
        obs = vector("obs", obs, self.obs_size, _TAKER)
        return compiled.uncertainty(self, state, obs, vector("action", action, self.action_size, _TAKER))

    def correct(
        self, state: State, obs: Vector, action: Vector, advice: Vector, *, donate: bool = False
    ) -> tuple[State, Info]:
        """Learns from one correction.

        Args:
            state: from `init` or an earlier correction.
            obs: (obs_size,), where the correction was given.
            action: (action_size,), the action that was executed there, clipped to [-1, 1] as `act` gives it.
            advice: (action_size,), h: -1 for less, 1 for more, 0 for no advice, which leaves that dimension untouched.
            donate: `state` is not used any more, and its arrays may be overwritten: nothing of it is copied, and it is
                refused if it is given again; by jax itself, in its own words, as an argument of somebody's own jit or
                vmap, or of a method of somebody's own.

        Returns:
            The new state, of the same shapes, and what was done. A status other than `Status.OK` means that the
            correction was not learned in at least one dimension: `Info.rate` is 0 there.

        Raises:
            ValueError: a shape does not fit, there are no real numbers, advice is none of -1, 0, 1, or the action is
                beyond [-1, 1]. Where jax traces one of these two its value is not known: then nothing is learned, and
                the status is `Status.INVALID`. What is not finite is `Status.NON_FINITE`, also in an action.
        """
        advice = vector("advice", advice, self.action_size, _TAKER)
        obs = vector("obs", obs, self.obs_size, _TAKER)
        action = vector("action", action, self.action_size, _TAKER)
        if not isinstance(advice, Tracer) and not _ADVICE.issuperset(np.asarray(advice).tolist()):
            raise UserError(f"advice {np.asarray(advice).tolist()}: each entry must be -1, 0 or 1")
        check_executed(action)
        if isinstance(advice, Tracer) or isinstance(action, Tracer):
            valid = ((advice == -1) | (advice == 0) | (advice == 1)).all() & ~beyond(action).any()
            state, info = compiled.correct(self, state, obs, action, jnp.where(valid, advice, 0.0))
            status = jnp.where(valid, info.status, Status.INVALID).astype(info.status.dtype)
            return state, dataclasses.replace(info, status=status)
        if not self.factorises:
            return compiled.correct(self, state, obs, action, advice, donate=donate)
        with one_thread():
            return jax.block_until_ready(compiled.correct(self, state, obs, action, advice, donate=donate))

    def warm_up(self, state: State, *, donate: bool = False) -> threading.Thread:
        """Compiles what `act`, `correct`, `has_room` and `grow` need, which otherwise happens when they come first.

        For the room that `state` has, until this returns; then, in the thread that it returns, for twice of it, so that
        a correction after `grow` need not wait. Nothing is learned, and `state` stays as it is.

        Args:
            state: from `init` or a correction.
            donate: as `correct` will be called.

        Returns:
            The thread, which has begun: `join` it to wait until all is compiled; what a learner's own method raises
            there is raised by that. A program that ends waits for it.
        """
        # The thread has a state of its own: this one may be given away before it comes to that.
        own = self._run_once(state, donate)
        thread = _Ahead(target=self._warm_up_larger, args=(own, donate), name="gpcjax warm-up")
        thread.start()
        return thread

    def grow(self, state: State) -> State:
        """The same state with twice the room, for hosts that see `Info.full`."""
        return state

    def has_room(self, state: State, corrections: int = 1) -> Bool[Array, ""]:
        """Whether so many more corrections of an action dimension surely fit, whatever they are."""
        return jnp.ones((), bool)

    def resize(self, state: State, policy_capacity: int, human_capacity: int) -> State:
        """The same state with room for these many points in each policy and each human model."""
        return state

    @property
    def wants_room(self) -> bool:
        """Whether a host should give it more room (`grow`) rather than let it meet a full dictionary."""
        return True

    @property
    def goes_on_when_full(self) -> bool:
        """Whether a run goes on after a correction that was refused for want of room (`Status.FULL`)."""
        return False

    @property
    def factorises(self) -> bool:
        """Whether a correction factorises matrices anew: it is then computed with one thread (`gpcjax.gp.threads`)."""
        return False

    def largest_sigma(self) -> Float[Array, ""]:
        """An upper bound of `uncertainty`, for teachers that wait for it; 0 for learners that know none."""
        return jnp.zeros(())

    def controller(self, state: State) -> Controller:
        """The policy of `state`, ready for many steps."""
        check_kept(state)
        return Proposing(learner=fixed(self), state=state)

    def points(self, state: State) -> tuple[Int[Array, ""], Int[Array, ""]]:
        """Points held by the policies and by the human models, over all action dimensions; 0, 0 without any."""
        return jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32)

    def _like(self, state: State) -> State:
        """A state with as much room as this one has: of the same shapes, if it is one of this learner."""
        return self.init(seeded_key())

    def _uncertainty(
        self,
        states: State,
        place: tuple[Int[Array, ""], ...],
        obs: Float[Array, " obs"],
        action: Float[Array, " action"],
    ) -> Float[Array, " action"]:
        """`uncertainty` of the state at `place`: the index of its lane, or none if `states` is one state.

        States are large: it is read where it is.
        """
        return jnp.full(self.action_size, jnp.nan)

    def _learn(
        self, state: State, moment: Moment, advice: Float[Array, " action"], key: PRNGKeyArray
    ) -> tuple[State, Info]:
        """`learn`, if there is advice, and nothing in the state becomes what is no number."""
        learned = self.learn(state, moment, advice, key)
        check_learned(f"{type(self).__name__}.learn", learned, state, moment.action)
        new, info = learned
        given = (advice != 0).any()
        told = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves((info.rate, moment.obs, moment.action))]
        finite = jnp.stack([*_stays_finite(new, state), *told]).all()
        kept = jax.tree.map(lambda now, old: jnp.where(given & finite, now, old), new, state)
        status = jnp.where(given & ~finite, jnp.int32(Status.NON_FINITE), info.status).astype(jnp.int32)
        learned = (advice != 0) & finite & (status == Status.OK)
        return kept, dataclasses.replace(info, rate=jnp.where(learned, info.rate, 0.0), status=status)

    def _idle(self, state: State, key: PRNGKeyArray) -> tuple[State, Int[Array, ""]]:
        """`idle`, if nothing becomes of it that is no number, and the status of that."""
        new = self.idle(state, key)
        sound = _stays_finite(new, state)
        finite = jnp.stack(sound).all() if sound else jnp.array(True)
        kept = jax.tree.map(lambda now, old: jnp.where(finite, now, old), new, state)
        return kept, jnp.where(finite, Status.OK, Status.NON_FINITE).astype(jnp.int32)

    def _correct(
        self,
        states: State,
        place: tuple[Int[Array, ""], ...],
        obs: Float[Array, " obs"],
        action: Float[Array, ""],
        advice: Float[Array, ""],
    ) -> tuple[Change, Info]:
        """What a correction of one action dimension changes, for `_write`.

        `place` is its place in `states`: the index of the dimension, after that of the lane if there are several. The
        dimensions learn for themselves: what is untouched by advice costs nothing.
        """
        raise NotImplementedError

    def _write(self, states: State, place: tuple[Int[Array, ""], ...], change: Change) -> State:
        """The states with a change; `place` is its place, the indices of their first axes."""
        raise NotImplementedError

    def _run_once(self, state: State, donate: bool) -> State:
        """All that a loop calls, without advice; the same state in new arrays."""
        obs, none = np.zeros(self.obs_size), np.zeros(self.action_size)
        self.act(state, obs)
        self.has_room(state)
        # One that is given away is a copy: `state` is somebody's.
        spare = jax.tree.map(jnp.copy, state) if donate else state
        same, _ = jax.block_until_ready(self.correct(spare, obs, none, none, donate=donate))
        return same

    def _warm_up_larger(self, state: State, donate: bool) -> None:
        larger = self.grow(state) if self.wants_room else state
        if jax.tree.map(jnp.shape, larger) != jax.tree.map(jnp.shape, state):
            self._run_once(larger, donate)

    def __getattribute__(self, name: str) -> Any:
        # equinox makes a module of each method that is looked up, which takes longer than to act: a loop's two are not.
        return object.__getattribute__(self, name) if name in _LOOPED else super().__getattribute__(name)


class _Ahead(threading.Thread):
    """A thread that raises what failed in it where somebody waits for it, not where nobody can catch it."""

    _failed: Exception | None = None

    def run(self) -> None:
        try:
            super().run()
        except Exception as error:
            self._failed = error

    def join(self, timeout: float | None = None) -> None:
        super().join(timeout)
        if self._failed is not None:
            raise self._failed


def _stays_finite(new: State, old: State) -> list[Bool[Array, ""]]:
    """Whether each array of a state is finite wherever it was before: it may begin with infinity, such as a least."""
    return [
        (jnp.isfinite(now) | ~jnp.isfinite(before)).all()
        for now, before in zip(jax.tree.leaves(new), jax.tree.leaves(old), strict=True)
        if jnp.issubdtype(jnp.result_type(now), jnp.inexact)
    ]


class Proposing(Controller):
    """The policy of a learner that has nothing to compute beforehand: what it proposes, lane by lane."""

    learner: Learner
    state: State

    @property
    def obs_size(self) -> int:
        return self.learner.obs_size

    @property
    def action_size(self) -> int:
        return self.learner.action_size

    def __call__(self, obs: Float[Array, "obs *lanes"]) -> Float[Array, "action *lanes"]:
        propose = lambda learner, state, obs: learner.propose(state, obs)  # noqa: E731
        for _ in range(obs.ndim - 1):
            propose = jax.vmap(propose, in_axes=-1, out_axes=-1)
        return propose(self.learner, self.state, obs)
