"""Tasks of brax of which more is known than their name: experts that were trained for them. Data only, no jax."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

_SHIPPED = "gpcjax.policies.saved:load_shipped"

KNOWN: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "inverted_pendulum": {
            "label": "Inverted pendulum (brax)",
            "unit": "steps upright",
            "experts": MappingProxyType({"ppo": (_SHIPPED, "brax-inverted_pendulum")}),
        },
        "reacher": {
            "label": "Reacher (brax)",
            "unit": "negative cost",
            "actions": ("shoulder", "elbow"),
            "experts": MappingProxyType({"ppo": (_SHIPPED, "brax-reacher")}),
        },
    }
)
"""Fields of `TaskSpec` by brax's name."""
