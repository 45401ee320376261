"""What stands behind a name of a person's own may change: no folder takes rows of both."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from gpcjax import make_learner, registry, save_policy
from gpcjax.errors import UserError
from gpcjax.policies.folder import write_folder
from gpcjax.sweep import run as run_module
from gpcjax.sweep.checkpoints import runs_as_json, survey, told
from gpcjax.sweep.code import digests_of_modules
from gpcjax.sweep.digests import ENTRY, digests_of
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.merging import merge
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
from tests.sweep.pretended import Pretended

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


def test_code_that_was_edited_adds_nothing_to_a_folder(tmp_path, modules):
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    assert read_manifest(out)[ENTRY].keys() == {"oracle myrule:act"}
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    for seeds in (1, 2):
        line = refusal(sweep, out, seeds=seeds, **OWN)
        assert line == (
            f"{out}: oracle myrule:act is not what it was when this folder was begun (ruleconsts): bring that back, or "
            "give a new folder (--out)"
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

    def saved(advice):
        save_policy("pol", learner, learner.correct(learner.init(), [-0.4, 0.02], [0.0], [advice])[0])

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


def test_a_folder_of_before_goes_on_and_says_it_from_then_on(tmp_path, modules):
    out = sweep(tmp_path / "out", seeds=1, **OWN)
    manifest = read_manifest(out)
    del manifest[ENTRY]
    write_manifest(out, manifest)
    (modules / "ruleconsts.py").write_text("GAIN = 0.75\n")
    sweep(out, seeds=2, **OWN)
    assert ENTRY in read_manifest(out)
    (modules / "ruleconsts.py").write_text("GAIN = 1\n")
    assert "ruleconsts" in refusal(sweep, out, seeds=3, **OWN)


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


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ("x = 1\n", "# why\nx  =  1\n", True),
        ('def f():\n    "Doc."\n    return 1\n', "def f():\n    return 1\n", True),
        (
            'def f():\n    "Doc."\n    return f.__doc__\n',
            'def f():\n    "Other."\n    return f.__doc__\n',
            False,
        ),
        ("x = 1\n", "x = 1.0\n", False),
        ("x = 0.0\n", "x = -0.0\n", False),
        ("def f(a): return a\n", "def f(a=1): return a\n", False),
        ("x = [1, 2]\n", "x = (1, 2)\n", False),
        ("not python", "not Python", False),
    ],
)
def test_what_of_a_source_counts(tmp_path, monkeypatch, before, after, same):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "rulesource.py").write_text(before)
    first = digests_of_modules(["rulesource"])
    (tmp_path / "rulesource.py").write_text(after)
    assert (digests_of_modules(["rulesource"]) == first) == same and first.keys() == {"rulesource"}


@pytest.mark.parametrize(
    "line",
    [
        "import rulepack.deep.inner",
        "from rulepack.deep import inner",
        "from rulepack.deep.inner import VALUE",
        "def late():\n    from rulepack import chained",
        'import importlib\nx = importlib.import_module("rulepack.deep.inner")',
        'SPEC = dict(make="rulepack.deep.inner:make")',
        "try:\n    import nothing_here\nexcept ImportError:\n    import rulepack.chained",
    ],
)
def test_imports_are_followed_wherever_they_stand(tmp_path, monkeypatch, line):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "rulepack" / "deep").mkdir(parents=True)
    for package in ("rulepack", "rulepack/deep"):
        (tmp_path / package / "__init__.py").write_text("")
    (tmp_path / "rulepack" / "chained.py").write_text("from .deep import inner\nimport numpy, jax, gpcjax\n")
    (tmp_path / "rulepack" / "deep" / "inner.py").write_text("from ...nowhere import x\nfrom . import *\n")
    (tmp_path / "rulesource.py").write_text(f"import os\n{line}\n")
    found = digests_of_modules(["rulesource"])
    assert {"rulesource", "rulepack", "rulepack.deep", "rulepack.deep.inner"} <= found.keys()
    assert found.keys() <= {
        "rulesource",
        "rulepack",
        "rulepack.chained",
        "rulepack.deep",
        "rulepack.deep.inner",
    }
    assert not {"rulepack", "rulesource"} & sys.modules.keys()


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
