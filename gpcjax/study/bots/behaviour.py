"""How a scripted participant teaches: when a key goes down, for how long, and which one. Standard library only.

| behaviour         | model                                                                | numbers      |
|-------------------|----------------------------------------------------------------------|--------------|
| amount of advice  | part of the time with a key down, a logistic function of the episode | 48 runs [1]  |
| what it is about  | the expert's action at the step that was seen; silent within an eighth of the range | [1] |
| reaction time     | gamma distribution of shape 3, mean 0.4 s; of late ones 1 s          | [2], [3]     |
| attention         | Markov chain of two states, attending or not                         | ours         |
| wrong keys        | each advice by itself                                                | ours         |
| giving up         | the browser is closed in one of the runs, or the study is left       | ours         |

[1] Scholten et al. 2019 (arXiv 1903.06151), repository janscholten/ppmp; fitted by `benchmarks/advice.py`.
[2] Knox and Stone 2009, TAMER. [3] Warnell et al. 2018, Deep TAMER.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from typing import NamedTuple

LEVEL = (0.543, 0.203)
LOG_HALF = (3.089, 1.065)
LOG_WIDTH = (0.664, 1.346)
"""Mean and standard deviation over the 48 sessions: the part of an episode's steps with a key down at first, the
logarithm of the episode by which half of that is left, and that of the number of episodes over which it falls."""

LEVELS = (0.05, 0.95)
WIDTHS = (0.5, 25.0)
"""What the fit was kept within, or nearly so."""

SILENT = 0.25
"""Distance from the expert's action, in units of one that goes from -1 to 1, within which nothing is said."""

SHAPE = 3.0
"""Of the reaction time's gamma distribution."""

HOLD = 0.4
"""Mean seconds for which a key is held."""

Expert = Callable[[Sequence[float]], Sequence[float]]


@dataclass(frozen=True)
class Kind:
    """What sort of participant somebody is."""

    name: str
    share: float
    """Part of all participants."""
    reaction: float = 0.4
    """Mean seconds between a step and the key about it."""
    attends: float = 60.0
    away: float = 1.0
    """Mean seconds for which it looks at the task, and for which it does not."""
    hides: float = 0.0
    """Chance that the page is hidden when it looks away."""
    wrong: float = 0.05
    """Chance that an advice has the wrong sign."""
    gives_up: float = 0.0
    """Chance of giving up in one of its runs."""
    returns: float = 0.0
    """Chance that it comes back then, having closed the browser; of the others half say that they leave."""


KINDS = (
    Kind("attentive", 0.6),
    Kind("late", 0.15, reaction=1.0),
    Kind("inattentive", 0.15, attends=6.0, away=4.0, hides=0.3, wrong=0.1),
    Kind("giving up", 0.1, gives_up=1.0, returns=0.5),
)


def kind_of(number: int, seed: int, kinds: Sequence[Kind] = KINDS) -> Kind:
    """What the participant of this number (from 1) is: the shares are met as nearly as can be at every number.

    Each in its turn is the kind that is furthest behind its share; `seed` says who begins.
    """
    counts = [0.0] * len(kinds)
    total = sum(each.share for each in kinds)
    chosen = 0
    for place in range(1, number + 1):
        behind = [each.share / total * place - count for each, count in zip(kinds, counts, strict=True)]
        chosen = max(range(len(kinds)), key=lambda index: (behind[index], (index + seed) % len(kinds)))
        counts[chosen] += 1
    return kinds[chosen]


class Advice(NamedTuple):
    """A key that is to go down."""

    dim: int
    h: int
    n: int
    """The frame that it is about."""
    wait: float
    """Seconds until it goes down."""
    hold: float
    """Seconds for which it is held."""


class Teacher:
    """A participant in one run. The same draws come of the same `random`, whenever frames come.

    Args:
        kind: what sort of participant.
        random: of this run alone.
        expert: an observation -> the action that the task wants.
    """

    def __init__(self, kind: Kind, random: Random, expert: Expert):
        self._kind, self._random, self._expert = kind, random, expert
        self._level = min(max(random.gauss(*LEVEL), LEVELS[0]), LEVELS[1])
        self._half = math.exp(random.gauss(*LOG_HALF))
        self._width = min(max(math.exp(random.gauss(*LOG_WIDTH)), WIDTHS[0]), WIDTHS[1])
        self._next = 0.0
        self._attends, self._until = True, random.expovariate(1 / kind.attends)

    def rate(self, episode: int) -> float:
        """The part of an episode's time (from 0) for which a key would be down if there was always something to say."""
        return self._level / (1 + math.exp(min((episode + 1 - self._half) / self._width, 50.0)))

    def looks_away(self, now: float) -> float | None:
        """Seconds for which the page is hidden from now on; None while it is not.

        Args:
            now: seconds at the task.
        """
        while now >= self._until:
            self._attends = not self._attends
            mean = self._kind.attends if self._attends else self._kind.away
            self._until += (length := self._random.expovariate(1 / mean))
            if not self._attends and self._random.random() < self._kind.hides:
                self._attends, self._until = True, now + self._random.expovariate(1 / self._kind.attends)
                return length
        return None

    def sees(self, frame: dict, now: float) -> Advice | None:
        """The advice about a step, if it gives one.

        Args:
            frame: the message: `n`, `episode`, `obs`, `action`.
            now: seconds at the task.
        """
        if now < self._next or not self._attends:
            return None
        rate = self.rate(frame["episode"])
        if rate < 1e-3:
            return None
        wanted, action = self._expert(frame["obs"]), frame["action"]
        apart = [target - present for target, present in zip(wanted, action, strict=True)]
        dims = [dim for dim, each in enumerate(apart) if abs(each) > SILENT]
        if not dims:
            return None
        dim = self._random.choice(dims)
        h = 1 if apart[dim] > 0 else -1
        if self._random.random() < self._kind.wrong:
            h = -h
        wait = self._random.gammavariate(SHAPE, self._kind.reaction / SHAPE)
        hold = self._random.expovariate(1 / HOLD)
        idle = HOLD / rate - HOLD - self._kind.reaction
        pause = self._random.expovariate(1 / idle) if idle > 0 else 0.0
        self._next = now + wait + hold + pause
        return Advice(dim, h, frame["n"], wait, hold)
