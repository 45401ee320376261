"""Who gets which cells: plain calls, no process."""

from dataclasses import replace

import hypothesis
import hypothesis.strategies as st
import pytest

from gpcjax.errors import Failure
from gpcjax.sweep import stopping
from gpcjax.sweep.crowd import AT_START, USUAL_PIECE
from gpcjax.sweep.estimate import LATE, least_to_join
from gpcjax.sweep.executors import Desk, Totals, times
from gpcjax.sweep.experience import Cost
from gpcjax.sweep.plan import plan, program_of
from gpcjax.sweep.sharing import BATCH, Sharing
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.works import Work
from tests.sweep.pretended import BASELINE, rows


def cells(seeds=4, algo=("gpc", "coach"), env="cartpole", **settings):
    return plan(spec_of(env=env, algo=list(algo), seeds=seeds, oracle="lqr", **settings))


def test_each_worker_has_a_program_of_its_own_and_joins_only_where_it_is_worth_it():
    small, large = cells(seeds=20, algo=["gpc"]), cells(seeds=3000, algo=["coach"])
    sharing = Sharing([*small, *large], workers=3)
    assert [sharing.next_program(worker).algo for worker in range(3)] == ["coach", "gpc", "coach"]
    works = {work.algo: work for work in sharing.works.values()}
    assert works["gpc"].workers == 1 and works["coach"].workers == 2
    while sharing.next_cells(1):
        pass
    left = works["coach"]
    sharing.leave(2)
    while left.cells - left.begun >= least_to_join(left):
        sharing.next_cells(0)
    assert sharing.next_program(1) is None  # what is left is done sooner than a further worker has begun
    assert sharing.next_program(2) is None and sharing.at(0) == program_of(large[0])
    assert left.workers == 1 and left.joined == 2


def test_more_is_left_where_more_are_at_it_and_less_where_cells_take_long():
    """With k workers there a further one saves the k-th part of what is left at most."""
    quick, slow = (
        Work("cartpole", "gpc", 1000, 30, before=Cost(seconds, 2.0, 1000, 1), workers=1)
        for seconds in (0.001, 0.1)
    )
    few, many = least_to_join(slow), least_to_join(quick)
    assert 1 <= few <= many / 20 and many * quick.cell_seconds == pytest.approx(1.5 * quick.joining, rel=0.1)
    assert least_to_join(replace(quick, workers=3)) == pytest.approx(3 * many, abs=3)
    assert least_to_join(replace(quick, env="lunarlander")) == 1


def test_to_join_takes_what_it_takes_to_read_what_was_compiled():
    compiled = Work("cartpole", "gpc", 300, 30, joined=1, compile_seconds=20.0, steps=1)
    assert 0.5 < compiled.joining < 3.0
    assert Work("cartpole", "gpc", 300, 30).joining < 2.0, (
        "who comes while it is compiled waits, and reads it"
    )
    assert replace(compiled, before=Cost(0.1, 1.2, 300, 1)).joining == pytest.approx(1.2, abs=0.5)


def test_what_takes_longest_goes_out_first():
    """The other worker goes through the short ones meanwhile; as they were asked for, it would wait in the end."""
    asked = cells(seeds=100, algo=["coach", "gpc", "gpc-ns"])
    sharing = Sharing(asked, workers=2)
    assert [sharing.next_program(worker).algo for worker in (0, 1)] == ["gpc", "gpc-ns"]
    while sharing.next_cells(1):
        pass
    assert sharing.next_program(1).algo == "coach"
    assert [work.algo for work in sharing.works.values()] == ["gpc", "gpc-ns", "coach"]


def test_how_long_is_known_from_the_last_time():
    asked = cells(seeds=4)
    coach = program_of(asked[-1])
    sharing = Sharing(asked, workers=1, before=lambda programs: {coach: Cost(1.0, 1.0, 4, 1)})
    assert sharing.next_program(0).algo == "coach"


def test_shares_shrink_towards_the_end():
    sharing = Sharing(cells(seeds=200, algo=["coach"]), workers=2)
    sharing.next_program(0)
    sizes = []
    while taken := sharing.next_cells(0):
        sizes.append(len(taken))
    assert sum(sizes) == 200 and sizes[0] == BATCH and sizes[-1] == 1
    assert sizes == sorted(sizes, reverse=True)


def test_the_first_seeds_come_first_whatever_else_varies():
    """So the runs that are over are a sample of all, in every group."""
    several = cells(seeds=20, algo=["coach"], error=[0.0, 0.1, 0.2])
    sharing = Sharing(several, workers=1)
    sharing.next_program(0)
    taken = [cell for _ in range(3) for cell in sharing.next_cells(0)]
    assert [(cell.seed, cell.error) for cell in taken[:4]] == [(0, 0.0), (0, 0.1), (0, 0.2), (1, 0.0)]
    assert {cell for cell in several if cell.seed < 5} <= set(taken)


def test_on_the_host_a_worker_leaves_the_others_their_part():
    task = cells(seeds=5, algo=["coach"])
    lander = plan(spec_of(env="lunarlander", algo="gpc", seeds=5))
    for these, expected in ((task, 5), (lander, 3)):
        sharing = Sharing(these, workers=2)
        sharing.next_program(0)
        taken = []
        while some := sharing.next_cells(0):
            taken += some
        assert len(taken) == expected


def test_who_has_nothing_left_takes_copies_of_what_is_out_for_longest():
    sharing = Sharing(cells(seeds=6, algo=["coach"]), workers=3)
    for worker in range(3):
        sharing._turn(worker, program_of(cells(algo=["coach"])[0]))  # so few are not worth joining else
    given = [sharing.next_cells(worker % 3)[0] for worker in range(6)]
    assert all(sharing.back(1, cell) for cell in given[1::3]) and sharing.next_cells(1) == []
    assert sharing.next_program(1) is None and sharing.next_copy(1) == given[0]
    assert sharing.back(0, given[3])  # before the copies are handed out: it needs none
    assert sharing.next_cells(1) == [given[0]] and sharing.next_cells(1) == []
    assert sharing.left == 3 and not sharing.is_late(0)
    assert sharing.back(1, given[0]) and sharing.left == 2
    assert sharing.is_late(0) and not sharing.back(0, given[0]) and not sharing.is_late(0)
    with pytest.raises(KeyError):
        sharing.back(0, given[0])
    assert sharing.next_copy(1) == given[2] and sharing.next_cells(1) == [given[2], given[5]]
    assert sharing.next_copy(0) is None  # each has a copy
    assert sharing.lose(2) == [] and sharing.next_copy(0) == given[2]  # the copies are all that there is
    assert sharing.lose(1) == [given[2], given[5]] and sharing.next_cells(0) == []
    assert sharing.next_program(0) is None or sharing.next_cells(0)


@hypothesis.given(
    st.lists(st.tuples(st.integers(0, 2), st.sampled_from(["take", "finish", "lose"])), max_size=60)
)
@hypothesis.settings(max_examples=60)
def test_every_cell_comes_back_once_whoever_is_lost(moves):
    everything = cells(seeds=20)
    sharing, held, done = Sharing(everything, workers=3), {0: [], 1: [], 2: []}, []

    def move(worker, what):
        if what == "lose":
            assert sharing.lose(worker) == held[worker]
            held[worker] = []
        elif what == "finish" and held[worker]:
            done.append(held[worker].pop(0))
            assert sharing.back(worker, done[-1])
            with pytest.raises(KeyError):
                sharing.back(worker, done[-1])
        elif what == "take" and (sharing.at(worker) or sharing.next_program(worker)):
            held[worker] += (taken := sharing.next_cells(worker))
            if not taken:
                sharing.leave(worker)
        assert sharing.left == len(everything) - len(done)
        assert sum(work.begun for work in sharing.works.values()) == len(done) + sum(map(len, held.values()))
        assert all(0 <= work.starting <= work.workers for work in sharing.works.values())

    for worker, what in moves:
        move(worker, what)
    for worker in (1, 2):
        move(worker, "lose")
    while sharing.left:
        move(0, "take")
        move(0, "finish")
    assert sorted(done, key=repr) == sorted(everything, key=repr)


def desk(these=None, baselines=(), jobs=2):
    got, measured, told = [], {}, []
    these = cells(seeds=2) if these is None else these
    return Desk(these, baselines, jobs, got.append, measured.__setitem__, told.append), got, measured, told


class TestDesk:
    """What is common to all executors."""

    def test_how_long_workers_take_to_be_there_is_told_by_those_that_begin(self, monkeypatch):
        """And by no other: one that is lost and comes back hours later says nothing of it, nor one that stayed."""
        now = [1000.0]
        monkeypatch.setattr("gpcjax.sweep.executors.times.time.monotonic", lambda: now[0])
        it = Desk(cells(seeds=2), [], 2, lambda _: None, lambda *_: None, lambda _: None, starts=2.0)
        work = next(iter(it.works.values()))
        assert work.ready_in == 2.0 and it.started is None
        now[0] += 4.0 * AT_START
        it.look()
        assert (work.slowness, work.ready_in) == (2.0, LATE * 4.0 * AT_START), "others are on the cores, too"
        now[0] += 1.0
        for worker in (0, 1):
            assert it.answer(worker, ("begun", 5.2 * AT_START, 2.6, 2 * USUAL_PIECE)) is None
            assert it.answer(worker, ("ready",))[0] == "program"
        it.look()
        assert it.started == 2.6 and work.ready_in == 0.0
        assert (work.machine, work.slowness) == (2.0, 2.0)
        now[0] += 7200.0
        it.lose(1)
        now[0] += 1.0
        it.look()
        assert work.ready_in == 0.0
        it.answer(1, ("ready",))
        assert it.started == 2.6

    def test_programs_that_are_kept_now_are_counted(self):
        it, _, _, _ = desk()
        it.answer(0, ("ready",))
        it.answer(0, ("next",))
        it.answer(0, ("progress", Totals(compile_seconds=3.0, compilations=3, kept=2)))
        it.answer(0, ("progress", Totals(compile_seconds=4.0, compilations=4, kept=3)))
        assert sum(work.kept for work in it.works.values()) == 3

    def test_the_last_worker_measures_first_and_another_one_when_it_has_nothing_else(self):
        it, _, measured, _ = desk(baselines=[("cartpole", "idle"), ("cartpole", "lqr")])
        assert it.answer(1, ("ready",)) == ("baseline", "cartpole", "idle")
        assert it.answer(0, ("ready",))[0] == "program"
        assert it.answer(1, ("baseline", "idle", BASELINE)) is None and measured == {"idle": BASELINE}
        it.lose(1)  # for good
        while it.answer(0, ("next",)) != ("cells", []):
            pass
        while (answer := it.answer(0, ("ready",)))[0] == "program":
            while it.answer(0, ("next",)) != ("cells", []):
                pass
        assert answer == ("baseline", "cartpole", "lqr")

    def test_a_lost_worker_keeps_what_it_has_done_and_gives_back_what_it_has_not(self):
        it, got, _, told = desk(cells(seeds=2, algo=["coach"]), [("cartpole", "idle")])
        assert it.answer(1, ("ready",))[0] == "baseline"
        it.lose(1)
        assert it.answer(1, ("ready",)) == ("baseline", "cartpole", "idle")  # another one in its place
        it.answer(1, ("baseline", "idle", BASELINE))
        it.answer(0, ("ready",))
        (first,) = it.answer(0, ("next",))[1]
        (second,) = it.answer(0, ("next",))[1]
        it.answer(0, ("rows", rows(first)))
        it.answer(0, ("progress", Totals(40, 4, 1.0, 1)))
        it.lose(0)
        with pytest.raises(Failure, match="ended with 1 cells and 0 baselines to do"):
            it.refuse_less()
        it.answer(0, ("ready",))
        assert it.answer(0, ("next",)) == ("cells", [second])
        it.answer(0, ("progress", Totals(10, 1, 0.5, 1)))
        it.answer(0, ("rows", rows(second)))
        it.refuse_less()
        assert [each.cell for each in got] == [first, second]
        assert (told[-1].env_steps, told[-1].compile_seconds) == (50, 1.5)
        assert told[-1].works[0].steps == 50

    def test_a_worker_that_speaks_does_not_compile(self, monkeypatch):
        now = [100.0]
        monkeypatch.setattr(times.time, "monotonic", lambda: now[0])
        it, _, _, told = desk(jobs=1)
        it.answer(0, ("ready",))
        now[0] += 0.5
        it.look()
        assert told[-1].works[0].compiling_for == 0.0
        now[0] += 2.5  # it is traced
        it.answer(0, ("compiling", True))  # a program that was kept: no word comes that it is there
        now[0] += 5.0
        it.look()
        assert told[-1].compiling and told[-1].works[0].compiling_for == 8.0
        it.answer(0, ("progress", Totals(10, 1, 0.5, 1, processor_seconds=2.0)))
        assert not told[-1].compiling
        now[0] += 5.0
        it.answer(0, ("progress", Totals(20, 2, 0.5, 1, processor_seconds=4.5)))
        work = told[-1].works[0]
        assert (work.slowness, work.heard_seconds, work.processor_seconds) == (2.0, 5.0, 2.5)

    def test_rows_that_nobody_was_to_make_are_refused(self):
        it, got, *_ = desk()
        with pytest.raises(Failure, match="that its worker has not"):
            it.answer(0, ("rows", rows(it.cells[0])))
        assert not got

    def test_a_signal_stops_it_at_the_next_word(self, monkeypatch):
        it, *_, told = desk()
        it.look()
        monkeypatch.setattr(stopping._heard, "first", 2)
        for say in (it.look, lambda: it.answer(0, ("ready",))):
            with pytest.raises(stopping.Stopped):
                say()
        assert len(told) == 1

    def test_there_are_no_more_workers_than_cells(self):
        assert [desk(these, jobs=9)[0].workers for these in ([], cells(seeds=1), None)] == [1, 2, 4]
