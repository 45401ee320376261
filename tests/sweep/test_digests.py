"""What stands behind a name of a person's own may change: no folder takes rows of both."""

import dataclasses
import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from gpcjax import make_learner, registry, save_policy
from gpcjax.errors import UserError
from gpcjax.policies.folder import write_folder
from gpcjax.sweep import changed, digests, merging, worker
from gpcjax.sweep import run as run_module
from gpcjax.sweep.checkpoints import runs_as_json, survey, told
from gpcjax.sweep.digests import ENTRY, Loaded, digests_of
from gpcjax.sweep.executors.base import Orders
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.merging import merge
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
from tests.sweep.pretended import BASELINE, Pretended

EXPERT = "from ruleconsts import GAIN\nfrom rulework import *\n\ndef act(obs):\n    return GAIN * obs[1:]\n"
OWN = {"env": "mountaincar", "algo": "coach", "oracle": "myrule:act", "episodes": 3}


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """The folder of a person's expert, and of what it imports."""
    folder = tmp_path / "code"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.chdir(folder)
    (folder / "myrule.py").write_text(EXPERT)
    (folder / "ruleconsts.py").write_text("GAIN = 0.5\n")
    (folder / "rulework.py").write_text("import os\n")
    yield folder
    for name in [name for name in sys.modules if name.startswith(("myrule", "ruleconsts", "rulework"))]:
        del sys.modules[name]


@pytest.fixture(autouse=True)
def pretended(monkeypatch):
    monkeypatch.setattr(run_module, "Processes", Pretended())


def refusal(function, *arguments, **settings):
    with pytest.raises(UserError) as error:
        function(*arguments, **settings)
    return str(error.value)


def test_code_that_was_edited_adds_nothing_to_a_folder(tmp_path, modules, capsys):
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    assert read_manifest(out)[ENTRY].keys() == {"oracle myrule:act"}
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    assert refusal(sweep, out, seeds=2, **OWN) == (
        f"{out}: oracle myrule:act is not what it was when this folder was begun (ruleconsts): bring that back, or "
        "give a new folder (--out)"
    )
    capsys.readouterr()
    assert sweep(out, seeds=1, **OWN) == out
    assert capsys.readouterr().err == (
        f"gpcjax: {out}: oracle myrule:act changed since its rows were made, which stay as they are\n"
    )
    assert before == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    (modules / "ruleconsts.py").write_text('"""Numbers."""\nGAIN = 0.5  # as it was\n')
    assert len(read_episodes(sweep(out, seeds=2, **OWN))) == 6


def test_parts_say_it_where_the_manifest_is_lost(tmp_path, modules):
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    (out / "manifest.json").unlink()
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    assert "(ruleconsts): bring that back" in refusal(sweep, out, seeds=2, **OWN)
    (modules / "ruleconsts.py").write_text("GAIN = 0.5\n")
    assert len(read_episodes(sweep(out, seeds=2, **OWN))) == 6


def test_an_expert_that_was_saved_again_is_another_one(tmp_path, monkeypatch):
    learner = make_learner("coach", "mountaincar")

    def saved(weight):
        save_policy("pol", learner, jax.tree.map(lambda leaf: leaf + weight, learner.init()))

    monkeypatch.chdir(tmp_path)
    saved(1.0)
    settings = OWN | {"oracle": "pol"}
    out = sweep(tmp_path / "out", seeds=1, **settings)
    (tmp_path / "pol").rename(tmp_path / "old")
    saved(-1.0)
    assert "oracle pol is not what it was when this folder was begun (its files)" in refusal(
        sweep, out, seeds=2, **settings
    )
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "old").rename(tmp_path / "elsewhere" / "pol")
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert len(read_episodes(sweep(out, seeds=2, **settings))) == 6  # the same one, wherever it lies


def test_code_may_be_edited_until_there_are_rows(tmp_path, modules, monkeypatch):
    """As it is after Ctrl-C: what was measured of it goes, too."""
    stopped, whole = Pretended(fails_after=0), Pretended()
    monkeypatch.setattr(run_module, "Processes", stopped)
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "out", seeds=1, **OWN)
    manifest = read_manifest(tmp_path / "out")
    first = manifest[ENTRY]["oracle myrule:act"]
    assert manifest["baselines"]["oracles"].keys() == {"myrule:act"}
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    monkeypatch.setattr(run_module, "Processes", whole)
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    assert whole.calls[0][1] == [("mountaincar", "myrule:act")]
    now = read_manifest(out)[ENTRY]["oracle myrule:act"]
    assert now != first and now == digests_of(spec_of(seeds=1, **OWN))["oracle myrule:act"]
    (modules / "ruleconsts.py").write_text("GAIN = 0.5\n")
    assert "(ruleconsts): bring that back" in refusal(sweep, out, seeds=2, **OWN)


def test_a_task_that_was_edited_is_measured_anew():
    known = {"idle": BASELINE, "oracles": {"a:b": BASELINE, "c:d": BASELINE}}
    for name, left in (
        ("env t:T", {"idle": None, "oracles": {}}),
        ("oracle a:b", {"idle": BASELINE, "oracles": {"c:d": BASELINE}}),
        ("algo a:b", known),
    ):
        manifest = {"baselines": known}
        changed._forget_baselines(manifest, name)
        assert manifest == {"baselines": left}


def test_runs_under_way_are_held_to_their_code(tmp_path, modules, monkeypatch):
    monkeypatch.setattr(run_module, "Processes", Pretended(fails_after=0))
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "out", seeds=1, **OWN)
    manifest, cell = read_manifest(tmp_path / "out"), plan(spec_of(seeds=1, **OWN))[0]
    card = told(manifest["versions"], "another", None, manifest[ENTRY])
    path = tmp_path / "out" / "checkpoints" / "1795715941520164536-10949-0"
    write_folder(path, {"kind": "checkpoint", **card, "runs": runs_as_json([(cell, 1)])}, {"a": np.ones(1)})
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    assert "(ruleconsts): bring that back" in refusal(sweep, tmp_path / "out", seeds=1, **OWN)
    assert path.exists()


def test_a_folder_grows_by_what_was_written_beside_what_has_all_its_rows(tmp_path, modules):
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    before = read_manifest(out)[ENTRY]
    (modules / "myrule.py").write_text(f"{EXPERT}\ndef other(obs):\n    return obs[:1]\n")
    del sys.modules["myrule"]
    both = OWN | {"oracle": "myrule:act,myrule:other"}
    assert len(read_episodes(sweep(out, seeds=1, **both))) == 6
    after = read_manifest(out)[ENTRY]
    assert after["oracle myrule:act"] == before["oracle myrule:act"] != after["oracle myrule:other"]
    assert "oracle myrule:act is not what it was" in refusal(sweep, out, seeds=2, **both)


def test_other_versions_are_told_first(tmp_path, modules):
    """They may read the same code as another one."""
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    manifest = read_manifest(out)
    write_manifest(out, manifest | {"versions": manifest["versions"] | {"python": "3.9.0"}})
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    assert "begun with python 3.9.0" in refusal(sweep, out, seeds=2, **OWN)


def test_a_worker_computes_nothing_with_code_that_was_edited_meanwhile(modules, monkeypatch):
    spec = spec_of(seeds=1, **OWN)
    cell, held = plan(spec)[0], digests_of(spec)
    pool = SimpleNamespace(template=SimpleNamespace(learner=None))
    monkeypatch.setattr(worker, "make_pool", lambda *arguments: pool)
    monkeypatch.setattr(worker, "refuse_another_environment", lambda: None)

    def words(agree):
        said = []

        def say(message):
            said.append(message)
            return ("program", cell, Orders(agree=agree)) if message == ("ready",) else None

        assert not worker.work(say)
        return said[-1]

    assert words({ENTRY: held})[0] == words({})[0] == "failed"  # a pool that is none: it began
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    assert words({})[0] == "failed"
    assert words({ENTRY: held}) == (
        "refused",
        "oracle myrule:act is not what it was when this sweep was begun (ruleconsts): it was edited meanwhile (give "
        "the command again), or another one is on this machine",
    )
    # What was installed on one of two machines is followed on the other alone.
    Loaded().refuse_other(cell, {"oracle myrule:act": {"myrule": held["oracle myrule:act"]["myrule"]}})


def test_a_worker_that_stays_computes_with_what_it_has_imported(modules):
    """Whatever is on the disk by then: a search has the same workers for hours, and folders that begin late."""
    spec = spec_of(seeds=1, **OWN)
    cell, first, loaded = plan(spec)[0], digests_of(spec), Loaded()
    loaded.refuse_other(cell, first)
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    then = digests_of(spec)
    loaded.refuse_other(cell, first)
    assert "(ruleconsts): it was edited meanwhile" in refusal(loaded.refuse_other, cell, then)
    Loaded().refuse_other(cell, then)


def test_a_folder_of_before_goes_on_and_says_it_from_then_on(tmp_path, modules, capsys):
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    manifest = read_manifest(out)
    del manifest[ENTRY]
    write_manifest(out, manifest)
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    capsys.readouterr()
    sweep(out, seeds=2, **OWN)
    assert (
        f"{out}: its manifest does not say what oracle myrule:act was when its rows were made: it is held to what it "
        "is now\n" in capsys.readouterr().err
    )
    assert ENTRY in read_manifest(out)
    (modules / "ruleconsts.py").write_text("GAIN = 1\n")
    assert "ruleconsts" in refusal(sweep, out, seeds=3, **OWN)


def test_libraries_whose_versions_are_told_are_no_code_of_ones_own():
    assert digests._parts_of_expert("numpy.linalg:norm") == digests._parts_of_expert(np.zeros) == {}


def test_what_is_built_in_is_not_noted(tmp_path):
    assert digests_of(spec_of(env="cartpole", oracle="lqr,gpc")) == {}
    assert ENTRY not in read_manifest(sweep(tmp_path / "out", env="mountaincar", algo="coach", seeds=1))


def test_shards_of_other_code_do_not_fit_together(tmp_path, modules):
    out, parts = tmp_path / "out", []
    for number, gain in ((1, 0.5), (2, 0.75)):
        (modules / "ruleconsts.py").write_text(f"GAIN = {gain}\n")
        parts.append(sweep(out, seeds=4, shard=f"{number}/2", **OWN))
    assert refusal(merge, [out]) == (
        f"{parts[1]}: its oracle myrule:act is another one than that of {parts[0]}: run one again into a new folder"
    )


def test_shards_are_held_to_all_before_them(tmp_path, modules):
    """The first one need not say what it had."""
    out = tmp_path / "out"
    parts = [sweep(out, seeds=6, shard=f"{number}/3", **OWN) for number in (1, 2, 3)]
    manifest = read_manifest(parts[0])
    del manifest[ENTRY]
    write_manifest(parts[0], manifest)
    manifest = read_manifest(parts[2])
    manifest[ENTRY] = {"oracle myrule:act": {"myrule": "0"}}
    write_manifest(parts[2], manifest)
    assert refusal(merge, [out]) == (
        f"{parts[2]}: its oracle myrule:act is another one than that of {parts[1]}: run one again into a new folder"
    )
    shares = [merging._share(*each) for each in merging._found(parts)]
    older = manifest | {"versions": manifest["versions"] | {"python": "3.9.0"}}
    shares[2] = dataclasses.replace(shares[2], manifest=older)
    assert "made with python 3.9.0" in refusal(merging._checked, shares)  # which read code otherwise


def test_a_run_does_not_go_on_with_other_code(tmp_path):
    here = told({"jax": "0"}, "machine", None, {"algo a:B": {"a": "1"}, "algo c:D": {"c": "1"}})
    same = told({"jax": "0"}, "machine", None, {"algo a:B": {"a": "1"}})
    other = told({"jax": "0"}, "machine", None, {"algo a:B": {"a": "2"}})
    cell = plan(spec_of(env="mountaincar", algo="coach", seeds=1))[0]
    old = {name: value for name, value in same.items() if name != ENTRY}
    for agree, goes_on in ((same, True), (other, False), (old, True)):
        path = tmp_path / "checkpoints" / "1795715941520164536-10949-0"
        shutil.rmtree(path, ignore_errors=True)
        write_folder(
            path, {"kind": "checkpoint", **agree, "runs": runs_as_json([(cell, 1)])}, {"a": np.ones(1)}
        )
        places = survey(tmp_path, lambda cell: True, here, print)
        assert bool(places) == goes_on == path.exists()


def test_tasks_learners_and_teachers_by_every_kind_of_name(monkeypatch, tmp_path):
    foreign = Path(__file__).parents[1] / "foreign"
    monkeypatch.syspath_prepend(str(foreign))
    registry._entry_points.cache_clear()
    try:
        named = digests_of(spec_of(env="drifting:Drift", algo="drifting:Linear", oracle="drifting:expert"))
        assert named.keys() == {"env drifting:Drift", "algo drifting:Linear", "oracle drifting:expert"}
        assert {tuple(parts) for parts in named.values()} == {("drifting",)}
        entered = digests_of(spec_of(env="drift", algo="linear", oracle="drifting:expert"))
        assert entered["env drift"] == named["env drifting:Drift"]
    finally:
        registry._entry_points.cache_clear()
        for kind, name in [key for key in registry._FOUND if key[1] not in registry.built_in(key[0])]:
            del registry._FOUND[kind, name]


def test_a_recording_is_told_by_its_content(tmp_path):
    lines = [
        {"format": 1, "settings": {}, "place": {}},
        {"event": "advise", "advice": [1], "episode": 0, "step": 0, "time": 0},
    ]
    file = tmp_path / "session.jsonl"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    found = []
    for more in ("", json.dumps(lines[1]) + "\n"):
        file.write_text(file.read_text() + more)
        found.append(digests_of(spec_of(env="mountaincar", teacher=f"replay:{file}", algo="coach")))
    assert found[0] != found[1] and found[0].keys() == {f"teacher replay:{file}"}
    assert digests_of(spec_of(env="mountaincar", teacher=str(tmp_path), algo="coach")).keys() == {
        f"teacher {tmp_path}"
    }
