"""What travels with a sweep: exactly what it names, found where Python and the command find it."""

import json
import os
import subprocess
import sys

import pytest

from gpcjax import elsewhere, registry
from gpcjax.describe import TaskSpec
from gpcjax.errors import UserError
from gpcjax.making import Maker
from gpcjax.sweep import parcel
from gpcjax.sweep.parcel import CODE, parcel_of
from gpcjax.sweep.plan import plan
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import spec_of

CELL = plan(spec_of(env="cartpole", algo="coach", seeds=1, oracle="lqr"))[0]


def named(**changes):
    """A cell that names something else."""
    return CELL.__class__(**{**vars(CELL), **changes})


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A person's present folder, with modules, a policy, and what has nothing to do with it."""
    folder = tmp_path / "here"
    files = {
        "mytask.py": "import numpy, beside\nfrom apackage.inner import thing\nimport none_such\n",
        "beside.py": "import json\n",
        "apackage/__init__.py": "",
        "apackage/inner.py": "thing = 1\n",
        "apackage/table.txt": "1 2 3",
        "apackage/__pycache__/inner.pyc": "",
        "another.py": "",
        "policy/card.json": "{}",
        "states/manifest.json": "{}",
        "states/checkpoints/1/card.json": "{}",
        "record.jsonl": "",
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.chdir(folder)
    return folder


def opened(cells, tmp_path):
    """The names of the files of a parcel where it was opened, and where each path lies."""
    folder = tmp_path / "there"
    folder.mkdir()
    paths = parcel_of(cells).open(folder)
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()), paths


def test_what_is_built_in_or_installed_stays(here, tmp_path):
    assert opened(
        [CELL, named(env="gym:Pendulum-v1", algo="numpy:array", oracle="json:loads")], tmp_path
    ) == ([], {})
    assert (tmp_path / "there" / CODE).is_dir()


def test_modules_with_what_they_import_from_beside_them(here, tmp_path):
    files, paths = opened([named(env="mytask:Drift")], tmp_path)
    names = ["apackage/__init__.py", "apackage/inner.py", "apackage/table.txt", "beside.py", "mytask.py"]
    assert files == [f"{CODE}/{name}" for name in names] and paths == {}


def test_what_descriptions_name_in_their_turn(here, tmp_path, monkeypatch):
    """What makes the task and its expert lie in modules, and in a folder, that the description does not import."""
    (here / "described.py").write_text("")
    (here / "making.py").write_text("")
    make = type("Made", (), {"__module__": "making"})
    spec = TaskSpec(
        "described:TASK", Maker("env", make, lambda made: made), {"own": "another:expert", "saved": "policy"}
    )
    monkeypatch.setitem(registry._FOUND, ("task", spec.name), (spec, None))
    files, paths = opened(
        [named(env=spec.name, oracle="own"), named(env=spec.name, oracle="saved")], tmp_path
    )
    assert {f"{CODE}/{name}.py" for name in ("described", "making", "another")} < set(files)
    assert set(paths) == {"policy"}


def test_folders_and_files_by_the_names_that_they_have_here(here, tmp_path):
    cells = [
        named(oracle="policy"),
        named(oracle=str(here / "policy")),
        named(teacher="replay:record.jsonl"),
        named(start=Source(str(here / "states"), "0" * 12)),
    ]
    files, paths = opened([*cells, *cells], tmp_path)
    assert len(files) == 4 and not any("checkpoints" in name for name in files)
    assert set(paths) == {"policy", str(here / "policy"), "record.jsonl", str(here / "states")}
    assert os.path.isfile(paths["record.jsonl"]) and os.path.isfile(
        os.path.join(paths["policy"], "card.json")
    )


def test_what_is_too_large(here, monkeypatch):
    monkeypatch.setattr(parcel, "LARGEST", 10)
    with pytest.raises(UserError, match="too large to be sent to other machines"):
        parcel_of([named(env="mytask:Drift")])


def test_a_path_lies_where_it_was_sent_to_and_a_tilde_at_home(tmp_path):
    (tmp_path / "policy").mkdir()
    code = (
        "from gpcjax.elsewhere import path_here; print(path_here('mine'), path_here('~/x'), path_here('y'))"
    )
    environment = {**os.environ, elsewhere.VARIABLE: json.dumps({"mine": "/there/mine"}), "HOME": "/home/me"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["/there/mine", "/home/me/x", "y"]
