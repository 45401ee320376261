"""The policy over two numbers of an observation, as the page draws it (Fig. 5.3 of the thesis)."""

import base64
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

SIDE = 41
"""Points of the grid in each direction."""

MOST_PLACES = 1000


def chart(
    act_at: Callable[[Float[np.ndarray, "obs points"]], Float[np.ndarray, "action points"]],
    axes: tuple[int, int],
    dim: int,
    bounds: Float[np.ndarray, "obs 2"],
    places: list[list[float]],
) -> dict[str, Any]:
    """The message `map`.

    Args:
        act_at: the policy at many observations.
        axes: which two numbers of an observation.
        dim: which dimension of the action.
        bounds: lowest and highest value of each number.
        places: observations at which advice was given. The numbers that are no axes have their median there, or are in
            the middle of their bounds.
    """
    x, y = axes
    middle = np.median(places, axis=0) if places else bounds.mean(1)
    lines = [np.linspace(bounds[axis, 0], bounds[axis, 1], SIDE) for axis in (x, y)]
    grid = np.repeat(np.asarray(middle, float)[:, None], SIDE * SIDE, axis=1)
    across, along = np.meshgrid(*lines)
    grid[x], grid[y] = across.ravel(), along.ravel()
    actions = act_at(grid)[dim]
    values = (np.nan_to_num(actions).clip(-1, 1) * 127).round().astype(np.int8)
    kept = np.asarray(places[-MOST_PLACES:], float).reshape(-1, len(bounds))[:, [x, y]]
    return {
        "type": "map",
        "x": x,
        "y": y,
        "dim": dim,
        "low": [float(bounds[axis, 0]) for axis in axes],
        "high": [float(bounds[axis, 1]) for axis in axes],
        "size": [SIDE, SIDE],
        "values": base64.b64encode(values.tobytes()).decode(),
        "points": kept.round(5).tolist(),
    }
