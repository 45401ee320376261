"""The process that writes: what is asked is done there, or here where it cannot go; nothing is lost with a process."""

import io
import os
import signal
import threading
import time

import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.teach.clerk import Clerk
from gpcjax.teach.course import POLICY, Course
from gpcjax.teach.kept import Kept
from gpcjax.teach.taught import Taught
from tests.teach.writing import WritesHere


class Note:
    """Writes the process that it is written by."""

    def __init__(self, path, beside=None):
        self.path, self.beside = path, beside

    def write(self):
        self.path.write_text(str(os.getpid()))


class Wrong:
    def write(self):
        raise UserError("there is no place left")


@pytest.fixture(scope="module")
def clerk():
    clerk = Clerk()
    yield clerk
    clerk.close()


def written(clerk, path, beside=None):
    clerk.write(Note(path, beside))
    return int(path.read_text())


def test_it_writes_elsewhere_and_says_what_failed(clerk, tmp_path):
    assert written(clerk, tmp_path / "note") == clerk._process.pid
    with pytest.raises(UserError, match="no place left"):
        clerk.write(Wrong())
    assert written(clerk, tmp_path / "after") == clerk._process.pid


def test_what_cannot_go_there_is_written_here(clerk, tmp_path, monkeypatch):
    """A learner of one's own may hold what no other process can have, or be of a class that none finds."""
    assert written(clerk, tmp_path / "held", lambda: None) == os.getpid()
    lost = type("Lost", (Note,), {"__module__": __name__})
    monkeypatch.setattr(f"{__name__}.Lost", lost, raising=False)
    clerk.write(lost(tmp_path / "lost"))
    assert int((tmp_path / "lost").read_text()) == os.getpid()
    assert written(clerk, tmp_path / "after") == clerk._process.pid


def test_what_a_lesson_leaves_is_written_there(clerk, tmp_path, monkeypatch):
    """With the arrays of what was learned; and lessons ask for no more than is there in their tests."""
    taught = Taught.begin(tmp_path, Course("mountaincar", "coach"))
    taught.step()
    taught.end("reset")
    kept = taught.kept()(taught.session)
    monkeypatch.setattr(Kept, "write", lambda kept: pytest.fail("it is written here"))
    clerk.write(kept)
    assert len(gpcjax.load(tmp_path)) == 1 and (tmp_path / POLICY).is_dir()
    has = lambda kind: {name for name in vars(kind) if not name.startswith("_")}  # noqa: E731
    assert has(WritesHere) == has(Clerk)


class Alone(Note):
    """Notes whether it was written while another one was."""

    under_way, together = 0, False

    def write(self):
        Alone.under_way += 1
        Alone.together |= Alone.under_way > 1
        time.sleep(0.02)
        super().write()
        Alone.under_way -= 1


def test_what_is_written_here_is_written_one_after_the_other(clerk, tmp_path):
    notes = [Alone(tmp_path / str(number), lambda: None) for number in range(4)]
    threads = [threading.Thread(target=clerk.write, args=(note,)) for note in notes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not Alone.together and len(list(tmp_path.iterdir())) == 4


@pytest.mark.slow
def test_its_process_may_die(clerk, tmp_path):
    before = clerk._process.pid
    clerk._process.kill()
    assert written(clerk, tmp_path / "note") == clerk._process.pid != before


class Answering(Note):
    """Fails the first time, with more to say than a pipe holds."""

    def write(self):
        if not self.path.exists():
            self.path.touch()
            raise UserError("." * 2**20)
        super().write()


class Killing(io.RawIOBase):
    """The answers of a process, which dies while the first of them is read."""

    def __init__(self, process):
        self._process, self._answers = process, process.stdout

    def readable(self):
        return True

    def readinto(self, buffer):
        count = self._answers.raw.readinto(buffer)
        self._process.kill()
        return count

    def close(self):
        self._answers.close()
        super().close()


def test_its_process_may_die_within_an_answer(clerk, tmp_path):
    """A part of an answer is none."""
    before = clerk._process
    before.stdout = io.BufferedReader(Killing(before))
    clerk.write(Answering(tmp_path / "note"))
    assert int((tmp_path / "note").read_text()) == clerk._process.pid != before.pid
    assert written(clerk, tmp_path / "after") == clerk._process.pid


class Hanging:
    def write(self):
        signal.pause()


def test_one_that_hangs_is_killed(monkeypatch):
    clerk = Clerk()
    before = clerk._process
    with monkeypatch.context() as patch:
        patch.setattr("gpcjax.teach.clerk.LONGEST", 0.1)
        with pytest.raises(OSError, match="took over"):
            clerk.write(Hanging())
    assert before.returncode is not None
    assert clerk._process is not before and clerk._process.poll() is None
    monkeypatch.setattr("gpcjax.teach.clerk.CLOSING", 0.1)
    clerk._process.send_signal(signal.SIGSTOP)
    clerk.close()
    assert clerk._process.returncode is not None
