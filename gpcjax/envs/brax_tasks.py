"""Tasks of brax of which more is known than their name. Data only, no jax."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Known:
    """What is known of a task of brax: `label`, `unit` and `actions` as in `TaskSpec`.

    `max_steps` ends an episode, where brax's usual 1,000 steps mean little.
    """

    label: str
    unit: str
    actions: tuple[str, ...] = ()
    max_steps: int = 1000


KNOWN: Mapping[str, Known] = MappingProxyType(
    {
        "inverted_pendulum": Known("Inverted pendulum (brax)", "steps upright"),
        # It ends by no event; at rest on its target, which it reaches within a second, it earns nothing more.
        "reacher": Known("Reacher (brax)", "negative cost", ("shoulder", "elbow"), max_steps=50),
    }
)
"""By brax's name."""
