"""The lanes of one room in a classroom: what is learned, and the programs that move it.

Where the steps stand is on the host, with each pupil; here is what a correction changes. A correction gives the state
away and gets the new one, which is the old one with a few rows written: nothing large is copied. The controller is
never given away, so that steps can be proposed while a correction is under way.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from gpcjax.engine.bench_programs import Known, Programs, Standing
from gpcjax.engine.history import Credit
from gpcjax.engine.pool import Tier
from gpcjax.learners.base import Info, Learner, State


class Learned(NamedTuple):
    """What one correction came to."""

    info: Info
    corrections: int
    """Action dimensions that were learned."""
    before: Float[np.ndarray, " action"]
    """What the policy did where the correction is shown to be about, clipped."""
    after: Float[np.ndarray, " action"]
    known: Known


class Bench:
    """Places for `tier.lanes` learners of one structure, each with the tier's room.

    Its methods belong to one thread at a time, but for `propose` and `acts`.
    """

    def __init__(self, tier: Tier, learner: Learner, credit: Credit | None, programs: Programs):
        self.tier = tier
        self._programs = programs
        self.free = set(range(tier.lanes))
        self._state, self._controller = programs.empty()
        self._learner = [np.stack([np.asarray(leaf)] * tier.lanes) for leaf in jax.tree.leaves(learner)]
        self._credit = [
            np.stack([np.asarray(leaf)] * tier.lanes, axis=-1) for leaf in jax.tree.leaves(credit)
        ]
        self._numbers = jax.device_put((self._learner, self._credit))

    def enter(self, learner: Learner, credit: Credit | None, state: State) -> tuple[int, Known]:
        """Puts a learner with this state, of this room or that before, into a free place: gives that."""
        lane = min(self.free)
        for mine, leaf in zip(self._learner, jax.tree.leaves(learner), strict=True):
            mine[lane] = leaf
        for mine, leaf in zip(self._credit, jax.tree.leaves(credit), strict=True):
            mine[..., lane] = leaf
        self._numbers = jax.device_put(([*map(np.copy, self._learner)], [*map(np.copy, self._credit)]))
        leaves, own = jax.tree.leaves(state), [np.asarray(leaf) for leaf in jax.tree.leaves(learner)]
        self._state, self._controller, numbers = self._programs.enter(
            self._state, self._controller, leaves, own, np.int32(lane)
        )
        self.free.remove(lane)
        return lane, self._programs.known(np.asarray(numbers))

    def leave(self, lane: int) -> None:
        """The place is free."""
        self.free.add(lane)

    def state(self, lane: int) -> State:
        """A copy of the state there, without a lanes axis."""
        return self._programs.state_form.unflatten(self._programs.take(self._state, np.int32(lane)))

    def propose(
        self, obs: Float[np.ndarray, "obs lanes"]
    ) -> tuple[Float[np.ndarray, "action lanes"], np.ndarray]:
        """The actions at these observations before they are clipped, and whether each is a number."""
        proposed = np.asarray(self._programs.propose(self._controller, obs))
        return proposed[:-1], proposed[-1] > 0

    def correct(self, at: Standing) -> Learned:
        """Corrects the learner at a place."""
        self._state, self._controller, info, packed = self._programs.correct(
            self._state, self._controller, *self._numbers, at
        )
        numbers, size = np.asarray(packed), info.rate.shape[0]
        before, after = numbers[1 : size + 1], numbers[size + 1 : 2 * size + 1]
        return Learned(info, int(numbers[0]), before, after, self._programs.known(numbers[2 * size + 1 :]))

    def idle(
        self, seeds: np.ndarray, episodes: np.ndarray, times: np.ndarray, waiting: np.ndarray
    ) -> Int[np.ndarray, " lanes"]:
        """Lets the learners at the places `waiting`, which are due, go on by themselves; gives what that came to."""
        self._state, self._controller, status = self._programs.idle(
            self._state, self._controller, *self._numbers, seeds, episodes, times, waiting
        )
        return np.asarray(status)

    def known(self, lane: int) -> Known:
        """What is known of the state at a place."""
        own = [leaf[lane] for leaf in self._learner]
        return self._programs.known(np.asarray(self._programs.look(self._state, own, np.int32(lane))))

    def uncertain(
        self, lane: int, obs: Float[np.ndarray, " obs"], action: Float[np.ndarray, " action"]
    ) -> Float[np.ndarray, " action"]:
        """sigma_h of the learner at a place."""
        own = [leaf[lane] for leaf in self._learner]
        return np.asarray(self._programs.uncertain(self._state, own, np.int32(lane), obs, action))

    def acts_at(self, lane: int, obs: Float[np.ndarray, "obs points"]) -> Float[np.ndarray, "action points"]:
        """What the policy at a place does at many observations, clipped."""
        return np.asarray(self._programs.acts_at(self._controller, np.int32(lane), obs))
