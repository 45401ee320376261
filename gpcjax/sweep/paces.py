"""What is left of a program, tier by tier, from how fast the lanes of its workers go. Loads no jax.

Steps alone do not tell it. Runs that outgrow a tier wait until there are enough of them to fill a block of the next
one, so that those which take longest come last; and a block takes as long with few lanes in it as with many.
"""

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from gpcjax.engine.pace import Pace

FADES = 0.9
"""Of what a worker said, with each further word: runs live longer and longer, and so do their episodes."""

SLOWER = 2.5
"""How much longer an episode takes in a tier that has not run yet than in the one before: a guess, until it has."""

GROWS = 0.3
"""Part of what runs have to do in a tier that they do in the next one, where others went before."""


class Left(NamedTuple):
    """Seconds of one worker."""

    bound: float
    """Of the runs that are under way."""
    free: float
    """Of those that nobody has begun."""


class _Tier(NamedTuple):
    """The sums over the workers of a program."""

    lanes: int
    lane_seconds: float
    episodes: int
    recent_lane_seconds: float
    recent_episodes: float
    now: tuple[Pace, ...]
    """Of the workers that are at it."""


class Paces:
    """How fast the workers of one program are, those that left it too."""

    def __init__(self) -> None:
        self._now: dict[int, tuple[Pace, ...]] = {}
        """The last word of each worker that is at it."""
        self._past: tuple[Pace, ...] = ()
        """The sums of those that left."""
        self._recent: dict[int, tuple[float, float]] = {}
        """Lane seconds and episodes of each tier; those long ago count less."""

    def take(self, worker: int, paces: tuple[Pace, ...]) -> None:
        """Notes how far this worker has come."""
        before = self._now.get(worker, ())
        for tier, pace in enumerate(paces):
            more = pace.since(before[tier]) if tier < len(before) else pace
            seconds, episodes = self._recent.get(tier, (0.0, 0.0))
            fades = FADES if more.lane_seconds else 1.0
            self._recent[tier] = (fades * seconds + more.lane_seconds, fades * episodes + more.episodes)
        self._now[worker] = paces

    def leave(self, worker: int) -> None:
        """Notes that this worker is no longer at it."""
        paces = self._now.pop(worker, ())
        self._past = tuple(
            Pace(
                (one or other).lanes,
                one.seconds + other.seconds,
                one.lane_seconds + other.lane_seconds,
                one.episodes + other.episodes,
            )
            for one, other in itertools.zip_longest(self._past, paces, fillvalue=Pace(0))
            if one.lanes or other.lanes
        )

    @property
    def seconds(self) -> float:
        """That blocks were advanced."""
        return sum(pace.seconds for paces in self._all() for pace in paces)

    @property
    def compiled(self) -> int:
        """Tiers that a worker has compiled, of which some run."""
        return max((sum(pace.seconds > 0 for pace in paces) for paces in self._all()), default=0)

    @property
    def waiting(self) -> int:
        """Tiers in which runs wait that have not been compiled."""
        return max(
            (sum(pace.left > 0 and not pace.seconds for pace in paces) for paces in self._all()), default=0
        )

    def left(self, begun: int, free: int) -> Left | None:
        """What is left, as far as that can be told.

        Args:
            begun: runs that workers have, or had.
            free: those that nobody has begun.
        """
        tiers = self._tiers()
        if not begun or not any(tier.episodes for tier in tiers):
            return None
        bound, lane_seconds, one = 0.0, 0.0, 0.0
        for number, (tier, each) in enumerate(zip(tiers, _by_episode(tiers), strict=True)):
            left = sum(pace.left for pace in tier.now)
            mean = (tier.lane_seconds + left * each) / begun
            one += mean
            lane_seconds += free * mean / max(tier.lanes, 1)
            for pace in tier.now:
                filled = pace.left / pace.lanes
                # Where runs are still to come, those that have begun make room for them one by one.
                bound += each * (filled if free and not number else max(filled, pace.longest))
        # The last run to begin takes its time, and has the block to itself in the end.
        return Left(bound, lane_seconds + (one / 2 if free else 0.0))

    def _all(self) -> Iterable[tuple[Pace, ...]]:
        return [*([self._past] if self._past else []), *self._now.values()]

    def _tiers(self) -> list[_Tier]:
        found: list[_Tier] = []
        columns = itertools.zip_longest(*self._all(), fillvalue=Pace(0))
        now = list(itertools.zip_longest(*self._now.values(), fillvalue=Pace(0)))
        for number, column in enumerate(columns):
            found.append(
                _Tier(
                    max(pace.lanes for pace in column),
                    sum(pace.lane_seconds for pace in column),
                    sum(pace.episodes for pace in column),
                    *self._recent.get(number, (0.0, 0.0)),
                    tuple(pace for pace in (now[number] if number < len(now) else ()) if pace.left),
                )
            )
        return found


def _by_episode(tiers: Sequence[_Tier]) -> list[float]:
    """Seconds that an episode of a lane in each tier takes, of which some will be in the next one."""
    here: list[float] = []
    for tier in tiers:
        if tier.recent_episodes >= 1.0:
            here.append(tier.recent_lane_seconds / tier.recent_episodes)
        elif tier.episodes:
            here.append(tier.lane_seconds / tier.episodes)
        else:
            here.append(SLOWER * here[-1] if here else 0.0)
    used = [bool(tier.episodes or tier.now) for tier in tiers]
    return [
        (1 - GROWS) * each + GROWS * later if goes_on else each
        for each, later, goes_on in zip(here, [*here[1:], 0.0], [*used[1:], False], strict=True)
    ]
