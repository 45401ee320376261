"""Which of several points are better, in one objective or in several. Pure."""

from collections.abc import Sequence

import numpy as np


def ranked(scores: Sequence[Sequence[float]], larger: Sequence[bool]) -> list[int]:
    """The places of points, the best first: by fronts that nobody dominates, within one by the sum of their ranks.

    Args:
        scores: for each point a number for each objective; nan is worse than anything.
        larger: for each objective whether more is better.
    """
    signs = np.where(larger, -1.0, 1.0)
    costs = np.asarray(scores, float).reshape(len(scores), len(signs)) * signs
    costs = np.where(np.isnan(costs), np.inf, costs)
    ranks = np.stack([np.searchsorted(np.sort(column), column) for column in costs.T], axis=1)
    left, order = list(range(len(costs))), []
    while left:
        front = [place for place in left if not any(_dominates(costs[other], costs[place]) for other in left)]
        order += sorted(front, key=lambda place: (int(ranks[place].sum()), place))
        left = [place for place in left if place not in front]
    return order


def front(scores: Sequence[Sequence[float]], larger: Sequence[bool]) -> list[int]:
    """The places of the points that no other one dominates, with finite scores, in their order: the Pareto front."""
    signs = np.where(larger, -1.0, 1.0)
    costs = np.asarray(scores, float).reshape(len(scores), len(signs)) * signs
    known = [place for place in range(len(costs)) if np.isfinite(costs[place]).all()]
    return [place for place in known if not any(_dominates(costs[other], costs[place]) for other in known)]


def _dominates(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether one is nowhere worse and somewhere better."""
    return bool((one <= other).all() and (one < other).any())
