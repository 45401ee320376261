"""Workers that go from one sweep's desk to the next: plain calls, no process."""

import hypothesis
import hypothesis.strategies as st
import pytest

from gpcjax.errors import Failure, UserError
from gpcjax.sweep.executors import Desk, Errands, Office, Totals
from gpcjax.sweep.plan import plan, program_of
from gpcjax.sweep.spec import spec_of
from tests.sweep.pretended import BASELINE, rows


def cells(algo, seeds=2, **settings):
    return plan(spec_of(env="cartpole", algo=algo, seeds=seeds, oracle="lqr", **settings))


class Sweep:
    """What a desk was told."""

    def __init__(self, cells, jobs=2, baselines=()):
        self.rows, self.baselines, self.totals = [], [], Totals()
        self.desk = Desk(
            cells,
            [("cartpole", name) for name in baselines],
            jobs,
            on_rows=lambda rows: self.rows.append(rows.cell),
            on_baseline=lambda name, numbers: self.baselines.append(name),
            on_progress=lambda totals: setattr(self, "totals", totals),
        )


class Told(list):
    """An office of these sweeps, and what it told of them in turn."""

    def office(self, sweeps, jobs=2, errands=None):
        desks = [sweep.desk for sweep in sweeps]
        turned, over = (lambda index, word=word: self.append((word, index)) for word in ("turned", "over"))
        return Office(desks, jobs, turned, over, errands)


def program(answer):
    assert answer[0] == "program"
    return program_of(answer[1])


def ready(office, worker):
    """What a worker is told, when it has put away what it did elsewhere."""
    answer = office.answer(worker, ("ready",))
    return office.answer(worker, ("ready",)) if answer == ("again",) else answer


def work_off(office, worker):
    """Takes the cells of its program and hands them in."""
    while taken := office.answer(worker, ("next",))[1]:
        for cell in taken:
            office.answer(worker, ("rows", rows(cell)))


def test_who_has_no_more_to_do_goes_to_the_next_sweep():
    first, second = Sweep(cells("gpc")), Sweep(cells("coach"))
    told = Told()
    office = told.office([first, second])
    assert office.workers == 2
    assert [program(office.answer(worker, ("ready",))).algo for worker in range(2)] == ["gpc", "coach"]
    assert told == [("turned", 0), ("turned", 1)]
    work_off(office, 1)
    assert office.answer(1, ("ready",)) == ("stop",)
    assert told[2:] == [("over", 1)] and len(second.rows) == 2 and not first.rows
    work_off(office, 0)
    assert office.answer(0, ("ready",)) == ("stop",)
    assert told[3:] == [("over", 0)] and len(first.rows) == 2


def test_what_was_done_elsewhere_is_put_away_before():
    """A worker counts what it did since its sweep began, and is told when another one does."""
    first, second = Sweep(cells("gpc"), jobs=1), Sweep(cells("coach"), jobs=1)
    office = Told().office([first, second], jobs=1)
    office.answer(0, ("ready",))
    office.answer(0, ("progress", Totals(env_steps=100, compile_seconds=5.0)))
    work_off(office, 0)
    assert office.answer(0, ("ready",)) == ("again",)
    assert program(office.answer(0, ("ready",))).algo == "coach"
    office.answer(0, ("progress", Totals(env_steps=7, compile_seconds=1.0)))
    assert (first.totals.env_steps, second.totals.env_steps) == (100, 7)
    assert (first.totals.compile_seconds, second.totals.compile_seconds) == (5.0, 1.0)


def test_nor_is_it_counted_after_an_errand():
    sweeps = [Sweep(cells(algo)) for algo in ("gpc", "coach", "gpc-ns")] + [Sweep(cells("coach", error=0.2))]
    office = Told().office(sweeps, errands=Errands([("module:first", ())]))
    assert [program(ready(office, worker)).algo for worker in range(2)] == ["gpc", "coach"]
    work_off(office, 1)
    assert program(ready(office, 1)).algo == "gpc-ns"
    office.answer(0, ("progress", Totals(env_steps=100)))
    work_off(office, 0)
    assert office.answer(0, ("ready",)) == ("errand", "module:first", ())
    assert office.answer(0, ("errand", "module:first")) is None
    assert office.answer(0, ("ready",)) == ("again",)
    assert program(office.answer(0, ("ready",))).algo == "coach"
    office.answer(0, ("progress", Totals(env_steps=7)))
    assert (sweeps[0].totals.env_steps, sweeps[3].totals.env_steps) == (100, 7)


def test_a_program_that_somebody_has_for_another_sweep_comes_last():
    """Who compiles it now would be waited for."""
    first, second = Sweep(cells("gpc", error=0.1)), Sweep([*cells("gpc", error=0.2), *cells("coach")])
    office = Told().office([first, second])
    assert program(office.answer(0, ("ready",))).algo == "gpc"
    assert program(office.answer(1, ("ready",))).algo == "coach"
    work_off(office, 1)
    answer = office.answer(1, ("ready",))
    assert program(answer).algo == "gpc" and answer[1].error == 0.2, "there is nothing else"


def test_nor_does_who_has_measured_a_baseline_wait_for_it():
    first, second = (Sweep(cells("gpc", error=error), baselines=["idle"]) for error in (0.1, 0.2))
    office = Told().office([first, second, Sweep(cells("coach"))])
    assert program(ready(office, 0)).algo == "gpc"
    for sweep in (first, second):
        assert ready(office, 1) == ("baseline", "cartpole", "idle")
        office.answer(1, ("baseline", "idle", BASELINE))
        assert sweep.baselines == ["idle"]
    assert program(ready(office, 1)).algo == "coach"


def test_a_sweep_without_anything_to_do_is_over():
    told = Told()
    office = told.office([Sweep([]), Sweep(cells("coach"))], jobs=1)
    office.answer(0, ("ready",))
    work_off(office, 0)
    assert office.answer(0, ("ready",)) == ("stop",)
    assert sorted(told) == [("over", 0), ("over", 1), ("turned", 1)]


def test_baselines_are_measured_and_waited_for():
    sweep, told = Sweep(cells("coach"), baselines=["idle", "lqr"]), Told()
    office = told.office([sweep])
    assert program(office.answer(0, ("ready",))).algo == "coach"
    assert office.answer(1, ("ready",)) == ("baseline", "cartpole", "idle")
    office.answer(1, ("baseline", "idle", BASELINE))
    work_off(office, 0)
    assert office.answer(0, ("ready",)) == ("baseline", "cartpole", "lqr")
    assert office.answer(1, ("ready",)) == ("stop",) and ("over", 0) not in told
    office.answer(0, ("baseline", "lqr", BASELINE))
    assert office.answer(0, ("ready",)) == ("stop",) and ("over", 0) in told
    assert sweep.baselines == ["idle", "lqr"]


def test_more_workers_than_a_sweep_has_cells_for():
    small, large = Sweep(cells("gpc", seeds=1), jobs=4), Sweep(cells("coach", seeds=400), jobs=4)
    office = Told().office([small, large], jobs=4)
    assert small.desk.workers == 1
    assert [program(office.answer(worker, ("ready",))).algo for worker in range(2)] == ["gpc", "coach"]
    assert all(office.answer(worker, ("ready",))[0] in ("program", "stop") for worker in (2, 3))


def test_what_workers_say_of_the_machine_is_for_all_sweeps():
    first, second = Sweep(cells("gpc")), Sweep(cells("coach"))
    office = Told().office([first, second])
    office.answer(0, ("begun", 2.0, 1.5, 0.006))
    assert first.desk.started == second.desk.started == 1.5


class TestErrands:
    def test_they_come_when_a_sweep_is_over(self):
        """Another one may still go on."""
        errands = Errands([("module:first", ("word",)), ("module:second", ())])
        office = Told().office([Sweep(cells(algo)) for algo in ("gpc", "coach", "gpc-ns")], errands=errands)
        assert [program(ready(office, worker)).algo for worker in range(2)] == ["gpc", "coach"]
        work_off(office, 1)
        assert program(ready(office, 1)).algo == "gpc-ns"
        work_off(office, 0)
        assert ready(office, 0) == ("errand", "module:first", ("word",))
        assert office.answer(0, ("compiling", True)) is None
        assert office.answer(0, ("errand", "module:first")) is None
        assert ready(office, 0) == ("errand", "module:second", ())
        assert ready(office, 0) == ("stop",)

    def test_or_at_the_end(self):
        office = Told().office([Sweep(cells("gpc", seeds=100))], errands=Errands([("module:first", ())]))
        assert program(ready(office, 0)).algo == "gpc"
        assert ready(office, 1) == ("errand", "module:first", ()), "there is nothing else to do"
        assert ready(office, 1) == ("stop",)

    def test_alone(self):
        assert Told().office([], jobs=4, errands=Errands([("module:first", ())])).workers == 1
        assert Told().office([], jobs=4).workers == 0

    @pytest.mark.parametrize(
        ("message", "error", "line"),
        [
            (("failed", "MemoryError", ""), Failure, "a worker process failed: MemoryError"),
            (("refused", "no room"), UserError, "no room"),
        ],
    )
    def test_they_fail(self, message, error, line):
        office = Told().office([], errands=Errands([("module:first", ())]))
        office.answer(0, ("ready",))
        with pytest.raises(error, match=line):
            office.answer(0, message)


@hypothesis.given(
    kinds=st.lists(
        st.tuples(st.sampled_from(["gpc", "coach", "gpc-ns"]), st.integers(0, 40)), min_size=1, max_size=4
    ),
    jobs=st.integers(1, 4),
    turns=st.lists(st.integers(0, 3), max_size=300),
)
def test_each_cell_is_run_once_and_its_rows_go_to_its_sweep(kinds, jobs, turns):
    """However workers are mixed, and whoever is faster."""
    sweeps = [
        Sweep(cells(algo, seeds=seeds, error=index / 10) if seeds else [], jobs)
        for index, (algo, seeds) in enumerate(kinds)
    ]
    told = Told()
    office = told.office(sweeps, jobs)
    doing = {worker: "ready" for worker in range(office.workers)}
    turns = [*turns, *(worker for _ in range(2000) for worker in range(jobs))]
    for worker in turns:
        if not doing:
            break
        if worker not in doing:
            continue
        if doing[worker] == "ready":
            match office.answer(worker, ("ready",)):
                case ("stop",):
                    del doing[worker]
                case ("program", *_):
                    doing[worker] = "next"
        else:
            taken = office.answer(worker, ("next",))[1]
            for cell in taken:
                office.answer(worker, ("rows", rows(cell)))
            doing[worker] = "next" if taken else "ready"
    assert not doing
    for sweep in sweeps:
        assert sorted(sweep.rows, key=repr) == sorted(sweep.desk.cells, key=repr) and sweep.desk.done
    assert sorted(index for word, index in told if word == "over") == list(range(len(sweeps)))
