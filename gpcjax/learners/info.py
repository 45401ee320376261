"""What became of a correction."""

import enum
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class Status(enum.IntEnum):
    """What became of a correction, or of a whole run."""

    OK = 0
    FULL = 1
    NON_FINITE = 2
    INVALID = 3

    @property
    def label(self) -> str:
        """The word stored in the `status` column."""
        return self.name.lower().replace("_", "-")

    @property
    def message(self) -> str:
        """What happened and what to do, for a person."""
        return {
            Status.OK: "every correction was learned",
            Status.FULL: "a dictionary reached its capacity: raise max_capacity (capacity), or choose another on_full",
            Status.NON_FINITE: "a value became infinite or not a number: check the observations and hyperparameters",
            Status.INVALID: "an advice was none of -1, 0 and 1, or an action beyond [-1, 1], and nothing was learned "
            "from it: check the teacher, and clip what is executed",
        }[self]


class Info(eqx.Module):
    """What one correction did, for each action dimension; zeros and NaN where there was no advice or no such value.

    The axis `action` is absent where one dimension is corrected by itself.
    """

    rate: Float[Array, "*action"]
    """Learning rate r_k (3.5): how far the action was moved, so 0 if the correction was not learned.

    For COACH the change of the action at this observation.
    """
    sigma_policy: Float[Array, "*action"]
    """Uncertainty of the policy before the correction; NaN for COACH."""
    sigma_human: Float[Array, "*action"]
    """Uncertainty of the human model before the correction; NaN for COACH."""
    appended: Bool[Array, "*action"]
    """The policy's dictionary gained a point."""
    replaced: Bool[Array, "*action"]
    """SPARS (Alg. 3), or a full dictionary, put the new point in the place of an old one."""
    full: Bool[Array, "*action"]
    """A dictionary had no room for this correction; what was then done is the learner's `on_full`."""
    status: Int[Array, ""]
    """A `Status`."""

    @classmethod
    def of(cls, rate: Any) -> "Info":
        """Of a learner without dictionaries: how far each action dimension was moved, (action_size,), as numbers."""
        rate = jnp.asarray(rate)
        none, unknown = jnp.zeros(rate.shape, bool), jnp.full(rate.shape, jnp.nan)
        return cls(rate, unknown, unknown, none, none, none, jnp.asarray(Status.OK, jnp.int32))
