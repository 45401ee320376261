"""After which episodes of a run what was learned is handed out, while the run goes on."""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


@dataclass(frozen=True)
class Keep:
    """The episodes after which a lane waits until the host has copied it; nothing that it computes changes.

    What a run has learned in the end needs none of this: the finished lane has it.

    Fields:
        every: after each so many episodes of a run; 0 is never.
        best: after each episode that returned more than all before it; so the last of them is the run's best, and of
            equals the first.

    Raises:
        ValueError: there is no such episode.
    """

    every: int = 0
    best: bool = False

    def __post_init__(self) -> None:
        if self.every < 0 or not (self.every or self.best):
            raise ValueError(
                f"every={self.every}, best={self.best}: give episodes to keep, or no Keep at all"
            )

    def due(
        self,
        returns: Float[Array, " lanes"],
        earlier: Float[Array, "episodes lanes"],
        episode: Int[Array, " lanes"],
    ) -> Bool[Array, " lanes"]:
        """Whether what was learned is handed out after the episode of this index (from 0), which returned this much.

        `earlier` are the returns of a run; those of episodes before this one count.
        """
        due = jnp.zeros(episode.shape, bool)
        if self.every:
            due |= (episode + 1) % self.every == 0
        if self.best:
            before = jnp.arange(earlier.shape[0])[:, None] < episode[None]
            due |= returns > jnp.where(before, earlier, -jnp.inf).max(0)
        return due
