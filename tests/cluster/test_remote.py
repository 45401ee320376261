"""A worker as another machine has it: a real process, from a folder that has nothing but what was sent along."""

import contextlib
import pickle
import signal

import pytest

from gpcjax.sweep import machine
from gpcjax.sweep.checkpoints import receive, told
from gpcjax.sweep.executors import Orders
from gpcjax.sweep.executors.remote import Remote
from gpcjax.sweep.parcel import parcel_of, unpack
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.versions import versions
from tests.sweep.processes import alive

TASK = """
import jax
import jax.numpy as jnp
import gpcjax
from goal import GOAL

class Drift(gpcjax.Env):
    obs_size, action_size, max_steps, time_step = 2, 1, 100, 0.05

    def reset(self, key):
        return self.begin(jax.random.uniform(key, (2,), minval=-0.5, maxval=0.5))

    def step(self, state, action):
        place, velocity = state.physics
        velocity += self.time_step * 4.0 * jnp.clip(action[0], -1.0, 1.0)
        place += self.time_step * velocity
        return self.advance(state, jnp.stack([place, velocity]), reward=-(place - GOAL)**2, terminated=False)

def expert(obs):
    return -jnp.clip(obs[:1] + 0.6 * obs[1:], -1.0, 1.0)
"""


@pytest.fixture
def parcel(tmp_path, monkeypatch):
    """A sweep of a task of one's own, asked for where that lies; and its only cell."""
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "ourdrift.py").write_text(TASK)
    (folder / "goal.py").write_text("GOAL = 0.1\n")
    with monkeypatch.context() as there:
        there.chdir(folder)
        there.syspath_prepend(folder)
        spec = spec_of(env="ourdrift:Drift", algo="gpc-ns", oracle="ourdrift:expert", seeds=1, episodes=20)
        return parcel_of(plan(spec)), plan(spec)[0]


@pytest.fixture
def remote(parcel):
    made = Remote(parcel[0], patience=0.2)
    yield made
    with contextlib.suppress(OSError):  # the test has closed it
        made.close()


def hear(remote, answer=None):
    """All that it says until it asks, fails or ends."""
    heard = pickle.loads(remote.hear(None if answer is None else pickle.dumps((answer, {}))))
    while not any(message[0] in ("ready", "next", "failed", "ended") for message in heard):
        heard += pickle.loads(remote.hear())
    return heard


def test_it_computes_with_what_was_sent_and_saves_here(parcel, remote, tmp_path):
    cell = parcel[1]
    kind = machine.kind_of(machine.describe())
    orders = Orders(
        checkpoints="/nowhere/on/this/machine",
        seconds=1e-9,
        agree=told(versions(), "the kind of the desk's", None),
    )
    assert hear(remote)[-1] == ("ready",)
    assert hear(remote, ("program", cell, orders))[-1] == ("next",)
    heard = hear(remote, ("cells", [cell]))
    while heard[-1] == ("next",):  # an empty lane is free for more
        heard += hear(remote, ("cells", []))
    (rows,) = (message[1] for message in heard if message[0] == "rows")
    assert rows.cell == cell and list(rows.episode) == list(range(1, 21)) and set(rows.status) == {"ok"}
    assert len([message for message in heard if message[0] == "compiling"]) > 0
    saved = [message for message in heard if message[0] == "checkpoint"]
    assert saved and not [message for message in heard if message[0] == "note"]
    name, archive = saved[0][1:]
    places = receive(tmp_path, name, lambda parts: unpack(archive, parts))
    assert {each: place.folder for each, place in places.items()} == {cell: name}
    assert f'"machine": "{kind}"' in (tmp_path / "checkpoints" / name / "card.json").read_text()
    folder, process = remote._folder, remote._worker.process
    remote.close()
    assert not folder.exists() and not alive(process.pid)


def test_its_end_has_a_reason(remote):
    assert hear(remote)[-1] == ("ready",)
    remote._worker.process.send_signal(signal.SIGSEGV)
    assert hear(remote)[-1] == ("ended", "a worker process was ended by SIGSEGV")
