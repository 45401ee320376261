"""Controllers of the built-in kinds and the same in numpy (`gpcjax.policies.plain`), one from the other."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from gpcjax._x64 import under_own_settings
from gpcjax.policies.base import Controller
from gpcjax.policies.grid import Grid, GridController
from gpcjax.policies.kernel import KernelController
from gpcjax.policies.network import NetworkController, SquashedNetwork
from gpcjax.policies.plain import Plain, PlainGrid, PlainKernel, PlainNetwork


def has_counterpart(controller: Controller) -> bool:
    """Whether it is of a built-in kind; one made of such may act otherwise."""
    return type(controller) in _IN_NUMPY


@under_own_settings
def in_numpy(controller: Controller) -> Plain | None:
    """The same in numpy, also with lanes; None if it is of no built-in kind."""
    make = _IN_NUMPY.get(type(controller))
    return None if make is None else make(controller)


@under_own_settings
def plain_of(controller: Controller) -> Plain | None:
    """The same for one observation; None for one of no built-in kind, with lanes, or whose numbers jax traces."""
    leaves = jax.tree.leaves(controller)
    if not all(isinstance(leaf, np.ndarray | jax.Array) and not isinstance(leaf, Tracer) for leaf in leaves):
        return None
    plain = in_numpy(controller)
    return None if plain is None or plain.lanes else plain


@under_own_settings
def controller_of(plain: Plain) -> Controller:
    """The controller with these numbers, as arrays of jax's; inside a function that jax traces too."""
    with jax.ensure_compile_time_eval():
        match plain:
            case PlainKernel():
                arrays = {name: jnp.asarray(getattr(plain, name)) for name in ("points", "weights", "scale")}
                return KernelController(**arrays, smoothness=plain.smoothness)
            case PlainGrid():
                grid = Grid(jnp.asarray(plain.lower), jnp.asarray(plain.upper), plain.counts)
                return GridController(weights=jnp.asarray(plain.weights), grid=grid)
            case PlainNetwork():
                weights, biases = (tuple(map(jnp.asarray, each)) for each in (plain.weights, plain.biases))
                network = NetworkController(weights=weights, biases=biases)
                return SquashedNetwork(network) if plain.squashed else network
    raise TypeError(f"no controller for a {type(plain).__name__}")


def _kernel(controller: KernelController) -> PlainKernel:
    points, weights, scale = map(np.asarray, (controller.points, controller.weights, controller.scale))
    return PlainKernel(points, weights, scale, controller.smoothness)


def _grid(controller: GridController) -> PlainGrid:
    grid = controller.grid
    weights, lower, upper = map(np.asarray, (controller.weights, grid.lower, grid.upper))
    return PlainGrid(weights, lower, upper, grid.counts)


def _network(controller: NetworkController, squashed: bool = False) -> PlainNetwork:
    weights, biases = (tuple(map(np.asarray, each)) for each in (controller.weights, controller.biases))
    return PlainNetwork(weights, biases, squashed)


_IN_NUMPY: Mapping[type[Controller], Callable[[Any], Plain]] = {
    KernelController: _kernel,
    GridController: _grid,
    NetworkController: _network,
    SquashedNetwork: lambda controller: _network(controller.network, squashed=True),
}
