"""What advice is about: one step of one lane. Teachers are shown moments, learners are corrected at them."""

import equinox as eqx
from jaxtyping import Array, Float, Int

import gpcjax._x64  # noqa: F401


class Moment(eqx.Module):
    """One step; a block of lanes has them as the LAST axis of every field."""

    obs: Float[Array, "obs *lanes"]
    """What was seen."""
    action: Float[Array, "action *lanes"]
    """What was executed there, in [-1, 1]."""
    episode: Int[Array, "*lanes"]
    """From 0; 0 where nobody counts them."""
    step: Int[Array, "*lanes"]
    """Of the episode, from 0; 0 where nobody counts them."""
    target: Float[Array, "action *lanes"] | None = None
    """What the teacher's expert would have done; only where a teacher is asked."""
    sigma_human: Float[Array, "action *lanes"] | None = None
    """The learner's uncertainty; only where a teacher is asked, and zero if it is not `active`."""
    draws: Float[Array, "3 *lanes"] | None = None
    """Uniform numbers of this step in [0, 1), for what is random in a teacher beside its coins; only for one that
    `draws`."""
