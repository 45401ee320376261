"""How fast the lanes of a block go, and what they have left: for estimates of time. Loads no jax."""

from collections.abc import Sequence
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
    runs: int = 0
    """Lanes that are there, or wait for a place."""
    settled: int = 0
    """Those of them that have fewer episodes to do than others had, on average, when they outgrew the tier."""
    outgrown: int = 0
    """Lanes that have gone on to the next tier."""
    then_left: int = 0
    """Episodes that these had to do then."""
    ended: int = 0
    """Lanes that came to the end of their run here."""

    def since(self, before: "Pace") -> "Pace":
        """What was done since then."""
        return self._replace(
            seconds=self.seconds - before.seconds,
            lane_seconds=self.lane_seconds - before.lane_seconds,
            episodes=self.episodes - before.episodes,
            outgrown=self.outgrown - before.outgrown,
            then_left=self.then_left - before.then_left,
            ended=self.ended - before.ended,
        )

    def plus(self, other: "Pace") -> "Pace":
        """What was done by both, in blocks of one width; nothing of what they have left."""
        return Pace(
            self.lanes or other.lanes,
            self.seconds + other.seconds,
            self.lane_seconds + other.lane_seconds,
            self.episodes + other.episodes,
            outgrown=self.outgrown + other.outgrown,
            then_left=self.then_left + other.then_left,
            ended=self.ended + other.ended,
        )

    def with_left(self, left: Sequence[int]) -> "Pace":
        """The same of lanes that have these numbers of episodes to do."""
        usual = self.then_left / self.outgrown if self.outgrown else 0.0
        settled = sum(each < usual for each in left)
        return self._replace(left=sum(left), longest=max(left), runs=len(left), settled=settled)
