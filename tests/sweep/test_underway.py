"""Real sweeps that are killed in the middle of their runs and go on from there; and what their runs had learned."""

import json
import os
import re
import shutil
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import gpcjax
from gpcjax import cli
from gpcjax.engine.keeping import Keep
from gpcjax.sweep import build, checkpointing, machine, runs, worker
from gpcjax.sweep import run as run_module
from gpcjax.sweep.checkpoints import HERE, remove_all, survey, told
from gpcjax.sweep.executors import InProcess, Orders
from gpcjax.sweep.keeping import Keeping, KeptRow, keeping_of
from gpcjax.sweep.layout import CHECKPOINTS
from gpcjax.sweep.learned import load_policies, load_states
from gpcjax.sweep.packing import packed, unpacked
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_corrections, read_episodes, read_kept
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.versions import versions
from tests.sweep.pretended import Pretended, rows
from tests.sweep.processes import alive, process, wait_for, workers_of
from tests.torture.underway import FAULTS, torture

HOST = {"env": "lunarlander", "algo": "coach", "seeds": 2, "episodes": 6}
COMPILED = {"env": "cartpole", "algo": "coach", "seeds": 3, "episodes": 6, "oracle": "lqr", "rate": 0.2}
DICTIONARIES = COMPILED | {"algo": "gpc", "max_capacity": 48, "on_full": "replace-nearest", "delta": 0.01}
"""They do not grow: a program is enough (engine/test_keeping.py has those that do, and goes on with them)."""

KEEP = {"keep": "states", "keep_at": 2}


def killed_under_way(folder, settings):
    """A run folder of a sweep that was killed between two chunks of its runs, before any was finished.

    The worker ends itself, right after its second checkpoint; so it does not depend on how fast this machine is.
    """
    out = folder / "out"
    code = f"""
import os, signal
from gpcjax.sweep import checkpointing
from gpcjax.sweep.executors import InProcess, Orders
from gpcjax.sweep.run import sweep
write, count = checkpointing.write_folder, []
def then_end(*arguments):
    write(*arguments)
    count.append(1)
    if len(count) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
checkpointing.write_folder = then_end
checkpointing.SHARE = 1e9
sweep({str(out)!r}, executor=InProcess(), checkpoint=1e-9, **{settings!r})
"""
    from gpcjax.sweep.environment import worker_environment

    with process(["-c", code], folder, env=worker_environment()) as running:
        assert running.wait(300) == -signal.SIGKILL, (folder / "stderr").read_text()
    return out


class Killed(BaseException):
    """A process that is no longer there."""


def copied_under_way(folder, settings):
    """The same without a process of its own: what lay on the disk at the moment when it would have been killed."""
    out, running, write, count = folder / "out", folder / "running", checkpointing.write_folder, []

    def then_copy(*arguments):
        write(*arguments)
        count.append(1)
        if len(count) == 2:
            shutil.copytree(running, out)
            raise Killed

    with pytest.MonkeyPatch.context() as patch, pytest.raises(Killed):
        patch.setattr(checkpointing, "write_folder", then_copy)
        patch.setattr(checkpointing, "SHARE", 1e9)
        sweep(running, executor=InProcess(), checkpoint=1e-9, **settings)
    return out


def sweep_on(out, settings):
    """To the end: here, and among the slow tests by workers, who start anew each time."""
    executor = InProcess() if settings is COMPILED else None
    return sweep(out, executor=executor, checkpoint=0, **KEEP, **settings)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(COMPILED, id="compiled"),
        pytest.param(DICTIONARIES, marks=pytest.mark.slow, id="with dictionaries"),
        pytest.param(HOST, marks=pytest.mark.slow, id="on the host"),
    ],
)
def case(request, tmp_path_factory):
    """Settings, a sweep that was never interrupted, and a folder whose runs were under way when it was killed."""
    settings = request.param
    reference = sweep_on(tmp_path_factory.mktemp("reference") / "out", settings)
    stop = copied_under_way if settings is COMPILED else killed_under_way
    return settings, reference, stop(tmp_path_factory.mktemp("killed"), settings | KEEP)


@pytest.fixture
def killed(case, tmp_path):
    """A copy of that folder."""
    return shutil.copytree(case[2], tmp_path / "out")


def assert_same(out, reference):
    for read in (read_episodes, read_corrections, read_kept):
        pd.testing.assert_frame_equal(read(out), read(reference), check_exact=True)


def steps_of(out):
    return json.loads((out / "manifest.json").read_text())["env_steps"]


def test_it_goes_on_from_there_to_the_same_bits(case, killed):
    settings, reference, _ = case
    assert not list((killed / "episodes").iterdir())
    # The one before the last is not needed any more, but the kill came before it went.
    assert len(list((killed / CHECKPOINTS).iterdir())) == 2
    before = steps_of(killed)
    sweep_on(killed, settings)
    assert_same(killed, reference)
    total = read_episodes(killed)["length"].sum()
    assert 0 < steps_of(killed) - before < total
    assert not (killed / CHECKPOINTS).exists()


def test_a_damaged_checkpoint_costs_time_alone(case, killed, capsys):
    settings, reference, _ = case
    for folder in (killed / CHECKPOINTS).iterdir():
        file = max(
            (path for path in folder.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size
        )
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.write_bytes(data)
    sweep_on(killed, settings)
    said = capsys.readouterr().err
    assert re.search(
        r"2 damaged checkpoints set aside, their runs begin anew \(checkpoints/\d+-\d+-\d+\)", said
    )
    assert len(list((killed / "damaged" / CHECKPOINTS).iterdir())) == 2
    assert_same(killed, reference)


@pytest.mark.parametrize("cases", [len(FAULTS), pytest.param(120, marks=pytest.mark.slow)])
def test_no_spoiled_checkpoint_is_gone_on_with(case, cases):
    judged = list(torture(case[2], cases, seed=1))
    wrong = [f"{name}\n{why}" for name, status, why in judged if status is None]
    assert not wrong, "\n".join(wrong)
    assert {status for _, status, _ in judged} == {"goes on", "begins anew"}


def found(out, settings, **changes):
    cells = set(plan(spec_of(**settings)))
    agree = told(versions(), machine.kind_of(machine.describe()), keeping_of(**KEEP)) | changes
    return survey(out, cells.__contains__, agree, print).get(HERE, {})


def test_what_runs_must_agree_in(case, killed, tmp_path):
    settings = case[0]
    places = found(shutil.copytree(killed, tmp_path / "same"), settings)
    assert set(places) == set(plan(spec_of(**settings)))
    # The newer of the two is further, and the older one is gone.
    left = sorted(path.name for path in (tmp_path / "same" / CHECKPOINTS).iterdir())
    assert {place.folder for place in places.values()} == set(left) and len(left) == 1
    for name, changes in {
        "machine": {"machine": "another"},
        "versions": {"versions": versions() | {"jax": "99"}},
        "keeping": {"keeping": None},
    }.items():
        assert not found(shutil.copytree(killed, tmp_path / name), settings, **changes)
        # For machines of the kind that wrote it, it is still there.
        kept = {path.name for path in (tmp_path / name / CHECKPOINTS).iterdir()}
        assert kept == (set(left) if name == "machine" else set())
    other = settings | {"rate": 0.3}
    assert not found(shutil.copytree(killed, tmp_path / "cells"), other)


def test_what_is_not_ours_stays(case, killed):
    mine = killed / CHECKPOINTS / "mine"
    mine.mkdir()
    (killed / CHECKPOINTS / ".1795690957943205000-7-1-abc").mkdir()
    found(killed, case[0])
    names = {path.name for path in (killed / CHECKPOINTS).iterdir()}
    assert "mine" in names and len(names) == 2
    remove_all(killed)
    assert [path.name for path in (killed / CHECKPOINTS).iterdir()] == ["mine"]


def test_policies_and_states(case):
    settings, reference, _ = case
    policies, states = load_policies(reference), load_states(reference)
    assert policies["episode"].tolist() == states["episode"].tolist() == [2, 4, 6] * settings["seeds"]
    rows = read_episodes(reference).set_index(["seed", "episode"])["return"]
    assert [rows[key] for key in zip(policies["seed"], policies["episode"], strict=True)] == policies[
        "return"
    ].tolist()
    size = policies["policy"][0].controller.obs_size
    obs = np.linspace(-0.3, 0.2, size)
    kept = zip(policies["policy"], states["learner"], states["state"], strict=True)
    for policy, learner, state in list(kept)[:: 4 if len(policies) > 8 else 1]:  # each run, each episode once
        # Another room: the same numbers, added in another order.
        np.testing.assert_allclose(policy(obs), learner.policy_of(state)(obs), rtol=0, atol=1e-12)
        _, info = learner.correct(state, obs, policy(obs), np.ones(learner.action_size))
        assert int(info.status) == 0
    assert len({np.asarray(policy(obs)).tobytes() for policy in policies["policy"]}) == len(policies)
    assert load_policies(reference, seed=1, episode=[2, 6])["episode"].tolist() == [2, 6]
    with pytest.raises(ValueError, match=r"'sead' is no column \(did you mean seed\?\)"):
        load_policies(reference, sead=1)


@pytest.mark.parametrize(
    ("keep", "at", "expected"),
    [
        (None, "last", None),
        ("policies", "last", Keeping("policies")),
        ("states", "best", Keeping("states", best=True)),
        ("policies", "5", Keeping("policies", every=5)),
        ("policies", 5, Keeping("policies", every=5)),
    ],
)
def test_what_is_to_be_kept(keep, at, expected):
    assert keeping_of(keep, at) == expected


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--keep policy", "--keep 'policy': give policies or states (did you mean policies?)"),
        (
            "--keep states --keep-at 0",
            "--keep-at '0': give last, best, or every n-th episode as a whole number",
        ),
        ("--keep states --keep-at fist", "--keep-at 'fist': give last, best"),
        ("--keep-at 3", "--keep-at '3': nothing is kept, give --keep policies or --keep states"),
        ("--checkpoint -1", "--checkpoint -1: give a number of at least 0"),
        (
            "--keep states --algo gpc,drifting:Drawing",
            "--keep: what drifting:Drawing learns cannot be kept, as its state['key'] is no array of numbers",
        ),
    ],
)
def test_mistakes(words, line, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "foreign")
    assert cli.main(["sweep", "--env", "cartpole", *words.split()]) == 2
    assert capsys.readouterr().err.startswith(f"gpcjax: error: {line}")
    assert not list(tmp_path.iterdir())


def test_packed_arrays_are_what_they_were():
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(3, np.int32), "c": np.zeros((0, 2))}
    arrays["d"] = np.array([-0.0, np.nan])
    card, content = packed({"kind": "x"}, arrays)
    told_card, got = unpacked(card, content)
    assert told_card == {"kind": "x"} and list(got) == list(arrays)
    for name, value in arrays.items():
        assert got[name].dtype == value.dtype and got[name].shape == value.shape
        assert got[name].tobytes() == value.tobytes()
    for changed in (content + b"x", content[:-1]):
        with pytest.raises(ValueError):
            unpacked(card, changed)


def test_nothing_was_kept(tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_module, "Processes", Pretended())
        out = sweep(tmp_path / "out", **COMPILED)
    with pytest.raises(ValueError, match="no policies were kept there, give --keep policies"):
        gpcjax.load_policies(out)
    sweep(tmp_path / "kept", executor=InProcess(), **COMPILED | KEEP | {"keep": "policies"})
    assert load_policies(tmp_path / "kept")["episode"].tolist() == [2, 4, 6] * COMPILED["seeds"]
    with pytest.raises(ValueError, match="no states were kept there"):
        load_states(tmp_path / "kept")


@pytest.mark.slow
def test_the_best_alone_is_kept(tmp_path):
    sweep(tmp_path, keep="policies", keep_at="best", executor=InProcess(), **COMPILED)
    returns = read_episodes(tmp_path).groupby("seed")["return"]
    assert load_policies(tmp_path)["episode"].tolist() == [1 + part.argmax() for _, part in returns]


@pytest.mark.parametrize(
    ("keeping", "on_the_way", "kept", "asked"),
    [
        (Keeping("states"), [], [4], None),
        (Keeping("states", every=2), [2, 4], [2, 4], Keep(2, best=False)),
        (Keeping("states", every=3), [3], [3, 4], Keep(3, best=False)),
        (Keeping("states", best=True), [1, 3], [3], Keep(0, best=True)),
        (None, [], [], None),
    ],
)
def test_what_comes_on_the_way_and_at_the_end(keeping, on_the_way, kept, asked, monkeypatch):
    """Of four episodes; what a pool is asked for gives these (engine/test_keeping.py)."""
    cell, said = plan(spec_of(**COMPILED))[0], []
    monkeypatch.setattr(build, "Pool", lambda **given: given["keep"])
    assert build.make_pool(cell, keeping) == asked
    monkeypatch.setattr(runs, "kept_row", lambda what, episode, *others: KeptRow(episode, 0.0, what, "", b""))
    monkeypatch.setattr(runs, "rows_of", lambda cell, lane: rows(cell, 4))
    one = runs.Runs(None, Orders(keeping=keeping), said.append)
    for episode in on_the_way:
        one.keep(SimpleNamespace(name=cell, episode=episode, lane=None))
    one.deliver(SimpleNamespace(name=cell, lane=None))
    ((word, given),) = said
    assert word == "rows" and [(row.kind, row.episode) for row in given.kept] == [
        ("states", each) for each in kept
    ]


def test_no_worker_outlives_its_parent(tmp_path):
    """Killed while the worker is still importing, and while it works."""
    out = tmp_path / "out"
    code = f"from gpcjax.sweep.run import sweep; sweep({str(out)!r}, **{HOST!r})"
    for moment in (lambda workers: True, lambda workers: out.exists() and any(out.glob("manifest.json"))):
        with process(["-c", code], tmp_path) as running:
            wait_for(lambda: workers_of(running.pid) or running.poll() is not None)
            workers = workers_of(running.pid)
            wait_for(lambda moment=moment, workers=workers: moment(workers))
            os.kill(running.pid, signal.SIGKILL)
            running.wait()
            wait_for(lambda workers=workers: not any(map(alive, workers)), 1.0)


def test_runs_come_with_what_they_learned_but_to_workers_that_keep_nothing(monkeypatch):
    """Illustrations and shipped oracles look at it, rows do not."""
    (cell, *_), given = plan(spec_of(**COMPILED)), {}
    monkeypatch.setattr(build, "Pool", lambda **named: given.update(named))
    build.make_pool(cell)
    assert given["learned"]
    for keeping in (None, Keeping("states")):
        worker._Worker(lambda message: None)._pool_for(cell, keeping)
        assert given["learned"] == (keeping is not None)
