"""One writer for a run folder, whoever it is and however it ends."""

import contextlib
import errno
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep import lock
from gpcjax.sweep.lock import LOCK, held

HOLDER = "import sys, time; from gpcjax.sweep.lock import held\nfrom pathlib import Path\n"
HOLDER += "with held(Path(sys.argv[1])):\n    print('held', flush=True); time.sleep(600)"


def refused(out):
    with pytest.raises(UserError) as caught, held(out):
        pass
    return str(caught.value)


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_another_process_is_refused_until_it_is_killed(tmp_path, holder):
    before = (tmp_path / LOCK).read_bytes()
    message = refused(tmp_path)
    assert message.startswith(f"{tmp_path}: another sweep writes there (process {holder.pid} on ")
    assert message.endswith("): wait until it ends, or give a new folder (--out)")
    assert (tmp_path / LOCK).read_bytes() == before
    holder.kill()
    holder.wait()
    with held(tmp_path):  # though its file is still there
        assert str(os.getpid()) in (tmp_path / LOCK).read_text()
    assert not (tmp_path / LOCK).exists()


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '{"pid": "x"}', '{"pid": 1}', '{"pid": Infinity}', "\udcff", "[" * 10_000]
)
def test_a_holder_that_says_nothing_readable(tmp_path, holder, text):
    (tmp_path / LOCK).write_bytes(text.encode(errors="surrogateescape"))
    assert refused(tmp_path) == (
        f"{tmp_path}: another sweep writes there: wait until it ends, or give a new folder (--out)"
    )


def test_a_second_thread_is_refused_and_the_same_one_is_not(tmp_path):
    messages = []
    with held(tmp_path):
        with held(tmp_path / "." / ""):
            thread = threading.Thread(target=lambda: messages.append(refused(tmp_path)))
            thread.start()
            thread.join()
        assert (tmp_path / LOCK).exists()  # the inner one does not end it
        assert f"(process {os.getpid()} on " in messages[0]
    assert not (tmp_path / LOCK).exists()


def test_an_error_ends_it(tmp_path):
    with pytest.raises(KeyboardInterrupt), held(tmp_path):
        raise KeyboardInterrupt
    with held(tmp_path):
        pass


def test_no_child_inherits_it(tmp_path):
    """Neither a program that was started, though it keeps what it can, nor a fork: they live on, the lock does not."""
    code = (
        "import os, subprocess, sys; from gpcjax.sweep.lock import held\nfrom pathlib import Path\n"
        "with held(Path(sys.argv[1])):\n"
        "    program = subprocess.Popen([sys.executable, '-c', 'input()'], close_fds=False)\n"
        "    fork = os.fork() or os.execvp(sys.executable, ['-', '-c', 'import time; time.sleep(600)'])\n"
        "    idle = os.fork()\n"
        "    if not idle: os.read(0, 1); os._exit(0)\n"
        "    print('held', flush=True); os.kill(os.getpid(), 9)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        assert process.stdout.readline() == "held\n"
        process.wait()
        assert (tmp_path / LOCK).exists()
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:  # a fork lets go once it runs
            with contextlib.suppress(UserError), held(tmp_path):
                break
            time.sleep(0.01)
        with held(tmp_path):
            pass
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.stdin.close()
        process.stdout.close()


def test_of_many_at_once_one_has_it(tmp_path):
    """Also while others give it back and remove its file."""
    inside, most, turns = [], [], []

    def work():
        deadline = time.monotonic() + 60
        own = 0
        while own < 20 and time.monotonic() < deadline:
            try:
                with held(tmp_path):
                    inside.append(1)
                    most.append(len(inside))
                    time.sleep(0.0005)
                    inside.pop()
                    own += 1
            except UserError:
                time.sleep(0.0002)
        turns.append(own)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert turns == [20] * 4 and set(most) == {1}


def test_a_file_that_was_removed_under_us_is_locked_anew(tmp_path, monkeypatch):
    """Its last holder removes it between our opening and our locking."""
    flock, calls = fcntl.flock, []

    def slow(descriptor, operation):
        if not calls:
            (tmp_path / LOCK).unlink()
        calls.append(descriptor)
        flock(descriptor, operation)

    monkeypatch.setattr(lock.fcntl, "flock", slow)
    with held(tmp_path):
        assert len(calls) == 2 and (tmp_path / LOCK).exists()


def test_a_file_system_without_locks(tmp_path, monkeypatch):
    def none(descriptor, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(lock.fcntl, "flock", none)
    with held(tmp_path), held(tmp_path):
        assert not list(tmp_path.iterdir())
        with ThreadPoolExecutor(1) as pool:
            line = pool.submit(refused, tmp_path).result()
        assert line.startswith(f"{tmp_path}: another sweep writes there: wait until it ends")
    with held(tmp_path):
        pass


def test_locks_that_are_refused_for_a_moment_take_no_file_of_another(tmp_path, monkeypatch, holder):
    before = (tmp_path / LOCK).read_bytes()

    def none(descriptor, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    with monkeypatch.context() as patched:
        patched.setattr(lock.fcntl, "flock", none)
        with held(tmp_path):
            pass
    assert (tmp_path / LOCK).read_bytes() == before
    assert f"process {holder.pid} on" in refused(tmp_path)


def test_nothing_is_left_locked_where_the_file_was_removed(tmp_path):
    """A thread that is refused has locked a new file by then."""
    with held(tmp_path):
        (tmp_path / LOCK).unlink()
        with ThreadPoolExecutor(1) as pool:
            line = pool.submit(refused, tmp_path).result()
        assert line.startswith(f"{tmp_path}: another sweep writes there: wait until it ends")
    assert lock.holder(tmp_path) is None
    with held(tmp_path):
        pass


def test_where_nothing_can_be_written(tmp_path):
    (tmp_path / LOCK).mkdir()
    assert f"{tmp_path}: nothing can be written there (Is a directory)" in refused(tmp_path)
    assert "nothing can be written there (No such file or directory)" in refused(tmp_path / "none")


def test_a_folder_that_is_removed_meanwhile(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    with held(out):
        (out / LOCK).unlink()
        out.rmdir()


def test_on_a_full_disk_it_is_held_and_nothing_is_left(tmp_path, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(lock.os, "pwrite", full)
    with held(tmp_path):
        assert lock.holder(tmp_path) == "another process"
    assert not list(tmp_path.iterdir())
