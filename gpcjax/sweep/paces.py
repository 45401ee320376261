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


FIRST = 4.0
"""Episodes for which that guess counts beside those that were seen."""


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
    share: float
    """Part of the lanes that outgrow it."""
    then_left: float
    """Episodes that these have to do then."""


class _Stay(NamedTuple):
    """What the lanes of one worker will do in a tier, or from there on."""

    runs: float
    episodes: float
    longest: float
    """Most episodes of one of them."""


_NONE = _Stay(0.0, 0.0, 0.0)


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
            one.plus(other) for one, other in itertools.zip_longest(self._past, paces, fillvalue=Pace(0))
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
        """Tiers that no worker has compiled and that runs wait for, or are on their way to."""
        tiers = self._tiers()
        return max(
            (
                sum(
                    stay.runs >= 0.5 and not tier.lane_seconds
                    for stay, tier in zip(stays, tiers, strict=True)
                )
                for stays in self._stays(tiers)
            ),
            default=0,
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
        each, episodes, bound = _by_episode(tiers), [0.0] * len(tiers), 0.0
        for stays in self._stays(tiers):
            for number, (tier, stay) in enumerate(zip(tiers, stays, strict=True)):
                episodes[number] += stay.episodes
                filled = stay.episodes / max(tier.lanes, 1)
                # Where runs are still to come, those that have begun make room for them one by one.
                bound += each[number] * (filled if free and not number else max(filled, stay.longest))
        means = [
            (tier.lane_seconds + here * seconds) / begun
            for tier, here, seconds in zip(tiers, episodes, each, strict=True)
        ]
        lane_seconds = sum(free * mean / max(tier.lanes, 1) for mean, tier in zip(means, tiers, strict=True))
        # The last run to begin takes its time, and has the block to itself in the end.
        return Left(bound, lane_seconds + (sum(means) / 2 if free else 0.0))

    def _all(self) -> Iterable[tuple[Pace, ...]]:
        return [*([self._past] if self._past else []), *self._now.values()]

    def _stays(self, tiers: Sequence[_Tier]) -> Iterable[list[_Stay]]:
        """For each worker that is at it, what its lanes will do in each of the tiers."""
        for paces in self._now.values():
            stays, coming, filled = [], _NONE, itertools.chain(paces, itertools.repeat(Pace(0)))
            for tier, pace in zip(tiers, filled, strict=False):
                stay, coming = _through(tier, pace, coming, last=tier is tiers[-1])
                stays.append(stay)
            yield stays

    def _tiers(self) -> list[_Tier]:
        found: list[_Tier] = []
        for number, column in enumerate(itertools.zip_longest(*self._all(), fillvalue=Pace(0))):
            outgrown, settled = sum(pace.outgrown for pace in column), sum(pace.settled for pace in column)
            gone = outgrown + sum(pace.ended for pace in column) + settled
            found.append(
                _Tier(
                    max(pace.lanes for pace in column),
                    sum(pace.lane_seconds for pace in column),
                    sum(pace.episodes for pace in column),
                    *self._recent.get(number, (0.0, 0.0)),
                    outgrown / max(gone, 1),
                    sum(pace.then_left for pace in column) / max(outgrown, 1),
                )
            )
        return found


def _through(tier: _Tier, pace: Pace, coming: _Stay, last: bool) -> tuple[_Stay, _Stay]:
    """What lanes that are in a tier, and those `coming` from the one before, will do there and beyond."""
    runs, episodes = pace.runs + coming.runs, pace.left + coming.episodes
    longest = max(pace.longest, coming.longest)
    if last or not runs:
        return _Stay(runs, episodes, longest), _NONE
    goes_on = tier.share * (pace.runs - pace.settled + coming.runs)
    then = goes_on * min(tier.then_left, episodes / runs)
    then_longest = min(tier.then_left, longest) if goes_on >= 0.5 else 0.0
    return _Stay(runs, episodes - then, longest - then_longest), _Stay(goes_on, then, then_longest)


def _by_episode(tiers: Sequence[_Tier]) -> list[float]:
    """Seconds that an episode of a lane takes in each tier."""
    here: list[float] = []
    for tier in tiers:
        guess = SLOWER * here[-1] if here else 0.0
        if tier.recent_episodes >= 1.0:
            seconds, episodes = tier.recent_lane_seconds, tier.recent_episodes
        else:
            seconds, episodes = tier.lane_seconds, float(tier.episodes)
        # The first to end in a tier say little: all its lanes were at work until then.
        weight = FIRST if guess else 0.0
        here.append((weight * guess + seconds) / (weight + episodes) if weight + episodes else 0.0)
    return here
