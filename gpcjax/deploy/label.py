"""What an exported file says of itself at its head. Plain ASCII, and never the end of anybody's comment. No jax."""

import json
import re
import textwrap
from collections.abc import Mapping
from typing import Any, NamedTuple

import gpcjax
from gpcjax.gp.smoothness import SQUARED_EXPONENTIAL
from gpcjax.policies.plain import Plain, PlainGrid, PlainKernel, PlainNetwork
from gpcjax.registry import built_in, find

WIDTH = 96
"""Letters of a line."""

MOST_PROVENANCE = 20_000
"""Letters of it that a head repeats."""

LONGEST_NAME = 60

KERNELS = {
    0.5: "exp(-r)",
    1.5: "(1 + r) exp(-r)",
    2.5: "(1 + r + r^2 / 3) exp(-r)",
    SQUARED_EXPONENTIAL: "exp(-r^2 / 2)",
}
"""As functions of the distance r of an observation from a point, in length-scales (sqrt(2 nu) of them for Matern's)."""


class Label(NamedTuple):
    """What a file says of a policy."""

    name: str
    """An identifier of Python and of C."""
    head: tuple[str, ...]
    """What it is, a line each, at most `WIDTH` letters."""
    provenance: tuple[str, ...]
    """Where it comes from, likewise."""


def label_of(plain: Plain, name: str, env: str | None, provenance: Mapping[str, Any]) -> Label:
    """The label of a policy on a task (None: nobody says which); `provenance` holds JSON values."""
    what = (
        f"{name}: a policy, {plain.obs_size} numbers of an observation -> {plain.action_size} of an action."
    )
    made = f"Exported by gpcjax {gpcjax.__version__}; rather than change it here, export it again."
    head = [*_wrapped(what), *_wrapped(made), "", *_wrapped(description(plain)), ""]
    for line in (*observed(plain.obs_size, env), *moved(plain.action_size, env)):
        head += _wrapped(line)
    head += _wrapped("An observation that holds NaN gives an action of NaN: do not pass it on to a motor.")
    if (seconds := _time_step(env)) is not None:
        head += _wrapped(f"It was taught with one action each {seconds:g} s.")
    return Label(name, tuple(head), tuple(_told(env, provenance)))


def identifier(text: str) -> str:
    """A name that Python and C take, as near to `text` as there is one."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")[:LONGEST_NAME].rstrip("_")
    return name if name[:1].isalpha() else f"policy_{name}".rstrip("_")


def description(plain: Plain) -> str:
    """What it computes, in a sentence."""
    match plain:
        case PlainKernel():
            points = plain.points.shape[1]
            kernel = KERNELS[plain.smoothness]
            nu = (
                "squared-exponential"
                if plain.smoothness == SQUARED_EXPONENTIAL
                else f"Matern {plain.smoothness:g}"
            )
            return (
                f"The mean of a Gaussian process for each action, with a {nu} kernel: the sum over {points} points of "
                f"weight * {kernel}, where r is the distance of obs * scale from a point; clipped to [-1, 1]."
            )
        case PlainGrid():
            counts = " x ".join(map(str, plain.counts))
            return (
                f"Normalised radial basis functions on a grid of {counts}, weighted and summed for each action; "
                "clipped to [-1, 1]."
            )
        case PlainNetwork():
            sizes = " - ".join(str(each) for each in (plain.obs_size, *(len(bias) for bias in plain.biases)))
            last = "tanh of a linear layer" if plain.squashed else "a linear layer"
            return f"A network of tanh units, {sizes}, that ends in {last}; clipped to [-1, 1]."
    raise TypeError(f"no words for a {type(plain).__name__}")


def observed(size: int, env: str | None) -> list[str]:
    """What each number of an observation is, where the task says so; a line each."""
    spec = _task(env)
    if spec is None or len(spec.view.observed) != size:
        return []
    return [f"obs[{place}]: {text}" for place, (text, *_) in enumerate(spec.view.observed)]


def moved(size: int, env: str | None) -> list[str]:
    """What each number of an action does, as far as the task says it; a line each."""
    spec, lines = _task(env), []
    for place in range(size):
        line = f"action[{place}]: from -1 to 1"
        if spec is not None and len(spec.view.controls) == size:
            control = spec.view.controls[place]
            line += f"; less is {control.less[1]}, more is {control.more[1]}"
        lines.append(line)
    return lines


def _time_step(env: str | None) -> float | None:
    spec = _task(env)
    return None if spec is None else spec.time_step


def _task(env: str | None) -> Any:
    """The description of a built-in task; for another one somebody's module would have to run."""
    return find("task", env) if env in built_in("task") else None


def _told(env: str | None, provenance: Mapping[str, Any]) -> list[str]:
    known = {**({} if env is None else {"env": env}), **provenance}
    lines = [
        line for name, value in known.items() for line in _wrapped(f"{_ascii(name)}: {_ascii(value)}", "    ")
    ]
    if sum(map(len, lines)) > MOST_PROVENANCE:
        return ["its card says it at length"]
    return lines or ["nobody has said"]


def _ascii(value: Any) -> str:
    """JSON on a line, without what ends a comment of C, begins one, or is a trigraph of it."""
    text = value if isinstance(value, str) and re.fullmatch(r"[A-Za-z0-9_.-]+", value) else json.dumps(value)
    return text.replace("*/", "*\\u002f").replace("/*", "/\\u002a").replace("??", "?\\u003f")


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent=indent, break_on_hyphens=False)
