"""Executors other than processes: the same bits, and a line where they would not be."""

import os

import pytest

from gpcjax.errors import Failure, UserError
from gpcjax.sweep.environment import computing_environment
from gpcjax.sweep.executors import Desk, Executor, InProcess, Processes
from gpcjax.sweep.plan import plan
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.worker import work
from tests.sweep.threads import Threads

SETTINGS = {
    "env": "cartpole",
    "algo": "coach",
    "seeds": 3,
    "episodes": 3,
    "oracle": "lqr",
    "rate": 0.2,
}


def test_a_process_that_computes_otherwise_is_refused(tmp_path, monkeypatch):
    for name, value in computing_environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("NPROC", "4")
    with pytest.raises(
        UserError, match=r"computes otherwise than workers do \(NPROC\): give its environment"
    ):
        sweep(tmp_path, executor=InProcess(), **SETTINGS)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"executor": 3}, r"executor 3: give an object with `jobs` and `run\(desk\)`"),
        ({"executor": InProcess(), "jobs": 2}, "jobs 2: an executor has a number of its own"),
    ],
)
def test_an_executor_that_is_none(tmp_path, given, message):
    with pytest.raises(UserError, match=message):
        sweep(tmp_path / "out", **given, **SETTINGS)
    assert not (tmp_path / "out").exists()


def test_one_that_ends_too_early_leaves_the_sweep_incomplete(tmp_path):
    class Idle:
        jobs = 1

        def run(self, desk):
            assert desk.answer(0, ("ready",))[0] == "baseline"

    with pytest.raises(Failure, match="the executor ended with 3 cells and 2 baselines to do"):
        sweep(tmp_path, executor=Idle(), **SETTINGS)


def test_all_of_them_are_executors():
    assert all(isinstance(each, Executor) for each in (InProcess(), Processes(2), Threads(2)))
    assert not isinstance(object(), Executor)


class TestAWorker:
    """Its own errors are said, those of the way to the desk are let through."""

    @pytest.fixture(autouse=True)
    def environment(self, monkeypatch):
        monkeypatch.setattr(os, "environ", {**os.environ, **computing_environment()})

    def test_its_own(self, monkeypatch):
        said = []

        def say(message):
            said.append(message)
            return ("baseline", "no_such_task", "idle")

        assert not work(say)
        (ready, (kind, line)) = said
        assert ready == ("ready",) and kind == "refused"
        assert line.startswith("env 'no_such_task'")

    def test_that_of_the_desk(self):
        full = OSError(28, "No space left on device")

        def say(message):
            raise full

        with pytest.raises(OSError) as error:
            work(say)
        assert error.value is full

    def test_what_a_worker_refused_ends_the_sweep(self):
        cell = plan(spec_of(**SETTINGS))[0]
        desk = Desk([cell], [("no_such_task", "idle")], 1, lambda _: None, lambda *_: None, lambda _: None)
        with pytest.raises(UserError, match=r"^env 'no_such_task': give"):
            InProcess().run(desk)
