"""The peer that a patient numpy programmer ends with: one process, a Python loop, little left to save.

GPC keeps the inverse of P's kernel matrix and the inverse Cholesky factor of H's up to date in O(n^2).
Between corrections only the policy's mean is computed, in a few calls on preallocated arrays, with squared
distances from one matrix-vector product: that costs some 1e-12 of accuracy (1e-7 at a stored point for
nu = 0.5), so corrections take differences. GPC-NS factorises with LAPACK at each correction, since its
scaling moves every entry. COACH contracts its grid of weights one state dimension after the other.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import Unpack

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.distance import cdist

from benchmarks.peers.tasks import GP_VALUES, OBS_SIZE, TASKS, Floats, Learner, PeerResult, Teaching, teach

Array = np.ndarray


def profile(t: Array, nu: float) -> Array:
    """The Matern correlation at t = sqrt(2 nu) r / l, for nu 0.5 and 1.5."""
    return np.exp(-t) if nu == 0.5 else (1 + t) * np.exp(-t)


def distances(points: Array, x: Array) -> Array:
    """Euclidean distances (n,) of the rows of `points` from x."""
    difference = points - x
    return np.sqrt(np.einsum("ij,ij->i", difference, difference))


class Mean:
    """The policy's mean with as few and as small numpy calls as possible."""

    def __init__(self, nu: float, obs_size: int):
        self.smooth, self.size, self.n = nu == 1.5, obs_size, 0
        self.query = np.ones(obs_size + 2)  # s, its squared length, 1

    def load(self, scaled: Array, scale: Array, alpha: Array) -> None:
        """Prepares k(s) . alpha for scaled inputs (n, d) and alpha (n,), the variance already in it."""
        self.n = len(scaled)
        square = np.einsum("ij,ij->i", scaled, scaled)
        # A row times the query is the squared distance; the scale of s goes into the row.
        self.rows = np.column_stack([-2 * scaled * scale, np.ones(self.n), square])
        self.square_scale = tuple((scale * scale).tolist())
        self.t, self.e, self.alpha = np.empty(self.n), np.empty(self.n), -alpha if self.smooth else alpha

    def __call__(self, obs: Floats) -> float:
        """The clipped mean."""
        if not self.n:
            return 0.0
        t, e = self.t, self.e
        length = 0.0
        for s, w in zip(obs, self.square_scale, strict=True):
            length += s * s * w
        self.query[:-1] = (*obs, length)
        np.dot(self.rows, self.query, out=t)
        np.absolute(t, out=t)  # rounding can leave a zero distance just below zero
        np.sqrt(t, out=t)
        np.negative(t, out=t)
        np.exp(t, out=e)
        if self.smooth:
            np.subtract(t, 1.0, out=t)  # -(1 + t), its sign sits in alpha
            np.multiply(e, t, out=e)
        return min(1.0, max(-1.0, float(e.dot(self.alpha))))


class NumpyGPC:
    """GPC of one action, Alg. 2 and 3, incrementally."""

    def __init__(self, env: str, capacity: int = 64):
        v = self.values = GP_VALUES["gpc", env]
        size = OBS_SIZE[env]
        weights = np.array(v.weights)
        self.scale = weights * math.sqrt(2 * v.nu) / v.policy_length_scale
        self.human_scale = np.append(weights, 1.0) / v.human_length_scale
        self.threshold = 0.5 * math.sqrt(v.policy_variance)
        # Capacities double when full. P's and H's inputs are kept scaled.
        self.inputs, self.targets = np.zeros((capacity, size)), np.zeros(capacity)
        self.inverse = np.zeros((capacity, capacity))
        self.human_inputs, self.human_factor = np.zeros((capacity, size + 1)), np.zeros((capacity, capacity))
        self.policy_points = self.human_points = 0
        self.largest_sigma = math.sqrt(v.human_variance + v.noise)
        self.act = Mean(v.nu, size)

    def correct(self, obs: Floats, action: float, h: int) -> tuple[float, float, float, bool]:
        """Alg. 2, lines 6 to 14; (rate, sigma_p, sigma_h, replaced)."""
        v, n = self.values, self.policy_points
        s = np.array(obs) * self.scale
        k = v.policy_variance * profile(distances(self.inputs[:n], s), v.nu)
        u = self.inverse[:n, :n] @ k
        prior = v.policy_variance + v.noise
        left = max(prior - float(k @ u), v.noise)
        sigma_p = math.sqrt(left)
        sigma_h = self._extend_human(np.array((*obs, action)) * self.human_scale)
        rate = sigma_p + sigma_h + v.constant_rate

        replace = sigma_p < self.threshold
        if replace:
            at = int(np.argmax(k))
            inverse = self.inverse[:n, :n]
            column = inverse[:, at].copy()
            inverse -= np.outer(column, column / column[at])
            inverse[:, at] = inverse[at, :] = 0.0  # the point is gone, its place is free
            k[at] = 0.0
            u = inverse @ k
            left = prior - float(k @ u)
            u[at] = -1.0
        else:
            at = n
            if n == len(self.inputs):
                self.inputs, self.targets = _longer(self.inputs), _longer(self.targets)
                self.inverse = _longer(self.inverse, square=True)
            n = self.policy_points = n + 1
            u = np.append(u, -1.0)
        inverse = self.inverse[:n, :n]
        inverse += np.outer(u, u / left)
        self.inputs[at], self.targets[at] = s, action + rate * h
        self.act.load(self.inputs[:n], self.scale, v.policy_variance * (inverse @ self.targets[:n]))
        return rate, sigma_p, sigma_h, replace

    def sigma_human(self, obs: Floats, action: float) -> float:
        """How uncertain H is."""
        return self._whiten_human(np.array((*obs, action)) * self.human_scale)[1]

    def _whiten_human(self, z: Array) -> tuple[Array, float]:
        """L^-1 k and sigma_h at the scaled z."""
        v, m = self.values, self.human_points
        k = v.human_variance * np.exp(-0.5 * distances(self.human_inputs[:m], z) ** 2)
        row = self.human_factor[:m, :m] @ k
        return row, math.sqrt(max(v.human_variance + v.noise - float(row @ row), v.noise))

    def _extend_human(self, z: Array) -> float:
        """sigma_h at the scaled z, which H then appends. H keeps no targets: only its variance is asked."""
        m = self.human_points
        if m == len(self.human_inputs):
            self.human_inputs = _longer(self.human_inputs)
            self.human_factor = _longer(self.human_factor, square=True)
        row, sigma = self._whiten_human(z)
        self.human_inputs[m] = z
        self.human_factor[m, :m] = (row @ self.human_factor[:m, :m]) / -sigma
        self.human_factor[m, m] = 1 / sigma
        self.human_points = m + 1
        return sigma


def _longer(array: Array, square: bool = False) -> Array:
    """The array with as many zero rows again, and columns if it is square."""
    more = (0, len(array))
    return np.pad(array, [more, *[more if square else (0, 0)] * (array.ndim - 1)])


class NumpyGPCNS:
    """GPC-NS of one action: both kernel matrices rebuilt and factorised at each correction."""

    def __init__(self, env: str, capacity: int = 64):
        v = self.values = GP_VALUES["gpc-ns", env]
        size = OBS_SIZE[env]
        self.policy_stretch = math.sqrt(2 * v.nu) / v.policy_length_scale
        self.threshold = 0.5 * math.sqrt(v.policy_variance)
        self.inputs, self.targets = np.zeros((capacity, size)), np.zeros(capacity)
        self.human_inputs = np.zeros((capacity, size + 1))
        self.policy_points = self.human_points = 0
        self.act = Mean(v.nu, size)

    def _scale(self, inputs: Array) -> Array:
        deviation = inputs.std(axis=0)
        return 1 / np.where(deviation < 1e-6, 1.0, deviation)

    def correct(self, obs: Floats, action: float, h: int) -> tuple[float, float, float, bool]:
        """Alg. 2, lines 6 to 14; (rate, sigma_p, sigma_h, replaced)."""
        v, n, m = self.values, self.policy_points, self.human_points
        s, z = np.array(obs), np.array((*obs, action))
        variance_p, variance_h, k = v.policy_variance + v.noise, v.human_variance + v.noise, np.empty(0)
        if n:
            k = v.policy_variance * profile(distances(self.scaled, s * self.scale), v.nu)
            root = solve_triangular(self.factor, k, lower=True, check_finite=False)
            variance_p -= float(root @ root)
            k_h = v.human_variance * np.exp(-0.5 * distances(self.human_scaled, z * self.human_scale) ** 2)
            root = solve_triangular(self.human_factor, k_h, lower=True, check_finite=False)
            variance_h -= float(root @ root)
        sigma_p, sigma_h = math.sqrt(max(variance_p, v.noise)), math.sqrt(max(variance_h, v.noise))
        rate = sigma_p + sigma_h + v.constant_rate
        replace = sigma_p < self.threshold
        if not replace and n == len(self.inputs):
            self.inputs, self.targets = _longer(self.inputs), _longer(self.targets)
        if m == len(self.human_inputs):
            self.human_inputs = _longer(self.human_inputs)
        at = int(np.argmax(k)) if replace else n
        self.inputs[at], self.targets[at], self.human_inputs[m] = s, action + rate * h, z
        self.policy_points, self.human_points = n + (not replace), m + 1
        self._train()
        return rate, sigma_p, sigma_h, replace

    def _train(self) -> None:
        """New scales, matrices and factors; the mean is loaded."""
        v = self.values
        inputs, human_inputs = self.inputs[: self.policy_points], self.human_inputs[: self.human_points]
        self.scale = self._scale(inputs) * self.policy_stretch
        self.scaled = inputs * self.scale
        matrix = v.policy_variance * profile(cdist(self.scaled, self.scaled), v.nu)
        self.factor = _factorise(matrix, v.noise)
        self.human_scale = self._scale(human_inputs) / v.human_length_scale
        self.human_scaled = human_inputs * self.human_scale
        matrix = v.human_variance * np.exp(-0.5 * cdist(self.human_scaled, self.human_scaled, "sqeuclidean"))
        self.human_factor = _factorise(matrix, v.noise)
        alpha = cho_solve((self.factor, True), self.targets[: len(inputs)], check_finite=False)
        self.act.load(self.scaled, self.scale, v.policy_variance * alpha)


def _factorise(matrix: Array, noise: float) -> Array:
    matrix.flat[:: len(matrix) + 1] += noise
    return cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)[0]


# Table A.1: (lb, int, ub) of each state.
GRIDS = {
    "pendulum": ((-1, 6, 1), (-1, 6, 1), (-6, 7, 6)),
    "cartpole": ((-1.44, 4, 1.44), (-0.12, 4, 0.12), (-0.126, 4, 0.126), (-0.4, 4, 0.4)),
}


class NumpyCOACH:
    """COACH of one action (Alg. 1); its features, products of one-dimensional Gaussians, stay factored."""

    policy_points = human_points = 0

    def __init__(self, env: str, beta: float = 30.0, magnitude: float = 5.0, constant: float = 1.8):
        self.beta, self.magnitude, self.constant = beta, magnitude, constant
        axes = [np.linspace(low, high, count) for low, count, high in GRIDS[env]]
        counts = [len(axis) for axis in axes]
        # Gaussians up to a factor that normalising removes: exp(s mu / w^2 - mu^2 / 2 w^2), a row a centre.
        widths = [axis[1] - axis[0] for axis in axes]
        self.slope, self.offset = np.zeros((sum(counts), len(axes))), np.zeros(sum(counts))
        self.gaussians, self.query = np.zeros(sum(counts)), np.zeros(len(axes))
        ends = np.cumsum(counts)
        self.parts = [self.gaussians[end - count : end] for end, count in zip(ends, counts, strict=True)]
        for i, (axis, width, end) in enumerate(zip(axes, widths, ends, strict=True)):
            self.slope[end - len(axis) : end, i] = axis / width**2
            self.offset[end - len(axis) : end] = -0.5 * (axis / width) ** 2
        # theta and, for the sum of the features, a row of ones; contracted from the last dimension on.
        self.weights = np.vstack([np.zeros(math.prod(counts)), np.ones(math.prod(counts))])
        self.theta, self.psi = self.weights[0], np.zeros(math.prod(counts))
        self.chain: list[tuple[Array, Array, Array]] = []
        table = self.weights
        for part in reversed(self.parts):
            table = table.reshape(-1, len(part))
            out = np.zeros(len(table))
            self.chain.append((table, part, out))
            table = out
        self.sums = table

    def act(self, obs: Floats) -> float:
        """Line 4, clipped."""
        self.query[:] = obs
        gaussians = self.gaussians
        np.dot(self.slope, self.query, out=gaussians)
        np.add(gaussians, self.offset, out=gaussians)
        np.exp(gaussians, out=gaussians)
        for table, part, out in self.chain:
            np.dot(table, part, out=out)
        value, total = self.sums.tolist()
        return min(1.0, max(-1.0, value / total))

    def correct(self, obs: Floats, action: float, h: int) -> float:
        """Alg. 1, lines 6 to 13, for the observation just acted on; the learning rate."""
        phi = reduce(np.multiply.outer, self.parts).ravel()
        phi /= phi.sum()
        human = float(self.psi @ phi)
        alpha = abs(human) + self.constant
        self.psi += self.beta * (h - human) * phi
        self.theta += alpha * self.magnitude * h * phi
        return alpha * self.magnitude * float(phi @ phi)


LEARNERS: dict[str, type[NumpyGPC] | type[NumpyGPCNS] | type[NumpyCOACH]] = {
    "gpc": NumpyGPC,
    "gpc-ns": NumpyGPCNS,
    "coach": NumpyCOACH,
}


def run(algo: str, env: str, **teaching: Unpack[Teaching]) -> PeerResult:
    """Teaches `algo` ("gpc", "gpc-ns", "coach") on `env` ("cartpole", "pendulum"); see tasks.teach."""
    learner: Learner = LEARNERS[algo](env)
    return teach(learner, TASKS[env](), **teaching)
