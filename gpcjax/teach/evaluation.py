"""The policy of a lesson let run alone."""

import numpy as np
from jaxtyping import Float

from gpcjax.engine.session import no_number
from gpcjax.envs.registry import make_env
from gpcjax.policies.base import Policy
from gpcjax.teach.course import Course
from gpcjax.teach.world import World


class Evaluation:
    """The policy as it is now, on a simulation of its own: nothing is learned, and nothing recorded.

    Each of its methods raises UserError where the task or the policy gives something else than numbers, or fails.
    """

    def __init__(self, policy: Policy, course: Course, episode: int):
        self._policy, self._world = policy, world_of(course, pictures=True)
        self.index, self.total, self.length = episode, 0.0, 0
        self._sees(self._world.begin(episode))

    def step(self) -> bool:
        """One step; True if the episode has ended."""
        moved = self._world.step(self.action)
        self.total, self.length = self.total + moved.reward, self.length + 1
        self._sees(moved.obs)
        return moved.over

    def again(self) -> None:
        """The next episode."""
        self.index, self.total, self.length = self.index + 1, 0.0, 0
        self._sees(self._world.begin(self.index))

    def picture(self) -> np.ndarray | None:
        """As `Taught.picture`."""
        return self._world.picture()

    def _sees(self, obs: Float[np.ndarray, " obs"]) -> None:
        action = np.asarray(self._policy(obs))
        if not np.isfinite(action).all():
            raise no_number(obs)
        self.obs, self.action = obs, action


def world_of(course: Course, pictures: bool) -> World:
    """The task of a course, at its starts."""
    return World(make_env(course.env), course.seed, pictures)
