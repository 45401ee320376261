"""A policy as one file of Python that needs numpy alone."""

import numpy as np
from jaxtyping import Float

from gpcjax.deploy.label import Label
from gpcjax.deploy.numerals import numerals
from gpcjax.gp.smoothness import SQUARED_EXPONENTIAL
from gpcjax.policies.plain import Plain, PlainGrid, PlainKernel, PlainNetwork
from gpcjax.policies.vectors import FARTHEST

_CORRELATIONS = {
    0.5: ("r = np.sqrt(squared)", "np.exp(-r)"),
    1.5: ("r = np.sqrt(squared)", "(1.0 + r) * np.exp(-r)"),
    2.5: ("r = np.sqrt(squared)", "(1.0 + r + squared / 3.0) * np.exp(-r)"),
    SQUARED_EXPONENTIAL: ("", "np.exp(-0.5 * squared)"),
}

_TEMPLATE = '''\
# One policy, for Python with numpy; nothing else is needed.
#
{head}
#
# Provenance:
{provenance}
"""A policy: `act(obs)` gives what to do there."""

import numpy as np

OBS_SIZE = {obs_size}
ACTION_SIZE = {action_size}

{arrays}


def act(obs):
    """The action at `obs`, ({obs_size},) -> ({action_size},), float64 in [-1, 1].

    Raises ValueError for an observation of another shape. Safe to call from several threads.
    """
    obs = np.asarray(obs, dtype=np.float64)
    if obs.shape != (OBS_SIZE,):
        raise ValueError(f"obs has shape {{obs.shape}}, this policy takes ({{OBS_SIZE}},)")
    with np.errstate(all="ignore"):
        obs = np.minimum(np.maximum(obs, -{farthest!r}), {farthest!r})
{body}
        return np.minimum(np.maximum(action, -1.0), 1.0)
'''


def python_file(plain: Plain, label: Label) -> str:
    """The text of the file: `act(obs)`, (obs_size,) -> (action_size,), as `plain.act` to rounding."""
    arrays, body = _written(plain)
    return _TEMPLATE.format(
        head=_comment(label.head),
        provenance=_comment(label.provenance),
        farthest=FARTHEST,
        obs_size=plain.obs_size,
        action_size=plain.action_size,
        arrays="\n".join(arrays),
        body="\n".join(f"        {line}" for line in body),
    )


def _written(plain: Plain) -> tuple[list[str], list[str]]:
    """The arrays of a policy, and the lines that make `action` of `obs`."""
    match plain:
        case PlainKernel():
            arrays = [
                _array("SCALE", plain.scale, "what an observation is multiplied by: (action, obs)"),
                _array("POINTS", plain.points, "(action, point, obs)"),
                _array("WEIGHTS", plain.weights, "(action, point)"),
            ]
            distance, correlation = _CORRELATIONS[plain.smoothness]
            steps = ["squared = ((POINTS - (obs * SCALE)[:, None, :]) ** 2).sum(2)", distance]
            return arrays, [*filter(None, steps), f"action = ({correlation} * WEIGHTS).sum(1)"]
        case PlainGrid():
            arrays = [
                f"COUNTS = {plain.counts!r}",
                _array("LOWER", plain.lower, "of the grid: (obs,)"),
                _array("UPPER", plain.upper, "(obs,)"),
                _array("WEIGHTS", plain.weights, "(action, one axis for each number of an observation)"),
            ]
            body = [
                "action = WEIGHTS",
                "for i in reversed(range(OBS_SIZE)):",
                "    spacing = (UPPER[i] - LOWER[i]) / (COUNTS[i] - 1)",
                "    distance = (obs[i] - LOWER[i]) / spacing - np.arange(COUNTS[i])",
                "    exponent = -0.5 * distance * distance",
                "    share = np.exp(exponent - exponent.max())",
                "    action = action @ (share / share.sum())",
            ]
            return arrays, body
        case PlainNetwork():
            arrays, body, units = [], [], "obs"
            for layer, (weights, biases) in enumerate(zip(plain.weights, plain.biases, strict=True), 1):
                arrays += [_array(f"WEIGHTS_{layer}", weights, "(outputs, inputs)")]
                arrays += [_array(f"BIASES_{layer}", biases, "(outputs,)")]
                last = layer == len(plain.weights)
                linear = f"WEIGHTS_{layer} @ {units} + BIASES_{layer}"
                units = "action" if last else "units"
                body += [
                    f"{units} = {linear}" if last and not plain.squashed else f"{units} = np.tanh({linear})"
                ]
            return arrays, body
    raise TypeError(f"no file for a {type(plain).__name__}")


def _array(name: str, values: Float[np.ndarray, "..."], comment: str) -> str:
    """An assignment; `comment` says what its axes are."""
    shape = "" if values.ndim == 1 else f".reshape({', '.join(map(str, values.shape))})"
    return f"# {comment}\n{name} = np.array(\n    [\n{numerals(values, ' ' * 8)}\n    ]\n){shape}\n"


def _comment(lines: tuple[str, ...]) -> str:
    return "\n".join(f"# {line}".rstrip() for line in lines)
