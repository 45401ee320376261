"""Tasks of brax of which more is known than their name. Data only, no jax."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True)
class Known:
    """What is known of a task of brax: `label`, `unit`, `actions` and `experts` as in `TaskSpec`.

    `max_steps` ends an episode, where brax's usual 1,000 steps mean little.
    """

    label: str
    unit: str
    actions: tuple[str, ...] = ()
    max_steps: int = 1000
    experts: Mapping[str, tuple[str, ...]] = field(default_factory=dict, hash=False)


def _ppo(shipped: str) -> Mapping[str, tuple[str, ...]]:
    """The expert that brax's own PPO trained (`make oracles ENV=brax:NAME`)."""
    return MappingProxyType({"ppo": ("gpcjax.policies.saved:load_shipped", shipped)})


KNOWN: Mapping[str, Known] = MappingProxyType(
    {
        "inverted_pendulum": Known(
            "Inverted pendulum (brax)", "steps upright", experts=_ppo("brax-inverted_pendulum")
        ),
        # It ends by no event; at rest on its target, which it reaches within a second, it earns nothing more.
        "reacher": Known(
            "Reacher (brax)",
            "negative cost",
            ("shoulder", "elbow"),
            max_steps=50,
            experts=_ppo("brax-reacher"),
        ),
    }
)
"""By brax's name."""
