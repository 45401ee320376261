"""The peer as one would first write it: two GaussianProcessRegressors, used through their public API.

The policy predicts with its standard deviation at every step; every correction fits both models from nothing.
The human model is asked at corrections only, unless `human_every_step` (the public code of GPC asks both).
"""

from __future__ import annotations

import math
from typing import Any, Unpack

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Kernel, Matern, WhiteKernel

from benchmarks.peers.tasks import GP_VALUES, OBS_SIZE, TASKS, Floats, PeerResult, Teaching, teach


class Model:
    """A regressor, its dictionary, and the widths its inputs are divided by."""

    def __init__(self, signal: Kernel, noise: float, widths: np.ndarray, normalise: bool):
        self.signal, self.widths, self.normalise = signal, widths, normalise
        kernel: Any = signal + WhiteKernel(noise)
        no_search: Any = None  # the hyperparameters stay as they are
        self.regressor = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=no_search)
        self.inputs: list[np.ndarray] = []
        self.targets: list[float] = []

    def predict(self, x: np.ndarray) -> tuple[float, float]:
        """Mean and standard deviation."""
        prediction: Any = self.regressor.predict((x / self.widths)[None], return_std=True)
        return prediction[0].item(), prediction[1].item()

    def nearest(self, x: np.ndarray) -> int:
        """The point of largest covariance with x."""
        covariance: Any = self.signal(np.array(self.inputs) / self.widths, (x / self.widths)[None])
        return int(np.argmax(covariance))

    def learn(self, x: np.ndarray, target: float, index: int | None = None) -> None:
        """Writes over point `index`, or appends; then fits."""
        if index is None:
            self.inputs.append(x)
            self.targets.append(target)
        else:
            self.inputs[index], self.targets[index] = x, target
        inputs = np.array(self.inputs)
        if self.normalise:
            deviation = inputs.std(axis=0)
            self.widths = np.where(deviation < 1e-6, 1.0, deviation)
        self.regressor.fit(inputs / self.widths, self.targets)


class SklearnGPC:
    """GPC ("gpc") and GPC-NS ("gpc-ns") of one action, Alg. 2 and 3."""

    def __init__(self, algo: str, env: str, human_every_step: bool = False):
        self.human_every_step = human_every_step
        v = GP_VALUES[algo, env]
        normalise = algo == "gpc-ns"
        widths = np.ones(OBS_SIZE[env]) if normalise else 1 / np.array(v.weights)
        policy = ConstantKernel(v.policy_variance) * Matern(v.policy_length_scale, nu=v.nu)
        human = ConstantKernel(v.human_variance) * RBF(v.human_length_scale)
        self.policy = Model(policy, v.noise, widths, normalise)
        self.human = Model(human, v.noise, np.append(widths, 1.0), normalise)
        self.constant_rate, self.threshold = v.constant_rate, 0.5 * math.sqrt(v.policy_variance)
        self.largest_sigma = math.sqrt(v.human_variance + v.noise)
        self.sigma_policy = 0.0

    @property
    def policy_points(self) -> int:
        """Size of P."""
        return len(self.policy.inputs)

    @property
    def human_points(self) -> int:
        """Size of H."""
        return len(self.human.inputs)

    def act(self, obs: Floats) -> float:
        """The clipped mean; keeps sigma_p for a correction of this step."""
        mean, self.sigma_policy = self.policy.predict(np.array(obs))
        action = min(1.0, max(-1.0, mean))
        if self.human_every_step:
            self.human.predict(np.array((*obs, action)))
        return action

    def sigma_human(self, obs: Floats, action: float) -> float:
        """Predicted anew, whether or not `act` has asked: the regressor keeps nothing."""
        return self.human.predict(np.array((*obs, action)))[1]

    def correct(self, obs: Floats, action: float, h: int) -> tuple[float, float, float, bool]:
        """Alg. 2, lines 6 to 14, for the step just acted on; (rate, sigma_p, sigma_h, replaced)."""
        s, z = np.array(obs), np.array((*obs, action))
        sigma_p, sigma_h = self.sigma_policy, self.human.predict(z)[1]
        rate = sigma_p + sigma_h + self.constant_rate
        replace = sigma_p < self.threshold
        self.policy.learn(s, action + rate * h, self.policy.nearest(s) if replace else None)
        self.human.learn(z, h)
        return rate, sigma_p, sigma_h, replace


def run(algo: str, env: str, *, human_every_step: bool = False, **teaching: Unpack[Teaching]) -> PeerResult:
    """Teaches `algo` ("gpc", "gpc-ns") on `env` ("cartpole", "pendulum"); see tasks.teach."""
    return teach(SklearnGPC(algo, env, human_every_step), TASKS[env](), **teaching)
