"""What the page may say, and how it is read: every message is JSON of a known form and bounded size. Loads no jax.

| `type`    | values                     | asks for                                                             |
|-----------|----------------------------|----------------------------------------------------------------------|
| `take`    |                            | to teach here, where another page does                               |
| `press`   | as `Press`                 | an advice                                                            |
| `pause`   | `on`                       | to rest, or to go on                                                 |
| `step`    |                            | one step while it rests                                              |
| `reset`   |                            | the end of this episode                                              |
| `undo`    |                            | to take the latest advice back                                       |
| `speed`   | `value`                    | so many times real time                                              |
| `run`     | `on`                       | to evaluate the policy without learning, or to end that              |
| `learner` | `name`, `settings`         | to begin anew with this learner                                      |
| `save`, `open` | `name`                | to keep the present state, or to begin with one that was kept        |
| `map`     | `x`, `y`, `dim`            | the policy over these two numbers of an observation                  |
| `ping`    | `at`                       | an answer                                                            |
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

MESSAGE_BYTES = 4096
"""The longest message that is read."""

SPEEDS = (0.1, 2.0)
"""The slowest and the fastest, in times of real time."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}")
"""What a saved state may be called: a folder of this name is made."""

_LARGEST = 2**53
_SETTINGS = 32
"""How many a learner can have at most."""


class Refused(ValueError):
    """A message that no page of ours sends."""


class Press(NamedTuple):
    """An advice as it was given."""

    id: int
    dim: int
    h: int
    shown: int
    """Number of the frame that was on the screen."""
    at: float
    """Milliseconds of the page's clock when the key went down."""
    drawn: float
    """The same when that frame was drawn."""
    held: bool
    """Whether it is a repetition while the key is held."""


@dataclass(frozen=True)
class Command:
    """A message that was read: its `type`, and its values by name."""

    type: str
    values: dict[str, Any] = field(default_factory=dict)
    press: Press | None = None


Forms = Mapping[str, Mapping[str, Callable[[object], bool]]]
"""Of each type of message, what checks each of its values."""


def parse(text: str | bytes, forms: Forms | None = None, most: int = MESSAGE_BYTES) -> Command:
    """The command of a message.

    Args:
        text: the message.
        forms: what is known; those of a lesson without it.
        most: bytes of the message.

    Raises:
        Refused: it is too long, no JSON, or of no known form.
    """
    if len(text if isinstance(text, bytes) else text.encode(errors="surrogatepass")) > most:
        raise Refused("too long")
    try:
        message = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError):
        raise Refused("no JSON") from None
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise Refused("no message")
    kind = message.pop("type")
    wanted = (FORMS if forms is None else forms).get(kind)
    if wanted is None:
        raise Refused("of no known type")
    if message.keys() - wanted.keys() or not all(
        check(message.get(name)) for name, check in wanted.items() if name in message or name not in _OPTIONAL
    ):
        raise Refused(f"no {kind}")
    if kind == "press":
        press = Press(
            message["id"],
            message["dim"],
            message["h"],
            message["n"],
            float(message["at"]),
            float(message.get("drawn", message["at"])),
            message["held"],
        )
        return Command(kind, press=press)
    return Command(kind, message)


def _no_number(word: str) -> float:
    raise ValueError(word)


def is_count(value: object) -> bool:
    """Whether it is a whole number from 0."""
    return type(value) is int and 0 <= value < _LARGEST


def is_number(value: object) -> bool:
    """Whether it is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST


def is_flag(value: object) -> bool:
    """Whether it is true or false."""
    return isinstance(value, bool)


def _name(value: object) -> bool:
    return isinstance(value, str) and NAME.fullmatch(value) is not None and not value.endswith((".", " "))


def _word(value: object) -> bool:
    return isinstance(value, str) and 0 < len(value) <= 200


def _speed(value: object) -> bool:
    return isinstance(value, int | float) and is_number(value) and SPEEDS[0] <= value <= SPEEDS[1]


def _settings(value: object) -> bool:
    if not isinstance(value, dict) or len(value) > _SETTINGS:
        return False
    return all(_word(name) and is_number(number) and math.isfinite(number) for name, number in value.items())


_OPTIONAL = {"drawn"}
FORMS: Forms = {
    "take": {},
    "press": {
        "id": is_count,
        "dim": is_count,
        "h": lambda value: type(value) is int and value in (-1, 1),
        "n": is_count,
        "at": is_number,
        "drawn": is_number,
        "held": is_flag,
    },
    "pause": {"on": is_flag},
    "step": {},
    "reset": {},
    "undo": {},
    "speed": {"value": _speed},
    "run": {"on": is_flag},
    "learner": {"name": _word, "settings": _settings},
    "save": {"name": _name},
    "open": {"name": _name},
    "map": {"x": is_count, "y": is_count, "dim": is_count},
    "ping": {"at": is_number},
}
"""Of what the page of a lesson says."""
