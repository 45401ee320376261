"""What jax must know of policies: they compute in float64, and are pytrees. Needs jax, and nothing that needs jax.

It is imported in the middle of whatever imports jax first (`gpcjax.policies.later`), equinox for one.
"""

import jax

import gpcjax._x64  # noqa: F401
from gpcjax.policies.policy import Policy

jax.tree_util.register_pytree_with_keys(
    Policy,
    lambda policy: (((jax.tree_util.GetAttrKey("controller"), policy.controller),), None),
    lambda _, children: Policy(*children),
    lambda policy: ((policy.controller,), None),
)
