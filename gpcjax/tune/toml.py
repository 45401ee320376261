"""A specification as a file of settings, which `gpcjax sweep FILE` and `make sweep SPEC=FILE` take. Loads no jax."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from gpcjax.envs.registry import NOBODY
from gpcjax.registry import find
from gpcjax.sweep.options import OPTIONS, concerns
from gpcjax.sweep.points import POINTS
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import SweepSpec, as_dict

_ALWAYS = ("env", "algo", "seeds", "episodes", "error", "oracle")
"""Settings that a reader looks for; others are written where they are not usual."""


def text_of(spec: SweepSpec, comments: Iterable[str] = ()) -> str:
    """The file, which begins with these lines as comments. Every number comes back to the bit."""
    learners, teacher = [find("learner", name) for name in spec.algo], find("teacher", spec.teacher)
    settings = {
        name: value
        for name, value in as_dict(spec).items()
        if name not in OPTIONS or any(concerns(name, learner, teacher) for learner in learners)
    }
    if spec.oracle == (NOBODY,):
        del settings["oracle"]
    hyperparameters, points = settings.pop("hyperparameters"), settings.pop(POINTS, [])
    lines = [f"# {line}".rstrip() for line in comments]
    lines += [
        "",
        *_lines({name: settings.pop(name) for name in _ALWAYS if name in settings}),
        *_unusual(settings),
    ]
    lines += _lines(hyperparameters)
    for point in points:
        lines += ["", f"[[{POINTS}]]", *_lines(point)]
    return "\n".join(lines).lstrip("\n") + "\n"


def _unusual(settings: Mapping[str, Any]) -> list[str]:
    written = {}
    for name, value in settings.items():
        usual = OPTIONS[name].default if name in OPTIONS else None
        if value not in (None, [], usual, list(usual) if isinstance(usual, tuple) else usual):
            written[name] = value
    return _lines(written)


def _lines(settings: Mapping[str, Any]) -> list[str]:
    return [f"{name} = {_value(value, name)}" for name, value in settings.items()]


def _value(value: Any, name: str) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case float():
            return repr(value)
        case str():
            return json.dumps(value, ensure_ascii=False)
        case Mapping():
            return _value(Source(**value).folder, name)
        case [one] if name not in OPTIONS or not OPTIONS[name].series:
            return _value(one, name)
        case _:
            return f"[{', '.join(_value(one, name) for one in value)}]"
