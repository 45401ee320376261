"""The estimate of the time that is left, on histories of uneven sweeps; and what is shown, and where."""

import contextlib
import io
import json
import random
import re
from collections import Counter
from dataclasses import replace

import pytest

from gpcjax.engine.pace import Pace
from gpcjax.envs.registry import env_names, expert_names
from gpcjax.registry import names
from gpcjax.sweep import costs, estimate, experience, telling
from gpcjax.sweep.crowd import AT_START, MOST, USUAL_PIECE, Crowd
from gpcjax.sweep.estimate import LATE, LITTLE, compiling_left, least_to_join, overdue, seconds_left
from gpcjax.sweep.experience import FROM_CACHE, Cost
from gpcjax.sweep.jsonlines import JsonLines
from gpcjax.sweep.paces import FIRST, SLOWER, Paces
from gpcjax.sweep.plan import plan, program_of
from gpcjax.sweep.progress import LINE_SECONDS, Bar
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.telling import State, Told
from gpcjax.sweep.works import AT_FIRST, Work, works_of

TICK = 0.25


class History:
    """A sweep in which `jobs` workers go through programs one after the other, joining the largest in the end.

    Args:
        programs: (env, algo, cells, episodes, seconds of a step, first and last length of an episode, compile seconds).
            An episode's length grows from the first to the last; each run does so at a pace of its own.
        machine: how much slower than where the table of the module was measured, by the imports of its workers.
    """

    def __init__(self, programs, jobs, machine=1.0, width=32, seed=0):
        self.random, self.jobs, self.width = random.Random(seed), jobs, width
        self.works = [
            Work(env, algo, cells, episodes, machine=machine) for env, algo, cells, episodes, *_ in programs
        ]
        self.programs = programs
        self.states = []
        """(seconds, copies of the works) at every tick."""
        self._run()

    def _run(self):
        now, left = 0.0, [work.cells for work in self.works]
        workers = [self._worker(index, left) for index in range(self.jobs)]
        while workers:
            now += TICK
            workers = [worker for worker in workers if next(worker, "over") != "over"]
            self.states.append((now, [replace(work) for work in self.works]))

    def _worker(self, index, left):
        taken = self.__dict__.setdefault("taken", set())
        while True:
            free = [i for i, cells in enumerate(left) if cells and i not in taken]
            shared = [i for i, cells in enumerate(left) if cells >= least_to_join(self.works[i])]
            if not free and not shared:
                return
            at = free[0] if free else max(shared, key=lambda i: left[i])
            taken.add(at)
            yield from self._program(at, left)

    def _program(self, at, left):
        work, (*_, each, first, last, compiling) = self.works[at], self.programs[at]
        work.workers += 1
        work.starting += 1
        work.joined += 1
        most = -(-work.cells // self.jobs) if work.env == "lunarlander" else work.cells
        compiling *= FROM_CACHE if work.steps else 1.0
        for tick in range(int(compiling / TICK)):
            work.compiling_for = tick * TICK
            yield
        work.compiling_for = 0.0
        work.add(0, 0, compiling)
        work.starting -= 1
        runs = []  # (pace, episode, steps of it)
        budget = 0.0
        while True:
            while len(runs) < self.width and left[at] and most:
                left[at] -= 1
                most -= 1
                work.begun += 1
                runs.append([self.random.uniform(0.5, 1.5), 0, 0.0, 0.0])
            if not runs:
                break
            # A block takes as long with few runs in it as with many.
            steps_each = TICK / each / max(len(runs), self.width / 4)
            steps = episodes = 0
            for run in runs:
                run[2] += steps_each
                run[3] += steps_each
                steps += steps_each
                while run[1] < work.episodes and run[2] >= (
                    length := self._length(run, first, last, work.episodes)
                ):
                    run[2] -= length
                    run[1] += 1
                    episodes += 1
            work.add(round(steps), episodes, 0.0)
            work.seconds += TICK
            for run in [run for run in runs if run[1] >= work.episodes]:
                runs.remove(run)
                work.finished += 1
                work.finished_steps += round(run[3])
                work.finished_episodes += work.episodes
            yield budget
        work.workers -= 1

    @staticmethod
    def _length(run, first, last, episodes):
        return min(last, first + (last - first) * run[0] * run[1] / (episodes / 3))


CARTPOLE = (
    ("cartpole", "gpc", 300, 30, 1 / 6.4e6, 20, 2500, 5.5),
    ("cartpole", "gpc-ns", 300, 30, 1 / 1.15e6, 20, 1600, 7.0),
    ("cartpole", "coach", 300, 30, 1 / 9e6, 20, 800, 2.7),
)
PENDULUM = (
    ("pendulum", "gpc", 300, 40, 1 / 1.6e6, 200, 200, 6),
    ("pendulum", "gpc-ns", 300, 40, 1 / 3.2e5, 200, 200, 9),
    ("pendulum", "coach", 300, 40, 1 / 6e6, 200, 200, 2.7),
)
LANDER = (
    ("lunarlander", "gpc", 20, 200, 1 / 2.3e4, 150, 350, 20),
    ("lunarlander", "coach", 20, 200, 1 / 4e4, 150, 350, 5),
)


def slower(programs, factor):
    return tuple((*p[:4], p[4] * factor, *p[5:7], p[7] * factor) for p in programs)


def cached(programs):
    return tuple((*p[:7], 0.5) for p in programs)


@pytest.mark.parametrize("jobs", [1, 2, 4])
@pytest.mark.parametrize(
    ("programs", "machine"),
    [
        (CARTPOLE, 1),
        (cached(CARTPOLE), 1),
        (slower(CARTPOLE, 3), 3),
        (slower(cached(PENDULUM), 5), 5),
        (LANDER, 1),
    ],
    ids=["cartpole", "cartpole, cached", "cartpole, slow", "pendulum, slow and cached", "lander"],
)
def test_from_the_first_third_on_the_time_left_is_right_within_a_quarter_of_the_whole(
    programs, machine, jobs, monkeypatch
):
    monkeypatch.setattr(costs, "_TIERS", {})  # such a history has one
    states = History(programs, jobs, machine).states
    total = states[-1][0]
    errors = [
        abs(seconds_left(works, jobs) - (total - now)) / total
        for now, works in states
        if total / 3 < now < 0.97 * total
    ]
    assert max(errors) < (
        0.25 if jobs < 4 else 0.3
    )  # with more workers than programs, the last ones compile for little


def test_at_the_end_nothing_is_left_and_before_the_beginning_something():
    states = History(CARTPOLE, 2).states
    assert seconds_left(states[-1][1], 2) == 0
    assert seconds_left([Work(*program[:4]) for program in CARTPOLE], 2) > 1


def test_more_workers_are_sooner_done_but_not_than_the_longest_program():
    works = [Work(*program[:4]) for program in slower(CARTPOLE, 1)]
    one, two, many = (seconds_left(works, jobs) for jobs in (1, 2, 64))
    assert one > 1.2 * two and two >= many > 9.0


def test_the_runs_that_fell_early_are_no_sample_of_those_that_stand():
    work = Work("cartpole", "coach", cells=64, episodes=10, begun=64, finished=20)
    work.finished_steps, work.finished_episodes = 20 * 10 * 30, 200
    work.steps, work.done_episodes = work.finished_steps + 44 * 5 * 2000, 200 + 44 * 5
    work.recent_steps, work.recent_episodes = 4e5, 200
    assert work.steps_left == pytest.approx(44 * 5 * 2000)


def test_runs_that_stopped_are_over():
    work = Work("cartpole", "gpc", cells=4, episodes=10, begun=4, finished=4, finished_steps=50, steps=50)
    assert work.steps_left == 0 and work.done == 1.0 and seconds_left([work], 1) == 0


def test_all_is_stepped_and_its_rows_are_not_here_yet():
    """A worker that was lost had done all of them."""
    work = Work("mountaincar", "coach", cells=1, episodes=2, begun=1, steps=400, done_episodes=2, seconds=1.0)
    assert work.steps_left == 0
    for workers in (0, 1):
        work.workers = workers
        assert 0 <= seconds_left([work], 1) < 60


class TestPaces:
    """What is left by tiers: two lanes to a block, an episode takes a second there, and three in the next tier."""

    PACES = (
        Pace(2, seconds=6.0, lane_seconds=12.0, episodes=12, left=4, longest=2),
        Pace(2, seconds=3.0, lane_seconds=3.0, episodes=1, left=3, longest=3),
    )

    LATER = (FIRST * SLOWER + 3.0) / (FIRST + 1)
    """Of a lane's episode in the second tier: one that took three seconds, and the guess."""

    def test_those_in_larger_tiers_take_longer(self):
        paces = Paces()
        assert paces.left(begun=5, free=0) is None
        paces.take(0, self.PACES)
        # Two episodes of two lanes side by side, some of them in the next tier, and three of a lane that has its
        # block alone.
        assert paces.left(begun=5, free=0) == (pytest.approx(2.0 + 3 * self.LATER), 0.0)
        assert paces.seconds == 9.0

    def test_runs_to_come_are_like_those_that_have_begun(self):
        paces = Paces()
        paces.take(0, self.PACES)
        bound, free = paces.left(begun=4, free=4)
        lanes = (12.0 + 4.0) / 4, (3.0 + 3 * self.LATER) / 4
        assert bound == pytest.approx(2.0 + 3 * self.LATER)
        assert free == pytest.approx(sum(4 * each / 2 for each in lanes) + sum(lanes) / 2)

    def test_a_tier_that_has_not_run_yet_is_slower_than_the_one_before(self):
        paces = Paces()
        paces.take(0, (self.PACES[0], Pace(2, left=1, longest=1)))
        assert paces.left(begun=4, free=0) == (pytest.approx(2.0 + SLOWER), 0.0)

    def test_runs_outgrow_a_tier_where_others_did(self):
        """Three of four went on with five episodes to do; of those that are there two may still, one is past it."""
        first = Pace(2, seconds=6.0, lane_seconds=12.0, episodes=12).with_left([9, 8])
        first = first._replace(outgrown=3, then_left=15, ended=1).with_left([9, 8, 2])
        assert first.settled == 1
        paces = Paces()
        paces.take(0, (first, Pace(2, seconds=3.0, lane_seconds=3.0, episodes=1)))
        # Three of five do go on: of two 1.2 lanes, with five episodes each; the longest run does four before.
        later = 1.2 * 5.0
        expected = (19.0 - later) / 2 * 1.0 + 5.0 * self.LATER
        assert paces.left(begun=8, free=0) == (pytest.approx(expected), 0.0)
        assert paces.waiting == 0
        paces.take(0, (first, Pace(2)))
        assert paces.waiting == 1
        paces.take(1, (first, Pace(2, seconds=3.0, lane_seconds=3.0, episodes=1)))
        assert paces.waiting == 0, "another worker has it: it is read"

    def test_what_was_done_adds_up(self):
        one = Pace(2, 1.0, 2.0, 3, outgrown=1, then_left=4, ended=2).with_left([5, 1])
        both = one.plus(one)
        assert both == Pace(2, 2.0, 4.0, 6, outgrown=2, then_left=8, ended=4)
        assert one.since(Pace(2)) == one and one.settled == 1

    def test_who_leaves_takes_nothing_along(self):
        paces = Paces()
        paces.take(0, self.PACES)
        paces.take(1, self.PACES)
        paces.leave(1)
        later = (FIRST * SLOWER + 1.9 * 3.0) / (FIRST + 1.9)  # what was said before counts a tenth less
        assert paces.seconds == 18.0 and paces.left(begun=10, free=0) == pytest.approx((2.0 + 3 * later, 0.0))

    def test_what_was_expected_counts_until_the_pace_is_known(self):
        """A program that took 30 s the last time, of which the first quarter came in 2 s: its later runs are longer."""
        work = Work("cartpole", "gpc", 40, 10, begun=10, finished=10, joined=1, workers=1)
        work.before = Cost(30.0 / 400, 0.0, 40, 1)
        work.finished_steps = work.steps = 1000
        work.finished_episodes = work.done_episodes = 100
        by_pace = replace(work, before=None, seconds=2.0)
        work.seconds = 2.0
        assert seconds_left([by_pace], 1) == pytest.approx(6.0)
        assert 10.0 < seconds_left([work], 1) < 28.0
        # A machine that others use as well takes longer.
        assert seconds_left([replace(work, slowness=3.0)], 1) > 1.3 * seconds_left([work], 1)

    def test_a_tier_that_a_known_program_never_had_is_compiled_anew(self):
        """The last time no run got so far; now some wait for it."""
        work = Work("cartpole", "gpc", 8, 10, begun=8, joined=1, workers=1, compile_seconds=1.0, seconds=2.0)
        work.steps, work.done_episodes, work.machine = 1000, 40, 2.0
        work.paces.take(
            0, (Pace(8, seconds=1.5, lane_seconds=12.0, episodes=40), Pace(8, left=9, longest=5, runs=2))
        )
        new, known = (replace(work, before=Cost(0.1, 1.0, 8, 1, tiers)) for tiers in (1, 2))
        whole = seconds_left([known], 1)
        assert seconds_left([new], 1) == pytest.approx(whole + 2.0 * costs.further("gpc"))
        new.compiling_for = 3.0
        assert seconds_left([new], 1) == pytest.approx(whole + 2.0 * costs.further("gpc") - 3.0 + 3.0 * LATE)


def test_further_tiers_take_their_part_of_the_first():
    assert costs.further("gpc") == costs.compiling("gpc") == costs.compiling("gpc", 2) / 2
    one, half = costs.compiling("gpc-ns"), costs.further("gpc-ns")
    assert half == one / 2 and costs.compiling("gpc-ns", 3) == 2 * one


def test_what_was_compiled_tells_how_long_the_others_take():
    """Both tiers of the one took three times as long as in the table: the other one will, and its blocks may not."""
    first = Work("cartpole", "gpc-ns", 8, 10, begun=8, finished=8, joined=1, compile_seconds=3.0 * 1.5 * 7.5)
    first.steps = first.finished_steps = 1000
    first.done_episodes = first.finished_episodes = 80
    first.paces.take(0, (Pace(1, 1.0, 1.0, 40), Pace(1, 1.0, 1.0, 40)))
    other = Work("cartpole", "coach", 10, 10)
    blocks = 10 * 10 * costs.of_episode("cartpole", "coach", "")
    expected = 3.0 * (costs.compiling("coach") + AT_FIRST) + blocks
    assert seconds_left([first, other], 1) == pytest.approx(expected)


def test_workers_are_there_after_a_while():
    works = [Work("cartpole", "coach", 100, 30, ready_in=5.0)]
    assert seconds_left(works, 2) == pytest.approx(5.0 + seconds_left([replace(works[0], ready_in=0.0)], 2))
    assert overdue(4.0, 0.0) == 4.0
    assert overdue(4.0, 1.0) == 3.0 + LATE and overdue(4.0, 20.0) == 20.0 * LATE, "the later, the longer"


def test_who_else_wants_a_core():
    crowd = Crowd()
    assert crowd.slowness == crowd.machine == 1.0
    crowd.begin(10.4 * AT_START, 2.6, 2 * USUAL_PIECE)
    assert crowd.slowness == pytest.approx(4.0) and crowd.machine == pytest.approx(2.0)
    assert crowd.late(1.0, 2.0) == pytest.approx(4.0) == crowd.late(9.0, 0.0)
    assert crowd.late(15.0 * AT_START, 2.0) == 7.5 and crowd.late(900.0, 2.0) == MOST
    for _ in range(200):
        crowd.take(1.0, 1.1)  # a compilation has several threads
    assert crowd.slowness == 1.0 and crowd.machine == pytest.approx(2.0)


def test_a_slow_machine_takes_longer_for_what_was_not_seen_here():
    works = [Work("cartpole", "gpc", 100, 30)]
    slow = seconds_left([replace(works[0], machine=2.0, slowness=3.0)], 2)
    assert slow == pytest.approx(6.0 * seconds_left(works, 2))
    known = replace(works[0], before=Cost(0.1, 1.0, 100, 1))
    assert seconds_left([replace(known, machine=2.0)], 2) == seconds_left([known], 2)


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def seen(finished=3, steps=50_000):
    work = Work("cartpole", "gpc", 10, 30, begun=10, finished=finished, steps=steps, done_episodes=150)
    work.finished_steps, work.finished_episodes, work.seconds = steps // 2, 30 * finished, 10.0
    return work


def test_a_program_of_few_steps_tells_little_of_others():
    """What it takes beside them would be taken for a slow machine; one of many steps is believed."""

    def for_each_second_that_is_usual(few):
        some, more = (
            seconds_left([few, Work("lunarlander", "gpc-ns", cells, 15)], jobs=1) for cells in (16, 32)
        )
        return (more - some) / (16 * 15 * costs.of_episode("lunarlander", "gpc-ns", "heuristic"))

    few = seen()
    usual = few.done * few.cells * few.episodes * costs.of_episode("cartpole", "gpc", "lqr")
    assert usual < 0.1 and few.seconds == 10.0
    assert for_each_second_that_is_usual(few) == pytest.approx((10.0 + LITTLE) / (usual + LITTLE))
    few.cells, few.begun, few.finished = 10_000_000, 5_000_000, 5_000_000
    few.finished_steps = few.steps = 50_000 * few.finished
    few.finished_episodes = few.done_episodes = few.finished * few.episodes
    few.seconds = 3 * few.finished * few.episodes * costs.of_episode("cartpole", "gpc", "lqr")
    assert for_each_second_that_is_usual(few) == pytest.approx(3.0, rel=0.01)


class TestLogFile:
    def test_a_line_at_the_beginning_a_line_a_minute_and_one_at_the_end(self):
        stream, clock = io.StringIO(), Clock()
        with Bar("cartpole", 10, 2, stream, clock) as bar:
            for second in range(150):
                clock.now = 100.0 + second
                bar.show(
                    State(finished=second // 30, steps=1000 * second, works=(seen(),), compiling=second < 70)
                )
        lines = stream.getvalue().splitlines()
        assert lines[0] == "cartpole: 10 cells in 2 processes" and len(lines) == 4
        assert lines[1].startswith("cartpole: 2/10 cells, 1,000 env steps/s, compiling, 0:") and lines[
            1
        ].endswith(" left")
        assert "compiling" not in lines[2]
        assert lines[3] == "cartpole: 4/10 cells in 2:29, 1,000 env steps/s"

    def test_compiling_is_said_only_while_something_compiles(self):
        for compiling, word in ((True, "compiling"), (False, "starting")):
            stream, clock = io.StringIO(), Clock()
            with Bar("cartpole", 10, 1, stream, clock) as bar:
                clock.now += LINE_SECONDS
                bar.show(State(compiling=compiling))
            assert stream.getvalue().splitlines()[1] == f"cartpole: 0/10 cells, {word}"

    def test_an_interruption_has_its_last_line_too(self):
        stream = io.StringIO()
        with pytest.raises(KeyboardInterrupt), Bar("cartpole", 10, 1, stream) as bar:
            bar.show(State(finished=3))
            raise KeyboardInterrupt
        assert stream.getvalue().splitlines()[1].startswith("cartpole: 3/10 cells in 0:00")


class Broken(io.StringIO):
    """A terminal or a pipe whose other end is gone."""

    def __init__(self, terminal):
        super().__init__()
        self.terminal = terminal

    def isatty(self):
        return self.terminal

    def fileno(self):
        return 1

    def write(self, text):
        raise BrokenPipeError


@pytest.mark.parametrize("terminal", [True, False])
def test_a_sweep_goes_on_where_nobody_watches(terminal):
    clock = Clock()
    with Bar("cartpole", 10, 1, Broken(terminal), clock) as bar:
        for _ in range(3):
            clock.now += LINE_SECONDS
            bar.show(State(finished=1, steps=10, works=(seen(),)))


class Terminal(io.StringIO):
    encoding = "ascii"

    def isatty(self):
        return True

    def fileno(self):
        return 1


@pytest.mark.parametrize("columns", ["10", "200"])
def test_a_terminal_gets_a_bar(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    with Bar("cartpole", 10, 1, stream, Clock()) as bar:
        bar.show(State(finished=3, steps=1000, works=(seen(),)))
    if columns == "200":
        assert "3/10 cells" in stream.getvalue() and " left" in stream.getvalue()
    assert stream.getvalue()


def test_one_table_says_what_programs_cost():
    """Of every task and learner; an expert that plans at each advice costs much more than one that does not."""
    for env in env_names():
        for algo in names("learner"):
            usual = costs.of_episode(env, algo, expert_names(env)[0])
            assert usual > 0 and costs.compiling(algo) > 0
            for oracle in expert_names(env):
                assert (costs.of_episode(env, algo, oracle) > 2 * usual) == (oracle == "mpc")
    assert costs.of_episode("cartpole", "coach", "mpc") > 100 * costs.of_episode("cartpole", "coach", "gpc")
    fast, slow = (
        works_of(
            Counter(map(program_of, plan(spec_of(env="cartpole", algo="coach", oracle=oracle, seeds=8))))
        )
        for oracle in ("gpc", "mpc")
    )
    (work,) = slow.values()
    assert (work.env, work.algo, work.oracle, work.cells, work.episodes) == (
        "cartpole",
        "coach",
        "mpc",
        8,
        30,
    )
    assert seconds_left(list(slow.values()), 1) > 4 * seconds_left(list(fast.values()), 1)


def test_what_is_known_says_nothing_of_what_is_not():
    """A program that ran here before tells how long it takes, and not how slow a machine is for others."""
    new = Work("cartpole", "gpc", 1000, 30, machine=3.0)
    other = Work("pendulum", "coach", 10, 40, begun=10, finished=5, steps=40_000, done_episodes=200, joined=1)
    other.finished_steps, other.finished_episodes, other.seconds, other.machine = 40_000, 200, 1.0, 3.0
    known = replace(other, before=Cost(1.0 / 200, 0.0, 10, 1))
    alone = seconds_left([new], 1)
    assert seconds_left([new, known], 1) == pytest.approx(alone, rel=0.02)
    assert seconds_left([new, other], 1) != pytest.approx(alone, rel=0.3)


class TestExperience:
    """What programs took here is known the next time."""

    PROGRAMS = tuple(
        {program_of(cell) for cell in plan(spec_of(env="cartpole", algo=["gpc", "coach"], seeds=3))}
    )

    def test_it_is_remembered(self, tmp_path):
        one, other = self.PROGRAMS
        assert experience.of(self.PROGRAMS, tmp_path) == {}
        experience.learn({one: Cost(0.5, 10.0, 64, 1)}, tmp_path)
        assert experience.of(self.PROGRAMS, tmp_path) == {one: Cost(0.5, 10.0, 64, 1)}
        experience.learn({one: Cost(0.25, 1.0, 3, 1), other: Cost(1.0, 5.0, 2, 1)}, tmp_path)
        assert experience.of([one], tmp_path) == {one: Cost(0.25, 1.0, 3, 1)}
        assert experience.start_of(tmp_path) == experience.USUAL_START
        experience.learn({one: Cost(0.25, 1.0, 3, 1)}, tmp_path, started=4.0)
        experience.learn({one: Cost(0.25, 1.0, 3, 1)}, tmp_path, started=2.0)
        assert experience.start_of(tmp_path) == 3.0 and experience.start_of(None) == experience.USUAL_START

    def test_it_counts_before_and_while_a_sweep_runs(self):
        one, other = self.PROGRAMS
        known = works_of({one: 100, other: 100}, {one: Cost(0.5, 0.0, 100, 1), other: Cost(0.1, 0.0, 100, 1)})
        episodes = 100 * one.episodes
        assert seconds_left(list(known.values()), 1) == pytest.approx(episodes * 0.6, rel=0.05)
        work = known[one]
        assert work.took is None
        work.workers = work.joined = 1
        work.begun = work.finished = 60
        work.finished_episodes = work.done_episodes = 60 * one.episodes
        work.finished_steps = work.steps = 1000
        work.seconds, work.compile_seconds = 30.0, 4.0
        assert work.took == Cost(30.0 / work.done_episodes, 4.0, 60, 1)
        # What was compiled comes from the cache the next time.
        work.kept = 2
        assert work.took == Cost(30.0 / work.done_episodes, 4.0 * experience.FROM_CACHE, 60, 1)
        work.kept = 10
        assert work.took == Cost(30.0 / work.done_episodes, 4.0 * experience.FROM_TEXT, 60, 1)
        work.before = Cost(0.5, 0.0, 100, 1, tiers=3)
        assert work.took is not None and work.took.tiers == 3, (
            "those that no run got to this time are kept, too"
        )

    def test_few_cells_tell_what_many_take(self):
        """Those of few keep a block half empty; the more there were then, the more they are believed."""
        (one, _), few, many = self.PROGRAMS, Cost(0.5, 0.0, costs.LANES, 1), Cost(0.5, 0.0, 6400, 1)
        of_few, of_many = (works_of({one: 6400}, {one: cost})[one] for cost in (few, many))
        assert of_few.usual_episode == pytest.approx(0.5 * 1.01 / 2) and of_many.usual_episode == 0.5
        # The same sweep once more is told what it took, by as many workers as then.
        again = works_of({one: 64}, {one: Cost(0.5, 0.0, 64, 2)})[one]
        assert again.usual_episode == 0.5
        again.joined = 1
        assert again.usual_episode == pytest.approx(0.5 * 2 / 3)
        for work in (of_few, of_many):
            work.begun = work.finished = 1600
            work.finished_episodes = work.done_episodes = 1600 * one.episodes
            work.finished_steps = work.steps = work.done_episodes * 100
            work.seconds = 0.1 * work.done_episodes
        by_pace = 0.1 * 4800 * one.episodes
        assert by_pace < seconds_left([of_few], 1) < seconds_left([of_many], 1)

    @pytest.mark.parametrize(
        "content",
        [
            b"",
            b"[]",
            b"{",
            b'{"a": 3}',
            b'{"a": [1, 2, 3]}',
            b'{"a": [1, 2, 3, 1]}',  # of an earlier version, without tiers
            b'{"a": [1, 2, 3, 1, 0]}',
            b'{"a": [1, 2, "3", 1, 1]}',
            b'{"a": [1, 2, true, 1, 1]}',
            b'{"a": [0, 2, 3, 1, 1]}',
            b'{"a": [1, 2, 0, 1, 1]}',
            b'{"a": [1, 2, 3, 1.5, 1]}',
            b'{"a": [NaN, 2, 3, 1, 1]}',
            b'{"a": [1, 2, ' + b"9" * 400 + b", 1, 1]}",
            b"[" * 100000,
            bytes([255]),
        ],
    )
    def test_a_file_that_is_none_is_nothing(self, tmp_path, content):
        (tmp_path / experience.FILE).write_bytes(content)
        assert experience.of(self.PROGRAMS, tmp_path) == {}
        experience.learn({self.PROGRAMS[0]: Cost(1.0, 1.0, 5, 1)}, tmp_path)
        assert len(experience.of(self.PROGRAMS, tmp_path)) == 1

    def test_nowhere_to_write(self, tmp_path):
        experience.learn({self.PROGRAMS[0]: Cost(1.0, 1.0, 5, 1)}, None)
        experience.learn({self.PROGRAMS[0]: Cost(1.0, 1.0, 5, 1)}, tmp_path / "none")
        assert experience.of(self.PROGRAMS, tmp_path / "none") == experience.of(self.PROGRAMS, None) == {}

    def test_it_is_bounded(self, tmp_path, monkeypatch):
        monkeypatch.setattr(experience, "MOST", 1)
        for program in self.PROGRAMS:
            experience.learn({program: Cost(1.0, 1.0, 5, 1)}, tmp_path)
        assert list(experience.of(self.PROGRAMS, tmp_path)) == [self.PROGRAMS[-1]]

    def test_the_first_line_of_a_log_says_it(self):
        stream, clock = io.StringIO(), Clock()
        works = tuple(
            works_of(
                dict.fromkeys(self.PROGRAMS, 100), {each: Cost(0.1, 3.0, 100, 1) for each in self.PROGRAMS}
            ).values()
        )
        with Bar("cartpole", 200, 1, stream, clock, works):
            pass
        expected = r"cartpole: 200 cells in 1 process, about \d+:\d\d, 0:06 of it compiling"
        assert re.fullmatch(expected, stream.getvalue().splitlines()[0])

    def test_what_was_never_compiled_is_told_too(self):
        """By each program's tiers; less of it, the more was compiled; nothing of those that are nearly done."""
        works = list(works_of(dict.fromkeys(self.PROGRAMS, 100)).values())
        told = Told("cartpole", 200, 2, works)
        assert re.fullmatch(r"about \d:\d\d left, 0:\d\d of it compiling", told.left)
        before = compiling_left(works, 1)
        assert before == pytest.approx(sum(work.usual_compiling for work in works))
        assert compiling_left(works, 2) == max(work.usual_compiling for work in works)
        works[0].joined, works[0].compiling_for = 1, 1.0
        assert compiling_left(works, 1) == pytest.approx(before - 1.0)
        for work in works:
            work.begun = work.finished = work.cells
        assert compiling_left(works, 1) == 0.0


def test_json_lines():
    stream, clock = io.StringIO(), Clock()
    with JsonLines("cartpole", 10, 1, stream, clock) as lines:
        for seconds in (100.5, 101.5, 101.6, 103.0):
            clock.now = seconds
            lines.show(State(finished=3, steps=1000, works=(seen(),), compiling=True))
    told = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert [line["event"] for line in told] == ["begin", "progress", "progress", "end"]
    assert told[1] == {
        "event": "progress", "sweep": "cartpole", "cells": 10, "finished": 3, "env_steps": 1000, "elapsed_s": 1.5,
        "left_s": told[1]["left_s"], "compile_s": told[1]["compile_s"], "compiling": True,
    }  # fmt: skip
    assert told[1]["left_s"] >= told[1]["compile_s"] > 0
    assert told[-1]["complete"] is True and "complete" not in told[0]


def test_json_lines_say_how_it_ended():
    stream = io.StringIO()
    with contextlib.suppress(KeyboardInterrupt), JsonLines("cartpole", 10, 1, stream, Clock()):
        raise KeyboardInterrupt
    *_, last = map(json.loads, stream.getvalue().splitlines())
    assert (last["event"], last["complete"]) == ("end", False)


def test_the_time_left_costs_as_many_steps_as_there_are_programs(monkeypatch):
    """Not as many as pairs of them: the thread that reckons it is the one that answers workers."""
    asked = []
    monkeypatch.setattr(estimate, "least_to_join", lambda work: asked.append(work) or 48)
    assert seconds_left([Work("cartpole", "gpc", 60, 30, "lqr") for _ in range(200)], 8) > 1
    assert len(asked) == 200


def test_the_time_left_is_reckoned_once_a_second(monkeypatch):
    reckoned, clock = [], Clock()
    monkeypatch.setattr(telling, "seconds_left", lambda works, jobs: reckoned.append(works) or 60.0)
    told = Told("cartpole", 10, 1, (seen(),), clock)
    told.begin()
    for number in range(31):
        clock.now = told.began + number / 10
        told.state = State(finished=3, works=(seen(),))
        assert told.share == pytest.approx((number / 10) / (number / 10 + 60.0 - number % 10 / 10))
        assert told.left == f"{'1:00' if number % 10 <= 5 else '0:59'} left"
    assert len(reckoned) == 4
    told.state = State(finished=10, works=(seen(),))
    assert told.left and len(reckoned) == 5, "at the end it is as it is"
