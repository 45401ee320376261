"""The process that writes: what is asked is done there, or here where it cannot go; nothing is lost with a process."""

import os

import pytest

from gpcjax.errors import UserError
from gpcjax.teach.clerk import Clerk


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


def test_its_process_may_die(clerk, tmp_path):
    before = clerk._process.pid
    clerk._process.kill()
    assert written(clerk, tmp_path / "note") == clerk._process.pid != before
