"""A worker as another machine has it: a real process, from a folder that has nothing but what was sent along."""

import contextlib
import json
import os
import pickle
import signal
import sys
import tempfile

import pytest

from gpcjax.sweep import machine
from gpcjax.sweep.checkpoints import receive, told
from gpcjax.sweep.environment import CACHE, programs_folder
from gpcjax.sweep.executors import Orders, processes, remote
from gpcjax.sweep.executors.remote import Remote
from gpcjax.sweep.parcel import parcel_of, unpack
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.versions import versions
from tests.sweep.processes import alive
from tests.sweep.test_executors import START

EXPERT = """
from goal import GOAL

def push(obs):
    return (GOAL - obs[1:2]).clip(-1.0, 1.0) * 0.5
"""


EPISODES = 4


@pytest.fixture
def parcel(tmp_path, monkeypatch):
    """A sweep with an expert of one's own, asked for where that lies; and its only cell."""
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "ourexpert.py").write_text(EXPERT)
    (folder / "goal.py").write_text("GOAL = 1.0\n")
    with monkeypatch.context() as there:
        there.chdir(folder)
        cells = plan(
            spec_of(env="mountaincar", algo="coach", oracle="ourexpert:push", seeds=1, episodes=EPISODES)
        )
        return parcel_of(cells), cells[0]


def hear(remote, answer=None):
    """All that it says until it asks, fails or ends."""
    heard = pickle.loads(remote.hear(None if answer is None else pickle.dumps((answer, {}))))
    while not any(message[0] in ("ready", "next", "failed", "refused", "ended") for message in heard):
        heard += pickle.loads(remote.hear())
    return heard


def test_it_computes_with_what_was_sent_and_saves_here(parcel, tmp_path):
    cell, kind = parcel[1], machine.kind_of(machine.describe())
    agree = told(versions(), "the kind of the desk's machine", None)
    orders = Orders(checkpoints="/nowhere/on/this/machine", seconds=1e-9, agree=agree)
    with contextlib.closing(Remote(parcel[0], patience=0.2)) as worker:
        folder, process = worker._folder, worker._worker.process
        assert hear(worker)[-1] == ("ready",)
        assert hear(worker, ("program", cell, orders))[-1] == ("next",)
        heard = hear(worker, ("cells", [cell]))
        while heard[-1] == ("next",):  # an empty lane is free for more
            heard += hear(worker, ("cells", []))
    assert not folder.exists() and not alive(process.pid)
    (block,) = (message[1] for message in heard if message[0] == "rows")
    episodes = block.tables["episodes"].to_pydict()
    assert block.cells == (cell,) and episodes["episode"] == list(range(1, EPISODES + 1))
    assert set(episodes["status"]) == {"ok"} and block.tables["corrections"].num_rows
    assert not [message for message in heard if message[0] == "note"]
    assert len([message for message in heard if message[0] == "over"]) == 1
    name, archive = next(message[1:] for message in heard if message[0] == "checkpoint")
    places = receive(tmp_path, name, lambda parts: unpack(archive, parts))
    assert {each: place.folder for each, place in places.items()} == {cell: name}
    assert json.loads((tmp_path / "checkpoints" / name / "card.json").read_text())["machine"] == kind


def test_the_folder_of_one_that_was_killed_is_removed_by_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    living, lock = remote._own_folder()
    killed, other = remote._own_folder()
    (killed / "checkpoints").mkdir()
    os.close(other)  # as the end of its process does
    (tmp_path / "gpcjax-worker-of-somebody").mkdir()
    remote._remove_abandoned()
    assert living.is_dir() and not killed.exists() and (tmp_path / "gpcjax-worker-of-somebody").is_dir()
    os.close(lock)


def test_its_end_has_a_reason(parcel, monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE, str(tmp_path / "programs"))  # such an end costs the programs that are kept
    programs_folder().mkdir(parents=True)
    code = START + "parent.send(('ready',)); time.sleep(60)"
    monkeypatch.setattr(processes, "script", lambda _, number, parent: [sys.executable, "-c", code, number])
    with contextlib.closing(Remote(parcel[0], patience=0.2)) as worker:
        assert hear(worker)[-1] == ("ready",)
        worker._worker.process.send_signal(signal.SIGSEGV)
        word, line = hear(worker)[-1]
    assert word == "ended" and line.startswith(
        "a worker process was ended by SIGSEGV, and the compiled programs"
    )
