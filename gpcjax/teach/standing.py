"""How a lesson is held, how it stands, and who is told. Loads no jax."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Say = Callable[[dict[str, Any] | bytes], None]
"""Takes a message for the page, from any thread."""


@dataclass(frozen=True)
class Options:
    """How a lesson is held."""

    repeat: float = 8.0
    """Advices a second while a key is held."""
    speed: float = 1.0
    """Times real time."""
    oracle: str | None = None
    """Whose mean return is drawn as a line; the task's own expert if None."""


@dataclass
class Standing:
    """How a lesson stands: what the message `state` tells."""

    speed: float
    mode: str = "teach"
    paused: bool = True
    why: str = "start"
    late: float = 0.0
    """Milliseconds that the present step was behind its time."""
