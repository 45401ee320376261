"""How the built-in kinds of policies are kept: what their card says beside the arrays, and of which shapes."""

import functools
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpcjax.gp.smoothness import SMOOTHNESSES, SQUARED_EXPONENTIAL
from gpcjax.policies.checkpoint import Shapes
from gpcjax.policies.plain import Plain, PlainGrid, PlainKernel, PlainNetwork

MOST_LAYERS = 64
"""Of a network: what is more is no card of ours."""

Arrays = Mapping[str, np.ndarray]
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Kind:
    """How policies of one kind are kept.

    Fields:
        holds: whether a policy is of this kind.
        write: a policy without lanes -> what its card says beside the arrays (JSON values), and the arrays.
        shapes: what the card says, obs_size, action_size, and the shapes it names -> the shapes there must be. What the
            sizes do not settle, such as the number of points, comes from those it names. Raises `Unfit`.
        read: what the card says, and the arrays (finite float64, of those shapes) -> the policy. Raises `Unfit`.
    """

    holds: Callable[[Plain], bool]
    write: Callable[[Any], tuple[dict[str, Any], dict[str, np.ndarray]]]
    shapes: Callable[[Settings, int, int, Shapes], Shapes]
    read: Callable[[Settings, Arrays], Plain]


class Unfit(Exception):
    """What a card or its arrays say makes no policy; the message says why."""


def _write_kernel(plain: PlainKernel) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    used = (plain.weights != 0).any(0)
    kept = max(1, int(np.flatnonzero(used).max(initial=0)) + 1)
    arrays = {
        "points": plain.points[:, :kept],
        "weights": plain.weights[:, :kept],
        "scale": plain.scale,
    }
    smooth = "infinity" if plain.smoothness == SQUARED_EXPONENTIAL else plain.smoothness
    return {"smoothness": smooth}, arrays


def _kernel_shapes(settings: Settings, obs_size: int, action_size: int, named: Shapes) -> Shapes:
    points = named.get("weights", ())[1:2] or (0,)
    if points[0] < 1:
        raise Unfit("weights for at least one point are needed")
    _smoothness(settings)
    return {
        "points": (action_size, *points, obs_size),
        "weights": (action_size, *points),
        "scale": (action_size, obs_size),
    }


def _read_kernel(settings: Settings, arrays: Arrays) -> PlainKernel:
    return PlainKernel(**arrays, smoothness=_smoothness(settings))


def _smoothness(settings: Settings) -> float:
    """JSON has no infinity: the squared exponential's is a word. Format 1 wrote what json made of it."""
    given = settings.get("smoothness")
    value = SQUARED_EXPONENTIAL if given == "infinity" else given
    if type(value) is not float or value not in SMOOTHNESSES:
        raise Unfit(f'smoothness {str(given)[:20]}: 0.5, 1.5, 2.5 or "infinity" is needed')
    return value


def _write_grid(plain: PlainGrid) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    arrays = {"weights": plain.weights, "lower": plain.lower, "upper": plain.upper}
    return {"counts": list(plain.counts)}, arrays


def _grid_shapes(settings: Settings, obs_size: int, action_size: int, named: Shapes) -> Shapes:
    counts = settings.get("counts")
    if not isinstance(counts, list) or not all(type(count) is int and count >= 2 for count in counts):
        raise Unfit("counts: a list of whole numbers of at least 2 is needed")
    if len(counts) != obs_size:
        raise Unfit(f"{len(counts)} counts for obs_size {obs_size}")
    return {"weights": (action_size, *counts), "lower": (obs_size,), "upper": (obs_size,)}


def _read_grid(settings: Settings, arrays: Arrays) -> PlainGrid:
    if not (arrays["lower"] < arrays["upper"]).all():
        raise Unfit("lower must be below upper")
    return PlainGrid(**arrays, counts=tuple(settings["counts"]))


def _write_network(plain: PlainNetwork) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    layers = enumerate(zip(plain.weights, plain.biases, strict=True), 1)
    arrays = {
        f"{name}_{layer}": value
        for layer, pair in layers
        for name, value in zip(("weights", "biases"), pair, strict=True)
    }
    return {"layers": len(plain.weights)}, arrays


def _network_shapes(settings: Settings, obs_size: int, action_size: int, named: Shapes) -> Shapes:
    layers = settings.get("layers")
    if type(layers) is not int or not 1 <= layers <= MOST_LAYERS:
        raise Unfit(f"layers {str(layers)[:20]}: a whole number from 1 to {MOST_LAYERS} is needed")
    widths = [(*named.get(f"biases_{layer}", ()), 0)[0] for layer in range(1, layers)]
    if min(widths, default=1) < 1:
        raise Unfit("biases for at least one unit in each layer are needed")
    sizes = [obs_size, *widths, action_size]
    return {
        name: shape
        for layer, (inputs, outputs) in enumerate(itertools.pairwise(sizes), 1)
        for name, shape in ((f"weights_{layer}", (outputs, inputs)), (f"biases_{layer}", (outputs,)))
    }


def _read_network(settings: Settings, arrays: Arrays, squashed: bool = False) -> PlainNetwork:
    layers = range(1, settings["layers"] + 1)
    weights, biases = (tuple(arrays[f"{name}_{layer}"] for layer in layers) for name in ("weights", "biases"))
    return PlainNetwork(weights, biases, squashed)


KINDS: Mapping[str, Kind] = {
    "kernel": Kind(lambda plain: isinstance(plain, PlainKernel), _write_kernel, _kernel_shapes, _read_kernel),
    "grid": Kind(lambda plain: isinstance(plain, PlainGrid), _write_grid, _grid_shapes, _read_grid),
    "network": Kind(
        lambda plain: isinstance(plain, PlainNetwork) and not plain.squashed,
        _write_network,
        _network_shapes,
        _read_network,
    ),
    "squashed-network": Kind(
        lambda plain: isinstance(plain, PlainNetwork) and plain.squashed,
        _write_network,
        _network_shapes,
        functools.partial(_read_network, squashed=True),
    ),
}
"""By the name in the card."""
