"""Signals at the command line: each is one line and a status, also a second one, and what was done is kept."""

import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

import pytest

import gpcjax
from gpcjax.sweep import stopping

ROOT = Path(gpcjax.__file__).parents[1]
CHILD = """
import sys, time
from types import SimpleNamespace
from gpcjax import cli
from gpcjax.sweep import stopping

def run(spec, out, jobs, **options):
    {body}

sys.modules["gpcjax.sweep.run"] = SimpleNamespace(run=run)
sys.argv = ["gpcjax", "sweep", "--env=cartpole", "--out=out"]
raise SystemExit(cli.main())
"""
SWEEPING = """
    with stopping.deferred():
        try:
            print("ready", flush=True)
            while True:
                stopping.check()
                time.sleep(0.01)
        finally:
            time.sleep({ending})
            (out / "kept").touch()
"""
COMPUTING = """
    print("ready", flush=True)
    time.sleep(60)
"""
SWALLOWED = """
    try:
        print("ready", flush=True)
        time.sleep(60)
    except BaseException:
        raise ImportError("a library made this of it")
"""
LINE = "gpcjax: stopped: out keeps what is finished, the same command goes on from there\n"


IMPORTING = """
import signal, sys

class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            try:
                signal.raise_signal({number})
            except BaseException:
                raise ImportError("a library made this of it")

sys.meta_path.insert(0, Interrupts())
sys.argv = ["gpcjax", "version"]
from gpcjax.__main__ import main
raise SystemExit(main())
"""


@pytest.fixture
def start():
    """Starts a process that runs a body and is ready; none outlives its test, whatever becomes of it."""
    children = []

    def begin(body, folder, before=(), ending=0.05):
        body = body.strip().replace("{ending}", str(ending))
        child = subprocess.Popen(
            [*before, sys.executable, "-c", CHILD.format(body=body)],
            cwd=folder,
            env={"PATH": os.environ["PATH"], "HOME": str(folder), "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        children.append(child)
        assert child.stdout.readline() == "ready\n"
        return child

    yield begin
    for child in children:
        with child:  # which closes its pipes and waits for it
            child.kill()


@pytest.mark.parametrize(
    ("body", "name"),
    [
        (SWEEPING, "SIGHUP"),  # the others below, too
        *(pytest.param(SWEEPING, name, marks=pytest.mark.slow) for name in ("SIGINT", "SIGTERM")),
        (COMPUTING, "SIGINT"),
        *(pytest.param(COMPUTING, name, marks=pytest.mark.slow) for name in ("SIGTERM", "SIGHUP")),
    ],
    ids=lambda given: {SWEEPING: "in a sweep", COMPUTING: "elsewhere"}.get(given, given),
)
def test_a_signal_is_one_line_and_its_status(start, tmp_path, body, name):
    number = getattr(signal, name)
    child = start(body, tmp_path)
    child.send_signal(number)
    assert child.communicate(timeout=60) == ("", LINE)
    assert child.returncode == 128 + number
    assert (tmp_path / "out" / "kept").exists() == (body == SWEEPING)


@pytest.mark.parametrize(
    ("name", "module"),
    [
        ("SIGINT", "gpcjax.cli.running"),
        ("SIGINT", "tomllib"),
        ("SIGTERM", "argparse"),
        ("SIGHUP", "gpcjax.allowed"),
    ],
)
def test_a_signal_while_modules_are_imported_is_the_same(tmp_path, name, module):
    number = int(getattr(signal, name))
    done = subprocess.run(
        [sys.executable, "-c", IMPORTING.format(module=module, number=number)],
        env={"PATH": os.environ["PATH"], "HOME": str(tmp_path), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", "gpcjax: stopped\n")


def test_what_is_installed_is_the_quiet_one():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert settings["project"]["scripts"] == {"gpcjax": "gpcjax.__main__:main"}


@pytest.mark.parametrize(
    "pause", [0.02, *(pytest.param(pause, marks=pytest.mark.slow) for pause in (0.0, 0.1, 0.3))]
)
def test_a_second_one_changes_nothing(start, tmp_path, pause):
    child = start(SWEEPING, tmp_path, ending=4 * pause + 0.1)
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGINT):
        child.send_signal(number)
        time.sleep(pause)
    out, err = child.communicate(timeout=60)
    assert (out, err) == ("", LINE) and child.returncode == 130
    assert (tmp_path / "out" / "kept").exists()


def test_what_a_library_makes_of_it_is_still_a_stop(start, tmp_path):
    child = start(SWALLOWED, tmp_path)
    child.send_signal(signal.SIGTERM)
    assert child.communicate(timeout=60) == ("", "gpcjax: stopped\n") and child.returncode == 143


def test_what_the_shell_ignores_stays_ignored(start, tmp_path):
    """Under nohup, a closed terminal ends nothing."""
    child = start(SWEEPING, tmp_path, before=["sh", "-c", 'trap "" HUP; exec "$@"', "sh"])
    child.send_signal(signal.SIGHUP)
    time.sleep(0.2)
    assert child.poll() is None
    child.send_signal(signal.SIGTERM)
    assert child.communicate(timeout=60) == ("", LINE) and child.returncode == 143


def test_handlers_are_those_of_before_and_hear_of_it():
    got = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: got.append(number))
    ours = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(stopping.Stopped) as stopped, stopping.deferred():
            assert stopping.wakeup() is not None
            signal.raise_signal(signal.SIGTERM)
            assert not got
            stopping.check()
        assert stopped.value.status == 143 and got == [signal.SIGTERM]
        assert signal.getsignal(signal.SIGTERM) == ours and stopping.wakeup() is None
        stopping.check()  # and it is over
        with pytest.raises(KeyboardInterrupt), stopping.deferred():
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(OSError, match="full"), stopping.deferred():
            signal.raise_signal(signal.SIGINT)
            raise OSError("full")
    finally:
        signal.signal(signal.SIGTERM, before)


def test_in_another_thread_nothing_is_changed():
    handler, seen = signal.getsignal(signal.SIGINT), []

    def work():
        with stopping.deferred():
            seen.append((signal.getsignal(signal.SIGINT), stopping.wakeup()))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(handler, None)]


def test_a_signal_while_a_block_ends_writes_into_nobody_elses_file(monkeypatch):
    """The descriptors are just being closed: what is opened next may get their numbers."""
    heard, close = stopping._Heard(), os.close
    heard.open()

    def interrupted(descriptor):
        close(descriptor)
        heard.note(signal.SIGTERM, None)

    monkeypatch.setattr(stopping.os, "close", interrupted)
    monkeypatch.setattr(stopping.os, "write", lambda descriptor, data: pytest.fail("written"))
    heard.close()
    assert heard.first == signal.SIGTERM and heard.wakeup is None
