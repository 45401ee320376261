"""How fast the lanes of a block go, and what they have left: for estimates of time. Loads no jax."""

from typing import NamedTuple


class Pace(NamedTuple):
    """Of the lanes of one tier in one pool: what was done, and what those that are there have to do."""

    lanes: int
    """Width of the block."""
    seconds: float = 0.0
    """That the block was advanced, compilations left out."""
    lane_seconds: float = 0.0
    """The same, times the lanes that were in it."""
    episodes: int = 0
    """That ended in it."""
    left: int = 0
    """Episodes that the lanes which are there, or wait for a place, have to do."""
    longest: int = 0
    """Most episodes that one of them has to do."""

    def since(self, before: "Pace") -> "Pace":
        """What was done since then."""
        return self._replace(
            seconds=self.seconds - before.seconds,
            lane_seconds=self.lane_seconds - before.lane_seconds,
            episodes=self.episodes - before.episodes,
        )
