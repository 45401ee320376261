"""The policies of neural networks: layers of tanh units and a linear one, whose output may be squashed."""

import functools
import operator

from jax import lax
from jaxtyping import Array, Float

from gpcjax.elementary import tanh
from gpcjax.policies.base import Controller


class NetworkController(Controller):
    """A multilayer perceptron: a = W_n tanh(... tanh(W_1 s + b_1) ...) + b_n.

    Whatever an observation or an action was scaled by in training is part of the first and the last layer.
    """

    weights: tuple[Float[Array, "_ _ *lanes"], ...]
    """W of each layer, (outputs, inputs, *lanes); the first takes observations, the last gives actions."""
    biases: tuple[Float[Array, "_ *lanes"], ...]
    """b of each layer, (outputs, *lanes)."""

    @property
    def obs_size(self) -> int:
        return self.weights[0].shape[1]

    @property
    def action_size(self) -> int:
        return self.biases[-1].shape[0]

    def __call__(self, obs: Float[Array, "obs *lanes"]) -> Float[Array, "action *lanes"]:
        *hidden, last = zip(self.weights, self.biases, strict=True)
        units = obs
        for weights, biases in hidden:
            units = tanh(_affine(weights, biases, units))
        return _affine(*last, units)


class SquashedNetwork(Controller):
    """A network whose actions are in (-1, 1): a = tanh(what `network` gives)."""

    network: NetworkController

    @property
    def obs_size(self) -> int:
        return self.network.obs_size

    @property
    def action_size(self) -> int:
        return self.network.action_size

    def __call__(self, obs: Float[Array, "obs *lanes"]) -> Float[Array, "action *lanes"]:
        return tanh(self.network(obs))


def _affine(
    weights: Float[Array, "outputs inputs *lanes"],
    biases: Float[Array, "outputs *lanes"],
    units: Float[Array, "inputs *lanes"],
) -> Float[Array, "outputs *lanes"]:
    """W x + b, written out: XLA then makes one loop of it, over lanes, and adds in the same order for any number."""
    # The barrier keeps that loop from computing the units anew for each of its outputs.
    units = lax.optimization_barrier(units)
    terms = (lax.index_in_dim(weights, k, 1, keepdims=False) * units[k][None] for k in range(units.shape[0]))
    return functools.reduce(operator.add, terms, biases)
