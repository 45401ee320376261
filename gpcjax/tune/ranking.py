"""Which of several points are better, in one objective or in several. Pure."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def ranked(scores: Sequence[Sequence[float]], larger: Sequence[bool]) -> list[int]:
    """The places of points, the best first: by fronts that nobody dominates, within one by the sum of their ranks.

    Args:
        scores: for each point a number for each objective; nan is worse than anything.
        larger: for each objective whether more is better.
    """
    costs = _costs(scores, larger)
    costs = np.where(np.isnan(costs), np.inf, costs)
    ranks = np.stack([np.searchsorted(np.sort(column), column) for column in costs.T], axis=1).sum(1)
    return [
        place
        for front in _fronts(costs)
        for place in sorted(front, key=lambda place: (int(ranks[place]), place))
    ]


def front(scores: Sequence[Sequence[float]], larger: Sequence[bool]) -> list[int]:
    """The places of the points that no other one dominates, with finite scores, in their order: the Pareto front."""
    costs = _costs(scores, larger)
    known = np.flatnonzero(np.isfinite(costs).all(1))
    return sorted(int(known[place]) for place in _fronts(costs[known])[0]) if known.size else []


def _costs(
    scores: Sequence[Sequence[float]], larger: Sequence[bool]
) -> Float[np.ndarray, "points objectives"]:
    """Scores of which less is better."""
    signs = np.where(larger, -1.0, 1.0)
    return np.asarray(scores, float).reshape(len(scores), len(signs)) * signs


def _fronts(costs: Float[np.ndarray, "points objectives"]) -> list[list[int]]:
    """All fronts, each of the points that only points of fronts before it dominate.

    Whoever dominates a point comes before it in the order of the first objective, then the second, and so on; and a
    front that has a dominator of it has none behind it without one before: a bisection finds the front of each
    (Zhang et al. 2015, "An efficient approach to nondominated sorting", ENS-BS).
    """
    fronts: list[list[int]] = []
    for place in np.lexsort(costs.T[::-1]).tolist():
        low, high = 0, len(fronts)
        while low < high:
            middle = (low + high) // 2
            others = costs[fronts[middle]]
            if ((others <= costs[place]).all(1) & (others < costs[place]).any(1)).any():
                low = middle + 1
            else:
                high = middle
        if low == len(fronts):
            fronts.append([])
        fronts[low].append(place)
    return fronts
