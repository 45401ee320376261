"""How long a sweep will take, from what has been done and what programs usually cost. Loads no jax."""

import heapq
import math
from collections import deque
from collections.abc import Mapping, Sequence

from gpcjax.registry import find
from gpcjax.sweep import costs
from gpcjax.sweep.paces import Left
from gpcjax.sweep.works import AT_FIRST, Work, is_seen

End = tuple[float, int]
"""When a worker has done what it has, and the index of its program; -1 for none."""

PAYS = 1.5
"""A program that others run is joined where what is left of it takes so many times as long as to begin with it."""

KNOWN = 0.15
"""How far off the seconds of a program usually are, as a part of all, where it ran here before."""

UNLIKE = 0.1
"""How much farther, with each factor of e between the cells of then and now."""

LATE = 0.4
"""What has not ended yet takes as much longer than expected, as a part of the time since it began: what takes longer
than others took, or than was guessed, is found among what has not ended. Compilations took 1.1 to 1.8 times as long as
guessed: of a deviation of 0.4 of the logarithm, 0.42 of what was expected is left, on average, once it is over."""

LITTLE = 3.0
"""Seconds of usual programs that have to be seen until their speed counts as much for others as what was guessed: of a
program that has few steps it tells what others take beside theirs."""

MEASURED = 0.4
"""How far off what is left usually is by the pace so far, as a part of it."""


def least_to_join(work: Work) -> int:
    """Cells that nobody has yet of a program that others run, from which on a further worker joins them.

    With it what is left is done sooner, if that takes each of those who are there longer than it to begin.
    """
    if find("task", work.env).on_host:
        return 1  # its steps take longer than any compilation
    return max(math.ceil(PAYS * work.workers * work.joining / work.cell_seconds), 1)


def seconds_left(works: Sequence[Work], jobs: int) -> float:
    """Estimated seconds until all programs are done, by `jobs` workers.

    A program that has been seen for a while costs what it did so far, in seconds a step; another one what
    `costs` says, times what programs that were seen cost of it on this machine. Compilations are reckoned apart:
    they come first, and are much shorter where the programs come from the cache. Then workers go through what is left
    as `sharing` hands it out: a program each, and those who have no more join the one with most left.
    """
    if all(work.finished >= work.cells and not work.workers for work in works):
        return 0.0
    seen = [work for work in works if is_seen(work) and not work.before]
    usual, taken = (
        sum(each) for each in ((_usual(work) * work.done for work in seen), (work.seconds for work in seen))
    )
    speed = (taken + LITTLE * _guessed(works)) / (usual + LITTLE)
    bound, free, to_compile = {}, {}, {}
    """Seconds of each program: of cells that workers have, of cells that nobody has, and to begin with it."""
    compiling = _compiling(works)
    for index, work in enumerate(works):
        if work.finished >= work.cells:
            continue
        bound[index], free[index] = _left(work, speed)
        to_compile[index] = _to_begin(work, compiling)
    ends = _first_ends(works, compiling, bound)
    ends += [(0.0, -1)] * (jobs - len(ends))
    ready = max((work.ready_in for work in works), default=0.0)
    ends = [(max(when, ready), index) for when, index in ends]
    return _last_end(works, ends, free, to_compile, jobs)


def compiling_left(works: Sequence[Work], jobs: int) -> float:
    """Estimated seconds in which workers still compile, of those that are left: each has one program at a time."""
    compiling = _compiling(works)
    left = [
        max(
            _to_compile(work, compiling) - work.compile_seconds / max(work.joined, 1) - work.compiling_for,
            0.0,
        )
        for work in works
        if work.finished < work.cells and work.done < 0.9
    ]
    return max([0.0, *left, sum(left) / jobs])


def _first_ends(works: Sequence[Work], compiling: float, bound: Mapping[int, float]) -> list[End]:
    """When each worker has done what it has now, and where it is; `bound` is what each program's have in all."""
    ends: list[End] = []
    for index, work in enumerate(works):
        if not work.workers:
            continue
        stepping = work.workers - work.starting
        further = _further(work, compiling)
        if stepping or work.steps:  # it joined another
            compile_left = overdue(work.joining, work.compiling_for)
        else:
            compile_left = _to_begin(work, compiling) - work.compile_seconds / work.workers
            compile_left = overdue(compile_left, work.compiling_for)
        share = bound.get(index, 0.0) / (stepping or work.workers)
        ends += [(further + share, index)] * stepping
        ends += [(compile_left + (0.0 if stepping else share), index)] * work.starting
    return ends


def _last_end(
    works: Sequence[Work], ends: list[End], free: dict[int, float], to_compile: Mapping[int, float], jobs: int
) -> float:
    """When the last worker ends, as what is `free` of each program is handed out from these `ends` on."""
    last, at_first = 0.0, dict(free)
    taken = {index for _, index in ends if index >= 0}
    fresh = deque(each for each in free if each not in taken)
    cells = {
        each: works[each].cells - works[each].begun if seconds else 0.0 for each, seconds in free.items()
    }
    least = {each: least_to_join(works[each]) for each in free}
    shared = [(-number, each) for each, number in cells.items()]
    """The programs by their cells, the most first; those whose cells have become fewer since are there again."""
    heapq.heapify(shared)
    heapq.heapify(ends)
    while ends:
        now, index = heapq.heappop(ends)
        last = max(last, now)
        if free.get(index, 0.0) > 0:  # a part of what is left of its program, in several takings
            some = min(free[index], max(free[index] / (2 * jobs), 0.05))
            free[index] -= some
            whole = works[index].cells - works[index].begun
            cells[index] = whole * free[index] / at_first[index] if free[index] else 0.0
            heapq.heappush(shared, (-cells[index], index))
            heapq.heappush(ends, (now + some, index))
            continue
        joins = not fresh
        if fresh:
            index = fresh.popleft()
        else:
            while shared and (-shared[0][0] != cells[shared[0][1]] or -shared[0][0] < least[shared[0][1]]):
                heapq.heappop(shared)
            if not shared:
                continue
            index = shared[0][1]
        heapq.heappush(ends, (now + (works[index].joining if joins else to_compile[index]), index))
    return last


def overdue(expected: float, elapsed: float) -> float:
    """Seconds until the end of what was expected to take so long, and has not ended yet."""
    return max(expected - elapsed, 0.0) + LATE * elapsed


def _guessed(works: Sequence[Work]) -> float:
    """How much longer than in `costs` all takes, as long as nothing of it has been seen here."""
    return max((work.slowness * work.machine for work in works), default=1.0)


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
        others = work.seconds - work.paces.seconds - AT_FIRST * work.joined
        beside = 1.0 + max(others, 0.0) / max(work.paces.seconds, 1e-9)
        by_pace = Left(beside * by_pace.bound, beside * by_pace.free)
    seconds = sum(by_pace)
    if not work.before or not seconds:
        return by_pace
    # An expectation that has been wrong so far is not to be trusted either.
    odd = abs(math.log(work.seconds / (whole * work.done)))
    unlike = abs(math.log(work.before.cells / work.cells))
    expected, measured = KNOWN + UNLIKE * unlike + odd * work.done, MEASURED * (1 - work.done)
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
    compiled = (work.paces.compiled or costs.tiers(work.algo, work.episodes) for work in begun)
    usual = sum(
        costs.compiling(work.algo, tiers) * (work.joined - work.starting)
        for work, tiers in zip(begun, compiled, strict=True)
    )
    if not usual:
        return _guessed(works)
    return sum(work.compile_seconds for work in begun) / usual


def _to_compile(work: Work, compiling: float) -> float:
    """Seconds until a worker has all that it needs of a program."""
    return work.usual_compiling * (work.slowness if work.before else compiling)


def _to_begin(work: Work, compiling: float) -> float:
    """The same, and what else comes before its blocks; where it ran here before, its cells' seconds have that."""
    return _to_compile(work, compiling) + (0.0 if work.before else AT_FIRST * compiling)


def _further(work: Work, compiling: float) -> float:
    """Seconds until a worker that steps has the programs of larger tiers too."""
    if not work.paces.compiled:
        return 0.0
    if work.before:
        anew = work.paces.compiled + work.paces.waiting - work.before.tiers
        if anew <= 0:  # all of them are kept
            spent = work.compile_seconds / max(work.joined, 1) + work.compiling_for
            return max(_to_compile(work, compiling) - spent, 0.0)
        tiers = float(anew)
    else:  # runs that get so far come with time
        expected = (costs.tiers(work.algo, work.episodes) - work.paces.compiled) * (1 - work.done)
        tiers = max(expected, work.paces.waiting)
    return overdue(tiers * costs.further(work.algo) * compiling, work.compiling_for) if tiers > 0 else 0.0
