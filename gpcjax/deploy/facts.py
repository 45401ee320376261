"""What a policy is: for a person, and for programs. Loads no jax for a policy that was saved."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gpcjax.deploy import export as exports
from gpcjax.deploy.label import description, moved, observed
from gpcjax.gp.smoothness import SQUARED_EXPONENTIAL
from gpcjax.play.chosen import Chosen
from gpcjax.policies.folder import FORMATS, SUMS
from gpcjax.policies.kinds import KINDS
from gpcjax.policies.plain import Plain, PlainGrid, PlainKernel, PlainNetwork
from gpcjax.policies.policy import Policy
from gpcjax.registry import find

_LONGEST = 120
"""Letters of a value of the provenance that a person is shown."""


def as_json(chosen: Chosen) -> dict[str, Any]:
    """All that is known, as JSON has it."""
    plain = _plain(chosen)
    obs_size, action_size = _sizes(chosen) or (None, None)
    return {
        "policy": chosen.who,
        "folder": None if chosen.folder is None else str(chosen.folder),
        "kind": "code" if plain is None else _kind(plain),
        "env": chosen.env,
        "obs_size": obs_size,
        "action_size": action_size,
        **_own(plain),
        "numbers": None if plain is None else _numbers(plain),
        "format": chosen.card.get("format"),
        "learner": _is_learner(chosen),
        "exports": [] if plain is None else list(exports.FORMATS),
        "provenance": json.loads(json.dumps(dict(chosen.provenance), default=str)),
    }


def facts(chosen: Chosen) -> dict[str, str]:
    """The same by name, for a person."""
    plain = _plain(chosen)
    sizes = _sizes(chosen)
    said = {"kind": "a rule in code: no numbers that were learned" if plain is None else description(plain)}
    if _is_learner(chosen):
        said["learner"] = "all of it is kept here: teaching can go on from it (--start, gpcjax teach --from)"
    said["task"] = chosen.env or "nobody says (--env)"
    if sizes is not None:
        said["observation"] = _listed(f"{sizes[0]} numbers", observed(sizes[0], chosen.env))
        said["action"] = _listed(f"{sizes[1]} numbers", moved(sizes[1], chosen.env))
    if isinstance(plain, PlainKernel):
        said["points"] = ", ".join(f"{count:,}" for count in _points(plain)) + (
            " (of each action)" if plain.action_size > 1 else ""
        )
        lengths = _lengths(plain)
        said["length-scales"] = "; ".join(", ".join(f"{each:.4g}" for each in row) for row in lengths)
    if plain is not None:
        said["numbers"] = f"{_numbers(plain):,}, {8 * _numbers(plain):,} bytes"
        said["exports"] = f"{', '.join(exports.FORMATS)} (gpcjax policy export)"
    if chosen.folder is not None:
        known = " and ".join(map(str, FORMATS))
        whole = (chosen.folder / SUMS).is_file()
        sums = "as they were saved" if whole else f"unchecked ({SUMS} is missing)"
        said["format"] = f"{chosen.card['format']} (this version reads {known}); its files are {sums}"
    if chosen.provenance:
        said["provenance"] = ""
    return said | {f"  {name}": text for name, text in _provenance(chosen.provenance).items()}


def _sizes(chosen: Chosen) -> tuple[int, int] | None:
    """Numbers of an observation and of an action; None where neither policy nor task says them."""
    return chosen.sizes or (None if chosen.env is None else find("task", chosen.env).sizes)


def _plain(chosen: Chosen) -> Plain | None:
    if not isinstance(chosen.act, Policy) or chosen.act.plain is None:
        return None
    kind = next(kind for kind in KINDS.values() if kind.holds(chosen.act.plain))
    return kind.read(*kind.write(chosen.act.plain))


def _kind(plain: Plain) -> str:
    return next(name for name, kind in KINDS.items() if kind.holds(plain))


def _is_learner(chosen: Chosen) -> bool:
    return chosen.card.get("kind") == "learner"


def _own(plain: Plain | None) -> dict[str, Any]:
    """What a kind says beside its sizes."""
    match plain:
        case PlainKernel():
            smooth = "infinity" if plain.smoothness == SQUARED_EXPONENTIAL else plain.smoothness
            return {"points": _points(plain), "smoothness": smooth, "length_scales": _lengths(plain)}
        case PlainGrid():
            ends = {name: getattr(plain, name).tolist() for name in ("lower", "upper")}
            return {"counts": list(plain.counts), **ends}
        case PlainNetwork():
            return {"layers": [len(bias) for bias in plain.biases]}
    return {}


def _points(plain: PlainKernel) -> list[int]:
    """Those in use, of each action."""
    return (plain.weights != 0).sum(1).tolist()


def _lengths(plain: PlainKernel) -> list[list[float]]:
    """Of each number of an observation, and of each action; once where actions have the same."""
    scale = plain.scale[:1] if (plain.scale == plain.scale[:1]).all() else plain.scale
    # (3.4) takes distances in length-scales times sqrt(2 nu).
    unit = 1.0 if plain.smoothness == SQUARED_EXPONENTIAL else math.sqrt(2 * plain.smoothness)
    with np.errstate(divide="ignore"):
        return (unit / scale).tolist()


def _numbers(plain: Plain) -> int:
    kind = KINDS[_kind(plain)]
    return sum(values.size for values in kind.write(plain)[1].values())


def _listed(first: str, lines: list[str]) -> str:
    first = first.removesuffix("s") if first.startswith("1 ") else first
    return "\n".join([first, *lines])


def _provenance(given: Mapping[str, Any]) -> dict[str, str]:
    texts = {
        str(name): value if isinstance(value, str) else json.dumps(value, default=str)
        for name, value in given.items()
    }
    return {
        name: text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..." for name, text in texts.items()
    }
