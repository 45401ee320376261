"""Worker processes that fail in every way, with a few lines of Python in the place of the one that computes."""

import errno
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from gpcjax.errors import Failure, UserError
from gpcjax.sweep import environment, stopping
from gpcjax.sweep.environment import CACHE
from gpcjax.sweep.executors import Desk, processes, starting
from gpcjax.sweep.executors.starting import FEWER
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.worker import last_word, told

CELLS = plan(spec_of(env="cartpole", algo="coach", seeds=4, oracle="lqr"))
START = """
import os, signal, sys, time
from multiprocessing.connection import Connection
parent = Connection(int(sys.argv[1]))
"""


@pytest.fixture
def workers(monkeypatch):
    """Has workers run this code; gives the processes that were started."""
    started = []

    def pretend(code, jobs=1, on_rows=lambda rows: None, on_progress=lambda totals: None):
        monkeypatch.setattr(
            processes, "script", lambda _, number, parent: [sys.executable, "-c", START + code, number]
        )
        popen = subprocess.Popen

        def start(*arguments, **options):
            started.append(popen(*arguments, **options))
            return started[-1]

        monkeypatch.setattr(processes.subprocess, "Popen", start)
        desk = Desk(CELLS, [], jobs, on_rows, lambda *_: None, on_progress)
        processes.Processes(jobs).run(desk)

    yield pretend
    assert all(process.poll() is not None for process in started)  # none outlives the call


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("os.kill(os.getpid(), signal.SIGKILL)", f"was killed by SIGKILL, perhaps by the system for want of memory{FEWER}"),  # noqa: E501
        ("os.kill(os.getpid(), signal.SIGSEGV)", "was ended by SIGSEGV"),
        ("print('no such flag', file=sys.stderr, flush=True); os.abort()", "was ended by SIGABRT: no such flag"),
        ("import none_such", "ended with status 1: ModuleNotFoundError: No module named 'none_such'"),
        ("print('to stdout'); sys.exit(7)", "ended with status 7"),
        ("parent.send(('ready',)); parent.close(); os._exit(0)", "ended with status 0"),  # what is sent back finds nobody  # noqa: E501
        ("[print('x' * 1000, file=sys.stderr) for _ in range(500)]; sys.exit('the end')", "ended with status 1: the end"),  # noqa: E501
    ],
)  # fmt: skip
def test_an_end_has_its_reason(workers, code, message, monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE, str(tmp_path))
    with pytest.raises(Failure) as failure:
        workers(code)
    assert str(failure.value) == f"a worker process {message}"
    assert not failure.value.details


@pytest.mark.parametrize(("number", "gone"), [("SIGSEGV", True), ("SIGILL", True), ("SIGKILL", False)])
def test_programs_that_may_have_ended_a_worker_are_kept_no_longer(
    workers, number, gone, monkeypatch, tmp_path
):
    monkeypatch.setenv(CACHE, str(tmp_path))
    folder = environment.programs_folder()
    folder.mkdir()
    (folder / "one.program").write_text("")
    (tmp_path / "another").write_text("")
    with pytest.raises(Failure) as failure:
        workers(f"os.kill(os.getpid(), signal.{number})")
    assert str(failure.value).endswith("was the cause: try again") == gone
    assert folder.exists() != gone and (tmp_path / "another").exists()


def test_its_own_error_is_one_line_with_the_full_text_beside_it(workers):
    with pytest.raises(Failure, match=r"^a worker process failed: ValueError: ours$") as failure:
        workers("parent.send(('failed', 'ValueError: ours', 'Traceback'))")
    assert failure.value.details == "Traceback"


@pytest.mark.parametrize(
    ("error", "line", "ours"),
    [
        (ValueError("a\nb"), "ValueError: a b", True),
        (AssertionError(), "AssertionError", True),
        (MemoryError(), f"MemoryError{FEWER}", False),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory"), f"RuntimeError: RESOURCE_EXHAUSTED: Out of memory{FEWER}", False),  # noqa: E501
        (ValueError("RESOURCE_EXHAUSTED: Error writing \"a/0\": No space left on device"), "ValueError: RESOURCE_EXHAUSTED: Error writing \"a/0\": No space left on device", True),  # noqa: E501
        (OSError(errno.EMFILE, "Too many open files"), "OSError: [Errno 24] Too many open files", False),
    ],
)  # fmt: skip
def test_what_a_worker_tells_of_its_error(error, line, ours):
    assert told(error)[0] == line
    assert bool(told(error)[1]) == ours and (not ours or type(error).__name__ in told(error)[1])


def test_a_reader_of_progress_that_is_gone_is_no_end_of_a_worker(workers):
    """It breaks a pipe, too: that of the command's own output, which ends it with a status of its own."""

    def show(totals):
        if totals.env_steps:
            raise BrokenPipeError("the reader is gone")

    code = """
from gpcjax.sweep.executors import Totals
parent.send(("ready",)); parent.recv()
parent.send(("next",)); parent.recv()
parent.send(("progress", Totals(100, 2, 0.5, 1)))
time.sleep(60)
"""
    with pytest.raises(BrokenPipeError, match="the reader is gone"):
        workers(code, on_progress=show)


def test_what_a_worker_refuses_is_the_persons_mistake(workers):
    """Raised again as it was: status 2 on the command line, not a fault of ours."""
    assert last_word(UserError("env 'x':\n give y")) == ("refused", "env 'x': give y")
    with pytest.raises(UserError, match=r"^env 'x': give y$"):
        workers("""parent.send(("refused", "env 'x': give y"))""")


def test_one_that_cannot_be_started(workers, monkeypatch):
    """The first is there when there is no room for the second, and ends with the call."""
    real, calls = processes.Pipe, []

    def pipe():
        calls.append(None)
        if len(calls) == 2:
            raise OSError(errno.EMFILE, "Too many open files")
        return real()

    monkeypatch.setattr(processes, "Pipe", pipe)
    with pytest.raises(Failure, match="could not be started: Too many open files, give fewer"):
        workers("time.sleep(60)", jobs=2)


def test_a_signal_ends_it_between_two_messages(workers):
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), stopping.deferred():
        threading.Timer(
            0.5, lambda: __import__("os").kill(__import__("os").getpid(), stopping.SIGNALS[0])
        ).start()
        workers("time.sleep(60)", jobs=2)
    assert time.monotonic() - began < 30


def test_a_signal_to_all_processes_is_a_stop_and_no_failure(workers):
    """As `scancel` or the end of a service sends it: the worker may be the first to go."""
    code = """
outer = os.getppid()
if os.fork() == 0:
    time.sleep(0.1)
    os.kill(outer, signal.SIGTERM)
    os._exit(0)
os.kill(os.getpid(), signal.SIGTERM)
"""
    got = []
    before = signal.signal(signal.SIGTERM, lambda *_: got.append("SIGTERM"))
    try:
        with pytest.raises(stopping.Stopped), stopping.deferred():
            workers(code)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert got == ["SIGTERM"]


def test_progress_is_put_down_to_programs(workers):
    cell = repr(CELLS[0])
    seen = []
    code = f"""
import numpy as np
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.executors import Totals
from gpcjax.sweep.rows import CellRows
time.sleep(0.7)
parent.send(("ready",)); parent.recv()
parent.send(("next",)); parent.recv()
parent.send(("compiling", True)); time.sleep(1.2)
parent.send(("compiling", False))
parent.send(("progress", Totals(100, 2, 0.5, 1)))
measured = {{"returns": np.zeros(2), "length": np.array([30, 40])}}
parent.send(("rows", CellRows({cell}, np.array([1, 2]), ["ok"] * 2, measured, {{}}, {{}})))
parent.send(("progress", Totals(150, 3, 0.5, 1)))
time.sleep(0.7)
os._exit(3)
"""
    with pytest.raises(Failure, match="status 3"):
        workers(
            code,
            on_progress=lambda totals: seen.append((totals, [vars(work).copy() for work in totals.works])),
        )
    # While it compiled, the time went on, and it was told; not while it was starting up.
    assert {totals.compiling for totals, _ in seen} == {False, True}
    assert not seen[0][0].compiling and not seen[-1][0].compiling
    totals, (work,) = seen[-1]
    assert (totals.env_steps, totals.episodes, totals.compile_seconds) == (150, 3, 0.5)
    assert work["steps"] == 150 and work["done_episodes"] == 3 and work["compile_seconds"] == 0.5
    assert work["finished"] == 1 and work["finished_steps"] == 70 and work["finished_episodes"] == 2
    assert work["begun"] == 1 and work["workers"] == 1 and work["cells"] == 4
    assert 0.6 < work["seconds"] < 30
    assert np.isfinite(work["recent_steps"])


@pytest.fixture
def alone(tmp_path, monkeypatch):
    """Has `run_alone` run this code as a module; gives its processes."""
    monkeypatch.syspath_prepend(tmp_path)
    started, popen = [], subprocess.Popen

    def start(*arguments, **options):
        started.append(popen(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(starting.subprocess, "Popen", start)

    def run(code):
        (tmp_path / "some_module.py").write_text(f"import os, signal, sys, time\n{code}\n")
        starting.run_alone("some_module", "word")

    yield run
    assert started and all(process.poll() is not None for process in started)


@pytest.mark.parametrize(
    ("code", "message", "fault"),
    [
        ("os.kill(os.getpid(), signal.SIGKILL)", f"was killed by SIGKILL, perhaps by the system for want of memory{FEWER}", False),  # noqa: E501
        ("raise ValueError('why')", "ended with status 1: ValueError: why", True),
        ("raise MemoryError", f"ended with status 1: MemoryError{FEWER}", False),
        ("open('/none/such')", "ended with status 1: FileNotFoundError: [Errno 2] No such file or directory: '/none/such'", False),  # noqa: E501
        ("sys.exit(f'{sys.argv[1:]} {os.environ[\"NPROC\"]}')", "ended with status 1: ['word'] 1", False),
    ],
)  # fmt: skip
def test_one_alone_that_ends_says_why(alone, code, message, fault, capfd):
    with pytest.raises(Failure) as failure:
        alone(code)
    assert str(failure.value) == f"some_module {message}"
    assert ("ValueError: why" in failure.value.details) == fault and bool(failure.value.details) == fault
    assert capfd.readouterr() == ("", "")


def test_one_alone_is_stopped_without_a_word(alone, capfd):
    """What it prints is shown; Ctrl-C is for the parent alone, which ends it."""

    def stop(number, frame):
        raise stopping.Stopped(signal.SIGINT)

    before = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.4)
        with pytest.raises(stopping.Stopped):
            alone("print('seed 0', flush=True)\nassert os.getpgrp() == os.getpid()\ntime.sleep(60)")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    out, err = capfd.readouterr()
    assert out in ("seed 0\n", "") and err == ""
    alone("print('seed 1', file=sys.stdout)\nprint('a warning', file=sys.stderr)")
    assert capfd.readouterr() == ("seed 1\n", "")


STAYS = """
told = []
while True:
    parent.send(("ready",))
    answer = parent.recv()
    if answer[0] == "again":
        continue
    parent.send(("next",))
    while cells := parent.recv()[1]:
        for cell in cells:
            parent.send(("note", f"{os.getpid()} {cell.seed}"))
            parent.send(("failed", "to be seen", "") if cell.seed == 99 else ("progress", None))
        parent.send(("next",))
"""


def test_workers_stay_within_a_context(monkeypatch):
    """The second sweep finds the processes of the first; they end with the context, and with a failure."""
    monkeypatch.setattr(
        processes, "script", lambda _, number, parent: [sys.executable, "-c", START + STAYS, number]
    )
    heard = []

    class Heard(Desk):
        def _answer(self, worker, message):
            if message[0] == "note":
                heard.append((worker, *map(int, message[1].split())))
            return None if message[0] == "progress" else super()._answer(worker, message)

    def desk(seeds):
        cells = plan(spec_of(env="cartpole", algo="coach", seeds=seeds, oracle="lqr"))
        return Heard(cells, [], 2, lambda rows: None, lambda *_: None, lambda totals: None)

    with processes.Processes(2) as executor:
        executor.run(desk("0-3"))
        first, heard[:] = list(heard), []
        executor.run(desk("4-7"))
        second = list(heard)
        living = [worker.process for worker in executor._workers]
        assert len(living) == 2 and all(process.poll() is None for process in living)
    assert all(process.poll() is not None for process in living)
    assert {seed for _, _, seed in first} == {0, 1, 2, 3} and {seed for _, _, seed in second} == {4, 5, 6, 7}
    assert {pid for _, pid, _ in second} <= {process.pid for process in living}
    with processes.Processes(1) as executor, pytest.raises(Failure, match="to be seen"):
        executor.run(desk("99,100"))
    assert not executor._workers


def test_a_worker_that_ends_while_it_waits_is_told_of(monkeypatch):
    monkeypatch.setattr(
        processes, "script", lambda _, number, parent: [sys.executable, "-c", START + STAYS, number]
    )
    with processes.Processes(1) as executor:
        executor.run(Desk(CELLS[:0], [], 1, lambda rows: None, lambda *_: None, lambda totals: None))
        (worker,) = executor._workers
        worker.process.kill()
        worker.process.wait()
        with pytest.raises(Failure, match="was killed by SIGKILL"):
            executor.run(Desk(CELLS[:1], [], 1, lambda rows: None, lambda *_: None, lambda totals: None))
