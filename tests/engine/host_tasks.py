"""`Drift` as a task of gymnasium, simulated on the host."""

from types import MappingProxyType
from typing import Any

import gymnasium
import numpy as np

from gpcjax.envs.host import HostEnv
from tests.engine.tasks import FAR, failing


class GymDrift(gymnasium.Env):
    """The coordinates of `Drift`, shaken by the numbers of the episode's seed at every step.

    With `force` 0 the actions move nothing. With `fails_at` they fail as those of `Drift`.
    """

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)

    def __init__(self, force: float = 0.2, fails_at: int = 1000) -> None:
        self.force, self.fails_at, self.time, self.at = force, fails_at, 0, np.zeros(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.time, self.at = 0, self.np_random.uniform(-1.0, 1.0, 2)
        return (np.full(2, np.nan) if self.fails_at < 1000 and self.at[0] > FAR else self.at), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        (x, y), self.time = self.at, self.time + 1
        shaken = self.force * action + 0.02 * self.np_random.normal(size=2)
        self.at = np.array([1.06 * x - 0.05 * y, 1.04 * y + 0.05 * x]) + shaken
        obs, reward = self.at, -(self.at @ self.at + 0.1 * action[0])
        if self.time == self.fails_at:
            failed, failed_reward = failing(*self.at, np.where)
            obs, reward = obs + failed, reward + float(failed_reward)
        return obs, reward, bool((np.abs(self.at) > 2.0).any()), False, {}


gymnasium.register("GymDrift-v0", entry_point=GymDrift)


def host_drift(max_steps: int = 30, **options: Any) -> HostEnv:
    return HostEnv("drift", "GymDrift-v0", max_steps, MappingProxyType(options))
