"""Where an extra is not installed, one line says what to install; what needs none works without any."""

import json
import sys
import tomllib
from pathlib import Path

import pytest

from gpcjax import cli

ROOT = Path(__file__).parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]

ASKING = {
    "teach": ["teach", "--env", "mountaincar"],
    "cluster": ["sweep", "--env", "mountaincar", "--seeds", "1", "--engine", "ray"],
    "tune": ["tune", "--env", "mountaincar", "--method", "tpe", "--search", "noise=1e-8:1e-6"],
    "mujoco": ["sweep", "--env", "gym:HalfCheetah-v5", "--algo", "gpc-ns", "--dry-run"],
    "onnx": ["policy", "export", "cartpole:gpc", "--to", "onnx"],
}
NEEDED = [
    *(("teach", name) for name in ("starlette", "uvicorn", "websockets")),
    ("cluster", "ray"),
    ("tune", "optuna"),
    *(("mujoco", name) for name in ("mujoco", "imageio")),
    ("onnx", "onnx"),
]


def hide(monkeypatch, *names):
    """As if they were not installed; what has imported them is imported again, where somebody asks."""
    for name in names:
        monkeypatch.setitem(sys.modules, name, None)
    for name in tuple(sys.modules):
        if name.startswith(("gymnasium.envs.mujoco", "gpcjax.teach.server", "gpcjax.teach.room")):
            monkeypatch.delitem(sys.modules, name)


@pytest.mark.parametrize(("extra", "module"), NEEDED)
def test_a_missing_extra_is_one_line(extra, module, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gpcjax.deploy.command.compute_here", lambda: None)
    hide(monkeypatch, module)
    assert cli.main(ASKING[extra]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("gpcjax: error: ") and err.count("\n") == 1
    assert f"pip install 'gpcjax[{extra}]'" in err
    assert not list(tmp_path.iterdir())


def test_each_extra_is_known_here_and_in_the_lock():
    assert set(EXTRAS) == set(ASKING) == {extra for extra, _ in NEEDED}
    makefile = (ROOT / "Makefile").read_text()
    assert all(f"--extra {extra} " in makefile for extra in EXTRAS)


def test_without_any_extra_policies_are_evaluated_and_exported(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gpcjax.deploy.command.compute_here", lambda: None)
    hide(monkeypatch, *(name for _, name in NEEDED if name != "mujoco"))
    assert cli.main(["policy", "eval", "mountaincar:pump", "--episodes", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean"] > 90
    assert cli.main(["policy", "export", "cartpole:gpc", "--out", "x.h"]) == 0
