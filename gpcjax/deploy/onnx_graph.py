"""A policy as a graph of ONNX in float64. Needs the package onnx, which is the extra `gpcjax[onnx]`."""

import importlib.util
import math
from typing import TYPE_CHECKING, Any

import numpy as np

import gpcjax
from gpcjax.deploy.label import Label
from gpcjax.errors import UserError
from gpcjax.gp.smoothness import SQUARED_EXPONENTIAL
from gpcjax.policies.plain import Plain, PlainGrid, PlainKernel, PlainNetwork
from gpcjax.policies.vectors import FARTHEST

if TYPE_CHECKING:
    from onnx import NodeProto, TensorProto

OPSET, IR_VERSION = 17, 8
"""Of 2022: what runs graphs today runs these."""

EXTRA = "--to onnx needs its extra: pip install 'gpcjax[onnx]'"


def onnx_graph(plain: Plain, label: Label) -> bytes:
    """The file: `obs` (batch, obs_size) -> `action` (batch, action_size), each row as `plain.act` to rounding.

    Raises:
        UserError: onnx is not installed.
    """
    if importlib.util.find_spec("onnx") is None:
        raise UserError(EXTRA)
    from onnx import TensorProto, checker, helper

    graph = _Graph()
    _add(graph, plain)
    number, names = TensorProto.DOUBLE, ("obs", "action")
    sizes = (plain.obs_size, plain.action_size)
    ends = [
        helper.make_tensor_value_info(name, number, ["batch", size])
        for name, size in zip(names, sizes, strict=True)
    ]
    made = helper.make_graph(graph.nodes, label.name, ends[:1], ends[1:], graph.constants)
    model = helper.make_model(
        made,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="gpcjax",
        producer_version=gpcjax.__version__,
        doc_string="\n".join([*label.head, "", "Provenance:", *label.provenance]),
    )
    checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


class _Graph:
    """Nodes and constants, as they come; each method gives the name of a value."""

    def __init__(self) -> None:
        self.nodes: list[NodeProto] = []
        self.constants: list[TensorProto] = []

    def constant(self, values: Any, kind: type = np.float64) -> str:
        """An array."""
        from onnx import numpy_helper

        name = f"constant_{len(self.constants) + 1}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(values, kind), name))
        return name

    def __call__(self, operator: str, *inputs: str, to: str = "", **attributes: Any) -> str:
        """What an operator makes of values; called `to`, if that is given."""
        from onnx import helper

        name = to or f"value_{len(self.nodes) + 1}"
        self.nodes.append(helper.make_node(operator, inputs, [name], **attributes))
        return name

    def sizes(self, *sizes: int) -> str:
        """The sizes or the axes that an operator takes; a size of 0 is the one that there is."""
        return self.constant(sizes, np.int64)

    def sum(self, value: str, axis: int) -> str:
        """Over an axis, which goes."""
        return self("ReduceSum", value, self.sizes(axis), keepdims=0)


def _add(graph: _Graph, plain: Plain) -> None:
    """All of a policy."""
    obs = _clipped(graph, "obs", FARTHEST)
    match plain:
        case PlainKernel():
            action = _kernel(graph, plain, obs)
        case PlainGrid():
            action = _grid(graph, plain, obs)
        case PlainNetwork():
            action = _network(graph, plain, obs)
        case _:
            raise TypeError(f"no graph for a {type(plain).__name__}")
    _clipped(graph, action, 1.0, to="action")


def _clipped(graph: _Graph, value: str, most: float, to: str = "") -> str:
    """From -most to most; runtimes differ in what they make of NaN when they clip."""
    clipped = graph("Clip", value, graph.constant(-most), graph.constant(most))
    return graph("Where", graph("IsNaN", value), value, clipped, to=to)


def _kernel(graph: _Graph, plain: PlainKernel, obs: str) -> str:
    place = graph("Unsqueeze", obs, graph.sizes(1))  # (batch, 1, obs)
    place = graph("Unsqueeze", graph("Mul", place, graph.constant(plain.scale)), graph.sizes(2))
    difference = graph("Sub", graph.constant(plain.points), place)  # (batch, action, point, obs)
    squared = graph.sum(graph("Mul", difference, difference), 3)
    return graph.sum(
        graph("Mul", _correlation(graph, squared, plain.smoothness), graph.constant(plain.weights)), 2
    )


def _correlation(graph: _Graph, squared: str, smoothness: float) -> str:
    if smoothness == SQUARED_EXPONENTIAL:
        return graph("Exp", graph("Mul", squared, graph.constant(-0.5)))
    distance = graph("Sqrt", squared)
    falling = graph("Exp", graph("Neg", distance))
    if smoothness == 0.5:
        return falling
    polynomial = graph("Add", distance, graph.constant(1.0))
    if smoothness == 2.5:
        polynomial = graph("Add", polynomial, graph("Div", squared, graph.constant(3.0)))
    return graph("Mul", polynomial, falling)


def _grid(graph: _Graph, plain: PlainGrid, obs: str) -> str:
    *_, last = counts = plain.counts
    rows = plain.action_size * math.prod(counts[:-1])
    shares = []
    for i, count in enumerate(counts):
        spacing = (plain.upper[i] - plain.lower[i]) / (count - 1)
        number = graph("Gather", obs, graph.sizes(i), axis=1)  # (batch, 1)
        distance = graph("Div", graph("Sub", number, graph.constant(plain.lower[i])), graph.constant(spacing))
        distance = graph("Sub", distance, graph.constant(np.arange(count)))
        exponent = graph("Mul", graph("Mul", distance, distance), graph.constant(-0.5))
        shares.append(graph("Softmax", exponent, axis=1))  # (batch, count)
    total = graph(
        "MatMul", shares.pop(), graph.constant(plain.weights.reshape(rows, last).T)
    )  # (batch, rows)
    for count in reversed(counts[:-1]):
        rows //= count
        total = graph("Reshape", total, graph.sizes(0, rows, count))
        total = graph.sum(graph("Mul", total, graph("Unsqueeze", shares.pop(), graph.sizes(1))), 2)
    return total


def _network(graph: _Graph, plain: PlainNetwork, units: str) -> str:
    for layer, (weights, biases) in enumerate(zip(plain.weights, plain.biases, strict=True), 1):
        linear = graph("MatMul", units, graph.constant(weights.T))
        units = graph("Add", linear, graph.constant(biases))
        if layer < len(plain.weights) or plain.squashed:
            units = graph("Tanh", units)
    return units
