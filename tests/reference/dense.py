"""GPC, GPC-NS and COACH in plain numpy float64, the dense and obvious way.

Dictionaries are arrays of their true size, a model refactorises its whole kernel matrix whenever it changes,
and distances are taken from differences. Symbols and line numbers are those of the thesis. Where its formulas
have slips: inputs are multiplied by the weights w, GPC-NS divides by standard deviations (not variances), SE
and Matern have their standard forms, and c_p and c_h are variances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

Array = np.ndarray


def kernel(x: Array, y: Array, variance: float, length_scale: float, nu: float) -> Array:
    """Covariances (n, m) of the rows of x (n, d) and y (m, d): Matern (3.4), or SE (3.3) if nu is inf."""
    r = np.sqrt(((x[:, None, :] - y[None, :, :]) ** 2).sum(axis=-1)) / length_scale
    if nu == math.inf:
        return variance * np.exp(-0.5 * r**2)
    t = math.sqrt(2 * nu) * r
    polynomial = {0.5: 1.0, 1.5: 1 + t, 2.5: 1 + t + t**2 / 3}[nu]
    return variance * polynomial * np.exp(-t)


class DenseGP:
    """Zero-mean Gaussian process regression on inputs that are multiplied by `scale` before the kernel.

    That is `weights`, and once it is normalised, `weights` over the deviations.
    """

    def __init__(self, weights: Array, variance: float, length_scale: float, nu: float, noise: float):
        self.weights = self.scale = weights
        self.hyper, self.noise = (variance, length_scale, nu), noise
        self.inputs, self.targets = np.zeros((0, len(weights))), np.zeros(0)

    def covariance(self, x: Array) -> Array:
        """k(x_i, x) for every point of the dictionary, shape (n,)."""
        return kernel(self.inputs * self.scale, (x * self.scale)[None], *self.hyper)[:, 0]

    def train(self) -> None:
        """Alg. 2, line 14: factorise K + noise I anew."""
        scaled = self.inputs * self.scale
        matrix = kernel(scaled, scaled, *self.hyper) + self.noise * np.eye(len(scaled))
        self.factor = cho_factor(matrix, lower=True)

    def predict(self, x: Array) -> tuple[float, float]:
        """Mean and standard deviation at x (d,); the deviation is an observation's, noise included."""
        variance = self.hyper[0] + self.noise
        if not len(self.inputs):
            return 0.0, math.sqrt(variance)
        k = self.covariance(x)
        variance -= k @ cho_solve(self.factor, k)
        return float(k @ cho_solve(self.factor, self.targets)), math.sqrt(max(variance, self.noise))

    def put(self, x: Array, target: float, index: int | None = None) -> None:
        """Writes (x, target) over point `index`, or appends it."""
        if index is None:
            self.inputs, self.targets = np.vstack([self.inputs, x]), np.append(self.targets, target)
        else:
            self.inputs[index], self.targets[index] = x, target

    def normalise(self) -> None:
        """M_ns: one over each column's standard deviation (ddof 0), or one where that is under 1e-6."""
        deviation = self.inputs.std(axis=0)
        self.scale = self.weights / np.where(deviation < 1e-6, 1.0, deviation)


@dataclass(frozen=True)
class Info:
    """What a correction did, per action dimension (action_size,); NaN and False where h was 0."""

    rate: Array
    sigma_policy: Array
    sigma_human: Array
    appended: Array
    replaced: Array


def _blank(size: int) -> Info:
    return Info(*(np.full(size, np.nan) for _ in range(3)), *(np.zeros(size, dtype=bool) for _ in range(2)))


class DenseGPC:
    """GPC (the state is scaled by `weights`) and GPC-NS (`normalise`; scaled by them after that): Alg. 2 and 3."""

    def __init__(
        self,
        obs_size: int,
        action_size: int,
        *,
        policy_variance: float,  # c_p
        policy_length_scale: float,  # l_p
        policy_nu: float,  # nu_p; inf is the SE kernel
        human_variance: float,  # c_h
        human_length_scale: float,  # l_h
        human_nu: float = math.inf,
        constant_rate: float,  # c_r
        static_rate: float | None = None,  # r_c, in place of the adaptive rate (3.5)
        weights: Sequence[float] | None = None,  # w
        human_weights: Sequence[float] | None = None,  # of the state and the action; None is w and 1
        normalise: bool = False,
        sparsify: bool = True,
        noise: float = 1e-7,
        human_noise: float | None = None,
    ):
        w = np.ones(obs_size) if weights is None else np.asarray(weights, dtype=float)
        pair = np.append(w, 1.0) if human_weights is None else np.asarray(human_weights, dtype=float)
        p = policy_variance, policy_length_scale, policy_nu
        h = human_variance, human_length_scale, human_nu
        self.policies = [DenseGP(w, *p, noise) for _ in range(action_size)]
        self.humans = [
            DenseGP(pair, *h, noise if human_noise is None else human_noise) for _ in range(action_size)
        ]
        self.constant_rate, self.static_rate = constant_rate, static_rate
        self.normalise, self.sparsify, self.threshold = normalise, sparsify, 0.5 * math.sqrt(policy_variance)

    def act(self, obs: Array) -> Array:
        """The executed action (action_size,): the policies' means, clipped to [-1, 1]."""
        return np.array([np.clip(p.predict(obs)[0], -1.0, 1.0) for p in self.policies])

    def uncertainty(self, obs: Array, action: Array) -> Array:
        """sigma_h at (s, a_i) (action_size,)."""
        return np.array([m.predict(np.append(obs, a))[1] for m, a in zip(self.humans, action, strict=True)])

    def correct(self, obs: Array, action: Array, h: Array) -> Info:
        """Alg. 2, lines 6 to 14, for the executed action and advice h in {-1, 0, 1}, all (action_size,)."""
        info = _blank(len(self.policies))
        for i, (policy, human) in enumerate(zip(self.policies, self.humans, strict=True)):
            if h[i] == 0:
                continue
            z = np.append(obs, action[i])
            sigma_p, sigma_h = policy.predict(obs)[1], human.predict(z)[1]
            rate = sigma_p + sigma_h + self.constant_rate if self.static_rate is None else self.static_rate
            replace = self.sparsify and sigma_p < self.threshold
            # Alg. 3; argmax takes the lowest index of a tie. GPC-NS: the covariance before rescaling.
            index = int(np.argmax(policy.covariance(obs))) if replace else None
            policy.put(obs, action[i] + rate * h[i], index)
            human.put(z, h[i])
            for model in (policy, human):
                if self.normalise:
                    model.normalise()
                model.train()
            info.rate[i], info.sigma_policy[i], info.sigma_human[i] = rate, sigma_p, sigma_h
            info.appended[i], info.replaced[i] = not replace, replace
        return info


class DenseCOACH:
    """COACH (Alg. 1) on normalised RBF features (2.4), one per point of the product of the axes in `grid`."""

    def __init__(
        self,
        *,
        grid: Sequence[tuple[float, int, float]],  # (lb, int, ub) of each state
        beta: Sequence[float],  # per action dimension, as are e and c_c
        magnitude: Sequence[float],  # e
        coach_constant: Sequence[float],  # c_c
    ):
        axes = [np.linspace(low, high, count) for low, count, high in grid]
        self.centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        self.spacing = np.array([axis[1] - axis[0] for axis in axes])
        self.beta, self.magnitude, self.constant = beta, magnitude, coach_constant
        self.theta, self.psi = np.zeros((2, len(beta), len(self.centres)))

    def features(self, obs: Array) -> Array:
        """phi(s), summing to one; the exponent is shifted so that a state far off the grid gives no 0/0."""
        exponent = -0.5 * (((obs - self.centres) / self.spacing) ** 2).sum(axis=1)
        phi = np.exp(exponent - exponent.max())
        return phi / phi.sum()

    def act(self, obs: Array) -> Array:
        """Line 4, clipped to [-1, 1], shape (action_size,)."""
        return np.clip(self.theta @ self.features(obs), -1.0, 1.0)

    def correct(self, obs: Array, action: Array, h: Array) -> Info:
        """Lines 6 to 13; H(s) of line 10 is line 7's. `action` has no part in it."""
        info, phi = _blank(len(self.theta)), self.features(obs)
        for i in map(int, np.flatnonzero(h)):
            human = self.psi[i] @ phi
            alpha = abs(human) + self.constant[i]
            self.psi[i] += self.beta[i] * (h[i] - human) * phi
            self.theta[i] += alpha * phi * h[i] * self.magnitude[i]
            info.rate[i] = alpha * self.magnitude[i] * (phi @ phi)
        return info
