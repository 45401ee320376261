"""The built-in kinds of policies in numpy, for one observation at a time: what acts where jax is not needed.

A controller of jax computes many lanes in one program; called by itself, nearly all of its time is the call. These
compute the same formulas, to rounding (`tests/policies/test_plain.py`), in a few calls of numpy, and load no jax.
"""

import abc
import functools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpcjax.gp.smoothness import SQUARED_EXPONENTIAL
from gpcjax.policies.vectors import FARTHEST, near

Numbers = Float[np.ndarray, "..."]

_NEAR = FARTHEST**2
"""A sum of squares among which none can be of a number beyond `FARTHEST`."""


class Plain(abc.ABC):
    """A policy as numbers of numpy."""

    @property
    @abc.abstractmethod
    def obs_size(self) -> int:
        """Length of an observation."""

    @property
    @abc.abstractmethod
    def action_size(self) -> int:
        """Length of an action."""

    @property
    @abc.abstractmethod
    def lanes(self) -> bool:
        """Whether its arrays have more axes than those of one policy: such a one cannot be called."""

    @abc.abstractmethod
    def __call__(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        """The action before it is clipped to [-1, 1]."""

    def act(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        """The action in [-1, 1]; NaN stays NaN, as in jax, and nobody is warned of it."""
        with np.errstate(all="ignore"):
            if not obs.dot(obs) <= _NEAR:  # quicker than to bound each number at each call
                obs = near(obs)
            return np.minimum(np.maximum(self(obs), -1.0), 1.0)


@dataclass(frozen=True, eq=False)
class PlainKernel(Plain):
    """`gpcjax.policies.kernel.KernelController`, whose fields these are: k(s) . alpha (2.9)."""

    points: Numbers
    weights: Numbers
    scale: Numbers
    smoothness: float

    @property
    def obs_size(self) -> int:
        return self.scale.shape[1]

    @property
    def action_size(self) -> int:
        return self.scale.shape[0]

    @property
    def lanes(self) -> bool:
        return (self.points.ndim, self.weights.ndim, self.scale.ndim) != (3, 2, 2)

    @functools.cached_property
    def _columns(self) -> Float[np.ndarray, "obs action n"]:
        """The points, one dimension after the other: sums over them then run along whole rows."""
        return np.ascontiguousarray(np.moveaxis(self.points, 2, 0))

    def __call__(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        differences = self._columns - (obs * self.scale).T[:, :, None]
        squared = np.multiply(differences, differences, out=differences).sum(0)
        return (correlation(squared, self.smoothness) * self.weights).sum(1)


@dataclass(frozen=True, eq=False)
class PlainGrid(Plain):
    """`gpcjax.policies.grid.GridController`: theta . phi(s) (2.4)."""

    weights: Numbers
    lower: Numbers
    upper: Numbers
    counts: tuple[int, ...]

    @property
    def obs_size(self) -> int:
        return len(self.counts)

    @property
    def action_size(self) -> int:
        return self.weights.shape[0]

    @property
    def lanes(self) -> bool:
        return (self.weights.ndim, self.lower.ndim, self.upper.ndim) != (1 + len(self.counts), 1, 1)

    def __call__(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        total = self.weights
        for i, count in reversed(list(enumerate(self.counts))):
            spacing = (self.upper[i] - self.lower[i]) / (count - 1)
            distance = (obs[i] - self.lower[i]) / spacing - np.arange(count)
            exponent = -0.5 * distance * distance
            values = np.exp(exponent - exponent.max())
            total = total @ (values / values.sum())
        return total


@dataclass(frozen=True, eq=False)
class PlainNetwork(Plain):
    """`gpcjax.policies.network.NetworkController`, or, if it is squashed, `SquashedNetwork` around one."""

    weights: tuple[Numbers, ...]
    biases: tuple[Numbers, ...]
    squashed: bool = False

    @property
    def obs_size(self) -> int:
        return self.weights[0].shape[1]

    @property
    def action_size(self) -> int:
        return self.biases[-1].shape[0]

    @property
    def lanes(self) -> bool:
        return any(each.ndim != 2 for each in self.weights) or any(each.ndim != 1 for each in self.biases)

    def __call__(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        *hidden, last = zip(self.weights, self.biases, strict=True)
        units = obs
        for weights, biases in hidden:
            units = np.tanh(weights @ units + biases)
        units = last[0] @ units + last[1]
        return np.tanh(units) if self.squashed else units


def correlation(squared: Numbers, smoothness: float) -> Numbers:
    """`gpcjax.gp.kernels.correlation` in numpy."""
    if smoothness == SQUARED_EXPONENTIAL:
        return np.exp(-0.5 * squared)
    distance = np.sqrt(squared)
    falling = np.exp(-distance)
    if smoothness == 0.5:
        return falling
    if smoothness == 1.5:
        return (1.0 + distance) * falling
    return (1.0 + distance + squared / 3.0) * falling
