"""A worker as another machine has it: a real process, from a folder that has nothing but what was sent along."""

import contextlib
import json
import pickle
import signal

import pytest

from gpcjax.sweep import machine
from gpcjax.sweep.checkpoints import receive, told
from gpcjax.sweep.environment import CACHE
from gpcjax.sweep.executors import Orders
from gpcjax.sweep.executors.remote import Remote
from gpcjax.sweep.parcel import parcel_of, unpack
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.versions import versions
from tests.sweep.processes import alive

EXPERT = """
from goal import GOAL

def push(obs):
    return (GOAL - obs[1:2]).clip(-1.0, 1.0) * 0.5
"""


@pytest.fixture
def parcel(tmp_path, monkeypatch):
    """A sweep with an expert of one's own, asked for where that lies; and its only cell."""
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "ourexpert.py").write_text(EXPERT)
    (folder / "goal.py").write_text("GOAL = 1.0\n")
    with monkeypatch.context() as there:
        there.chdir(folder)
        cells = plan(spec_of(env="mountaincar", algo="coach", oracle="ourexpert:push", seeds=1, episodes=20))
        return parcel_of(cells), cells[0]


def hear(remote, answer=None):
    """All that it says until it asks, fails or ends."""
    heard = pickle.loads(remote.hear(None if answer is None else pickle.dumps((answer, {}))))
    while not any(message[0] in ("ready", "next", "failed", "ended") for message in heard):
        heard += pickle.loads(remote.hear())
    return heard


def test_it_computes_with_what_was_sent_and_saves_here(parcel, tmp_path):
    cell, kind = parcel[1], machine.kind_of(machine.describe())
    agree = told(versions(), "the kind of the desk's machine", None)
    orders = Orders(checkpoints="/nowhere/on/this/machine", seconds=1e-9, agree=agree)
    with contextlib.closing(Remote(parcel[0], patience=0.2)) as remote:
        folder, process = remote._folder, remote._worker.process
        assert hear(remote)[-1] == ("ready",)
        assert hear(remote, ("program", cell, orders))[-1] == ("next",)
        heard = hear(remote, ("cells", [cell]))
        while heard[-1] == ("next",):  # an empty lane is free for more
            heard += hear(remote, ("cells", []))
    assert not folder.exists() and not alive(process.pid)
    (rows,) = (message[1] for message in heard if message[0] == "rows")
    assert rows.cell == cell and list(rows.episode) == list(range(1, 21)) and set(rows.status) == {"ok"}
    assert not [message for message in heard if message[0] == "note"]
    name, archive = next(message[1:] for message in heard if message[0] == "checkpoint")
    places = receive(tmp_path, name, lambda parts: unpack(archive, parts))
    assert {each: place.folder for each, place in places.items()} == {cell: name}
    assert json.loads((tmp_path / "checkpoints" / name / "card.json").read_text())["machine"] == kind


def test_its_end_has_a_reason(parcel, monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE, str(tmp_path / "programs"))  # such an end costs the programs that are kept
    with contextlib.closing(Remote(parcel[0], patience=0.2)) as remote:
        assert hear(remote)[-1] == ("ready",)
        remote._worker.process.send_signal(signal.SIGSEGV)
        word, line = hear(remote)[-1]
    assert word == "ended" and line.startswith("a worker process was ended by SIGSEGV, and the compiled programs")
