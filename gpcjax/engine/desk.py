"""Where a session's learner sits: in a block of its own, or among others in a classroom.

A session says what happens, one thing after the other; a desk computes it. What a desk computes with comes from the
engine's own functions, whichever it is.
"""

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gpcjax.engine.correcting import idle_is_due
from gpcjax.engine.lanes import Lane
from gpcjax.engine.single import (
    acts,
    acts_at,
    advised,
    cleared,
    grown,
    has_room,
    idled,
    measured,
    place_of,
    placed,
    points_of,
    state_of,
    stepped,
    told,
    uncertain,
)
from gpcjax.learners.base import Info, Learner, State


class Advised(NamedTuple):
    """What one advice did."""

    info: Info
    corrections: int
    """Action dimensions in which it was learned."""
    before: Float[np.ndarray, " action"]
    """What the policy did where the advice is shown to be about, clipped."""
    after: Float[np.ndarray, " action"]


class Desk(abc.ABC):
    """One learner, the step that it stands at, and those before that late advice may be about.

    What moves it gives the desk that follows. It may be the same one: then what was before is gone.
    """

    @property
    @abc.abstractmethod
    def episode(self) -> int:
        """Of the present step, from 0."""

    @property
    @abc.abstractmethod
    def time(self) -> int:
        """The present step of the episode, from 0."""

    @property
    @abc.abstractmethod
    def obs(self) -> Float[np.ndarray, " obs"]:
        """Of the present step."""

    @property
    @abc.abstractmethod
    def action(self) -> Float[np.ndarray, " action"]:
        """What was executed there."""

    @property
    @abc.abstractmethod
    def idle_is_due(self) -> bool:
        """Whether the learner goes on by itself at the end of the present step."""

    @abc.abstractmethod
    def idled(self) -> "Desk":
        """The learner has gone on by itself."""

    @abc.abstractmethod
    def stepped(
        self, obs: Float[np.ndarray, " obs"], begins: bool, another: bool
    ) -> "tuple[Desk, Float[np.ndarray, ' action'], bool]":
        """At the next step, as `gpcjax.engine.single.stepped`."""

    @abc.abstractmethod
    def executed(self, action: Float[np.ndarray, " action"]) -> "Desk":
        """Something else was executed at the present step than was proposed."""

    @abc.abstractmethod
    def advised(
        self, advice: Float[np.ndarray, " action"], about: Float[np.ndarray, " obs"] | None = None
    ) -> "tuple[Desk, Advised]":
        """Corrected, with what that did; room is made first where it is due.

        What the policy does at `about` before and after is told, or NaN without one.
        """

    @abc.abstractmethod
    def taken_back(self, before: "Desk") -> "Desk":
        """With what was learned before, at the present step."""

    @abc.abstractmethod
    def acts(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        """What the policy does at an observation, clipped."""

    @abc.abstractmethod
    def acts_at(self, obs: Float[np.ndarray, "obs points"]) -> Float[np.ndarray, "action points"]:
        """The same at many."""

    @abc.abstractmethod
    def uncertain(self) -> Float[np.ndarray, " action"]:
        """sigma_h at the present step."""

    @property
    @abc.abstractmethod
    def state(self) -> State:
        """The learner's, without a lanes axis."""

    @property
    @abc.abstractmethod
    def points(self) -> tuple[int, int]:
        """Points of the policies and of the human models."""

    @abc.abstractmethod
    def measured(self) -> dict[str, float]:
        """What the learner measures of itself."""

    @abc.abstractmethod
    def place(self) -> dict[str, Any]:
        """Where it stands, as JSON knows it."""

    @abc.abstractmethod
    def placed(self, place: Mapping[str, Any]) -> "Desk":
        """At a place that `place` gave. Raises KeyError, TypeError or ValueError for another one."""

    @abc.abstractmethod
    def warm_up(self, ahead: bool) -> None:
        """Compiles what comes, as `gpcjax.engine.session.Session.warm_up`."""


@dataclasses.dataclass(frozen=True)
class Alone(Desk):
    """A desk in a block of one lane, `gpcjax.engine.single.single`; it never changes, each move gives another."""

    learner: Learner
    block: Lane

    @property
    def episode(self) -> int:
        return int(np.asarray(self.block.episode)[0])

    @property
    def time(self) -> int:
        return int(np.asarray(self.block.env.time)[0])

    @property
    def obs(self) -> Float[np.ndarray, " obs"]:
        return np.array(np.asarray(self.block.env.obs)[:, 0])

    @property
    def action(self) -> Float[np.ndarray, " action"]:
        return np.array(np.asarray(self.block.action)[:, 0])

    @property
    def idle_is_due(self) -> bool:
        return bool(self.learner.idle_every) and bool(idle_is_due(self.learner, self.block.env.time)[0])

    def idled(self) -> "Alone":
        return self._with(cleared(idled(self.block)))

    def stepped(
        self, obs: Float[np.ndarray, " obs"], begins: bool, another: bool
    ) -> "tuple[Alone, Float[np.ndarray, ' action'], bool]":
        block, proposed, finite = stepped(self.block, obs, begins, another)
        return self._with(block), proposed, finite

    def executed(self, action: Float[np.ndarray, " action"]) -> "Alone":
        return self._with(dataclasses.replace(self.block, action=jnp.asarray(action)[:, None]))

    def advised(
        self, advice: Float[np.ndarray, " action"], about: Float[np.ndarray, " obs"] | None = None
    ) -> "tuple[Alone, Advised]":
        block = jax.block_until_ready(advised(self._with_room(), advice[:, None]))
        after = self._with(cleared(block))
        shown = [
            np.full(len(advice), np.nan) if about is None else each.acts(about) for each in (self, after)
        ]
        return after, Advised(told(block), int(np.asarray(block.tally.corrections)[0]), *shown)

    def taken_back(self, before: Desk) -> "Alone":
        assert isinstance(before, Alone)
        state, controller = before.block.state, before.block.controller
        return self._with(dataclasses.replace(self.block, state=state, controller=controller))

    def acts(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        return np.array(acts(self.block.controller, obs))

    def acts_at(self, obs: Float[np.ndarray, "obs points"]) -> Float[np.ndarray, "action points"]:
        return np.array(acts_at(self.block.controller, obs))

    def uncertain(self) -> Float[np.ndarray, " action"]:
        return np.asarray(uncertain(self.block))  # nobody waits for it: a block is never changed

    @property
    def state(self) -> State:
        return state_of(self.block)

    @property
    def points(self) -> tuple[int, int]:
        policy, human = points_of(self.block)
        return int(policy), int(human)

    def measured(self) -> dict[str, float]:
        return {name: float(value) for name, value in measured(self.block).items()}

    def place(self) -> dict[str, Any]:
        return place_of(self.block)

    def placed(self, place: Mapping[str, Any]) -> "Alone":
        return self._with(placed(self.block, place))

    def warm_up(self, ahead: bool) -> None:
        learner, block = self.learner, self.block
        if ahead:
            larger = grown(block) if learner.wants_room else None
            if larger is None:
                return
            block = larger
        block, _, _ = stepped(block, np.zeros(learner.obs_size), True, False)
        if learner.idle_every:
            cleared(idled(block))
        has_room(block, self._corrections_at_once)
        block = advised(block, np.zeros((learner.action_size, 1)))
        told(block)
        for look in (uncertain, points_of, measured, state_of):
            look(block)
        acts(block.controller, np.zeros(learner.obs_size))

    @property
    def _corrections_at_once(self) -> int:
        return 1 if self.block.credit is None else self.block.credit.moments

    def _with_room(self) -> Lane:
        block = self.block
        while self.learner.wants_room and not has_room(block, self._corrections_at_once):
            larger = grown(block)
            if larger is None:
                break
            block = larger
        return block

    def _with(self, block: Lane) -> "Alone":
        return Alone(self.learner, block)
