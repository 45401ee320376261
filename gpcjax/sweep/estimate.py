"""How long a sweep will take, from what has been done and what programs usually cost. Loads no jax."""

import heapq
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gpcjax.registry import find
from gpcjax.sweep import costs
from gpcjax.sweep.experience import LEAST_DONE, Cost
from gpcjax.sweep.paces import Left, Paces
from gpcjax.sweep.plan import Program

JOIN = 48
"""A program that another worker already runs must have this many cells left to be worth compiling a second time."""

KNOWN = 0.15
"""How far off the seconds of a program usually are, as a part of all, where it ran here before."""

LATE = 0.25
"""What is late takes as much longer, as a part of the time since it began."""

MEASURED = 0.4
"""How far off what is left usually is by the pace so far, as a part of it."""


@dataclass
class Work:
    """The cells of one program: what has been done for them, by all workers, and what is still to do."""

    env: str
    algo: str
    cells: int
    episodes: int
    """Of each cell."""
    oracle: str = ""
    """Whose targets may cost more than a step."""
    begun: int = 0
    """Cells that were handed to workers."""
    finished: int = 0
    finished_steps: int = 0
    """Steps of the finished cells."""
    finished_episodes: int = 0
    """Episodes of the finished cells: fewer than they might have had, where runs stopped."""
    steps: int = 0
    done_episodes: int = 0
    seconds: float = 0.0
    """That workers have spent on it, compilations left out."""
    compile_seconds: float = 0.0
    workers: int = 0
    """Workers that are at it now."""
    starting: int = 0
    """Those of them that have not made a step yet."""
    joined: int = 0
    """Workers that have been at it: each compiles for itself."""
    recent_steps: float = 0.0
    recent_episodes: float = 0.0
    """Of the last seconds: what an episode takes by now, where learners live longer and longer."""
    before: Cost | None = None
    """What the program took when it ran here the last time, of a core that does nothing else."""
    paces: Paces = field(default_factory=Paces)
    """How fast its workers are."""
    heard_seconds: float = 0.0
    """Between words of its workers, compilations among them."""
    processor_seconds: float = 0.0
    """That these workers had of a core meanwhile."""
    slowness: float = 1.0
    """Seconds that a second of a core takes by now: more than one where others are on it."""
    ready_in: float = 0.0
    """Seconds until the workers are there at all."""
    compiling_for: float = 0.0
    """Seconds that a worker has been compiling by now."""

    def add(self, steps: int, episodes: int, compile_seconds: float) -> None:
        """Take in what a worker has done since it was last heard."""
        self.steps += steps
        self.done_episodes += episodes
        self.compile_seconds += compile_seconds
        self.recent_steps = 0.9 * self.recent_steps + steps
        self.recent_episodes = 0.9 * self.recent_episodes + episodes

    def _steps_left(self) -> tuple[float, float]:
        """Expected steps of the runs that are under way, and of those that are not begun.

        Runs that are over are no sample of those that are not: on tasks where one falls early, the short ones come
        first. So the runs that are under way go on as they do now, and those not begun are like all the others.
        """
        if self.finished >= self.cells:
            return 0.0, 0.0
        running = max(self.begun - self.finished, 0)
        episodes = max(self.done_episodes - self.finished_episodes, 0)
        steps = max(self.steps - self.finished_steps, 0)
        recent = self.recent_steps / self.recent_episodes if self.recent_episodes > 0.5 else 0.0
        length = max(recent, steps / episodes if episodes else 0.0)
        if not length:
            length = self.steps / max(self.done_episodes, 1)
        of_running = length * max(running * self.episodes - episodes, 0)
        known = self.finished + running
        each = (self.finished_steps + steps + of_running) / known if known else 0.0
        return of_running, each * (self.cells - known)

    @property
    def usual_episode(self) -> float:
        """Seconds of an episode, as far as that is known before one was seen."""
        return self.before.episode if self.before else costs.of_episode(self.env, self.algo, self.oracle)

    @property
    def usual_compiling(self) -> float:
        """Seconds until a worker has the program, likewise."""
        return self.before.compiling if self.before else costs.compiling(self.algo) * costs.tiers(self.algo)

    @property
    def took(self) -> Cost | None:
        """What the program took of a core; None if too little of it was done to tell."""
        if self.done < LEAST_DONE or not self.done_episodes or not self.joined:
            return None
        share = min(self.processor_seconds / self.heard_seconds, 1.0) if self.heard_seconds > 1.0 else 1.0
        return Cost(share * self.seconds / self.done_episodes, share * self.compile_seconds / self.joined)

    @property
    def steps_left(self) -> float:
        """Expected steps of all that is not done."""
        return sum(self._steps_left())

    @property
    def steps_free(self) -> float:
        """Those of cells that no worker has."""
        return self._steps_left()[1]

    @property
    def done(self) -> float:
        """Share of its steps that are done, from 0 to 1; a program without steps has none."""
        return self.steps / (self.steps + self.steps_left) if self.steps else 0.0


def works_of(sizes: Mapping[Program, int], before: Mapping[Program, Cost] = {}) -> dict[Program, Work]:
    """The programs with so many cells each, in their order, with nothing done yet; and what some took `before`."""
    return {
        key: Work(key.env, key.algo, cells, key.episodes, key.oracle, before=before.get(key))
        for key, cells in sizes.items()
    }


def least_to_join(env: str) -> int:
    """Cells that must be left of a program of this task for a further worker to compile it too.

    Where the host simulates, one is enough: its steps take longer than any compilation.
    """
    return 1 if find("task", env).on_host else JOIN


def seconds_left(works: Sequence[Work], jobs: int) -> float:
    """Estimated seconds until all programs are done, by `jobs` workers.

    A program that has been seen for a while costs what it did so far, in seconds a step; another one what
    `costs` says, times what programs that were seen cost of it on this machine. Compilations are reckoned apart:
    they come first, and are much shorter where the programs come from the cache. Then workers go through what is left
    as `sharing` hands it out: a program each, and those who have no more join the one with most left.
    """
    if all(work.finished >= work.cells and not work.workers for work in works):
        return 0.0
    seen = [work for work in works if is_seen(work)]
    usual = sum(_usual(work) * work.done for work in seen)
    speed = sum(work.seconds for work in seen) / usual if usual else max(work.slowness for work in works)
    bound, free, to_compile = {}, {}, {}
    """Seconds of each program: of cells that workers have, of cells that nobody has, and to begin with it."""
    compiling = _compiling(works)
    for index, work in enumerate(works):
        if work.finished >= work.cells:
            continue
        bound[index], free[index] = _left(work, speed)
        to_compile[index] = _to_compile(work, compiling)
    at = [index for index, work in enumerate(works) for _ in range(work.workers)]
    ends = []
    """When each worker has done what it has now, and where it is."""
    for index, same in itertools.groupby(at):
        work, stepping = works[index], works[index].workers - works[index].starting
        further = _further(work, compiling)
        if stepping or work.steps:  # it joined another; since when is not known
            compile_left = _to_compile(work, compiling) / 2
        else:
            compile_left = _to_compile(work, compiling) - work.compile_seconds / work.workers
            compile_left = overdue(compile_left, work.compiling_for)
        for number, _ in enumerate(same):
            if number < stepping:
                ends.append((further + bound.get(index, 0.0) / stepping, index))
            else:
                ends.append(
                    (compile_left + (0.0 if stepping else bound.get(index, 0.0) / work.workers), index)
                )
    ends += [(0.0, -1)] * (jobs - len(ends))
    ready = max((work.ready_in for work in works), default=0.0)
    ends = [(max(when, ready), index) for when, index in ends]
    last, taken, at_first = 0.0, set(at), dict(free)
    heapq.heapify(ends)
    while ends:
        now, index = heapq.heappop(ends)
        last = max(last, now)
        if free.get(index, 0.0) > 0:  # a part of what is left of its program, in several takings
            some = min(free[index], max(free[index] / (2 * jobs), 0.05))
            free[index] -= some
            heapq.heappush(ends, (now + some, index))
            continue
        fresh = [each for each in free if each not in taken]
        least = {each: least_to_join(works[each].env) for each in free}
        cells = {
            each: (works[each].cells - works[each].begun) * seconds / at_first[each] if seconds else 0.0
            for each, seconds in free.items()
        }
        shared = [each for each in free if cells[each] >= least[each]]
        if fresh or shared:
            index = fresh[0] if fresh else max(shared, key=lambda each: cells[each])
            taken.add(index)
            # Who joins late hardly gets to the larger tiers.
            told = works[index].paces.compiled or not works[index].steps
            tiers = costs.tiers(works[index].algo) if told and not fresh else 1
            heapq.heappush(ends, (now + to_compile[index] / tiers, index))
    return last


def overdue(expected: float, elapsed: float) -> float:
    """Seconds until the end of what was expected to take so long, and has not ended yet."""
    return max(expected - elapsed, LATE * elapsed)


def is_seen(work: Work) -> bool:
    """Whether its own speed can be told."""
    return work.done > 0.02 and work.seconds > 0.5


def _usual(work: Work) -> float:
    return work.cells * work.episodes * work.usual_episode


def _expected(work: Work, speed: float) -> float:
    """Seconds of the whole program: as it was before, or as such programs usually are, at this `speed`."""
    return _usual(work) * (work.slowness if work.before else speed)


def _left(work: Work, speed: float) -> Left:
    """What is left of a program: by its pace so far, and by what was expected, as far as either is to be trusted.

    The pace tells little at first, as runs that have begun are no sample of those that have not, and all in the end.
    """
    whole = _expected(work, speed)
    if not is_seen(work):
        return _shared(work, whole * (1 - work.done))
    by_pace = work.paces.left(work.begun, work.cells - work.begun)
    if by_pace is None:
        by_pace = _shared(work, work.seconds * (1 - work.done) / work.done)
    else:  # beside its blocks a worker takes lanes out, and hands in rows
        beside = max(work.seconds / max(work.paces.seconds, 1e-9), 1.0)
        by_pace = Left(beside * by_pace.bound, beside * by_pace.free)
    seconds = sum(by_pace)
    if not work.before or not seconds:
        return by_pace
    # An expectation that has been wrong so far is not to be trusted either.
    odd = abs(math.log(work.seconds / (whole * work.done)))
    expected, measured = KNOWN + odd * work.done / 2, MEASURED * (1 - work.done)
    trust = expected**2 / (expected**2 + measured**2)
    both = trust * seconds + (1 - trust) * max(whole - work.seconds, 0.0)
    return Left(by_pace.bound * both / seconds, by_pace.free * both / seconds)


def _shared(work: Work, seconds: float) -> Left:
    """As the steps of runs that are under way are to those that are not begun.

    All may be stepped, and its rows not here yet: those of a worker that was lost are made again.
    """
    free = work.steps_free / work.steps_left if work.steps and work.steps_left else 1.0
    return Left(seconds * (1 - free), seconds * free)


def _compiling(works: Sequence[Work]) -> float:
    """How much longer compilations take than those in the table, where programs did not run here before."""
    begun = [work for work in works if work.steps and not work.before]
    compiled = (work.paces.compiled or costs.tiers(work.algo) for work in begun)
    usual = sum(
        costs.compiling(work.algo) * tiers * work.joined for work, tiers in zip(begun, compiled, strict=True)
    )
    if not usual:
        return max(work.slowness for work in works)
    return sum(work.compile_seconds for work in begun) / usual


def _to_compile(work: Work, compiling: float) -> float:
    """Seconds until a worker has all that it needs of a program."""
    return work.usual_compiling * (work.slowness if work.before else compiling)


def _further(work: Work, compiling: float) -> float:
    """Seconds until a worker that steps has the programs of larger tiers too."""
    if work.before:
        spent = work.compile_seconds / max(work.joined, 1) + work.compiling_for
        return max(_to_compile(work, compiling) - spent, 0.0)
    if not work.paces.compiled:
        return 0.0
    # Runs that get so far come with time.
    expected = (costs.tiers(work.algo) - work.paces.compiled) * (1 - work.done)
    tiers = max(expected, work.paces.waiting)
    return overdue(tiers * costs.compiling(work.algo) * compiling, work.compiling_for) if tiers > 0 else 0.0
