"""Policies of each kind, as numbers that were drawn."""

import numpy as np

from gpcjax.gp.smoothness import SMOOTHNESSES
from gpcjax.policies.plain import PlainGrid, PlainKernel, PlainNetwork


def draw(shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def made():
    """One of each kind, of three observations and two actions."""
    for nu in SMOOTHNESSES:
        yield PlainKernel(draw((2, 7, 3)), draw((2, 7), 1), np.abs(draw((2, 3), 2)), nu)
    yield PlainGrid(draw((2, 2, 4, 3)), np.array([-1.0, -2.0, 0.0]), np.array([1.0, 2.5, 0.3]), (2, 4, 3))
    sizes = (3, 5, 4, 2)
    weights = tuple(draw((sizes[i + 1], sizes[i]), i) for i in range(3))
    biases = tuple(draw(size) for size in sizes[1:])
    for squashed in (False, True):
        yield PlainNetwork(weights, biases, squashed)
        yield PlainNetwork((draw((2, 3)),), biases[-1:], squashed)
