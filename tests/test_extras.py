"""Where an extra is not installed, one line says what to install; what needs none works without any."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

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


SCRIPT = """
import sys
sys.modules.update(dict.fromkeys({hidden!r}))
from gpcjax.cli import main
sys.exit(main({words!r}))
"""
"""A process of its own: in this one, others have imported all of them."""


def without(hidden, words, folder):
    """`gpcjax WORDS` as if these modules were not installed."""
    return subprocess.run(
        [sys.executable, "-c", SCRIPT.format(hidden=hidden, words=words)],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


FIRST = {extra: module for extra, module in reversed(NEEDED)}


@pytest.mark.parametrize(
    ("extra", "module"),
    [pytest.param(*each, marks=[] if FIRST[each[0]] == each[1] else [pytest.mark.slow]) for each in NEEDED],
)
def test_a_missing_extra_is_one_line(extra, module, tmp_path):
    done = without([module], ASKING[extra], tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("gpcjax: error: ") and done.stderr.count("\n") == 1
    assert f"pip install 'gpcjax[{extra}]'" in done.stderr
    assert not list(tmp_path.iterdir())


def test_each_extra_is_known_here_and_in_the_lock():
    assert set(EXTRAS) == set(ASKING) == {extra for extra, _ in NEEDED}
    makefile = (ROOT / "Makefile").read_text()
    assert all(f"--extra {extra} " in makefile for extra in EXTRAS)


@pytest.mark.slow
def test_without_any_extra_policies_are_evaluated(tmp_path):
    hidden = [name for _, name in NEEDED if name != "mujoco"]  # brax has that one
    done = without(hidden, ["policy", "eval", "mountaincar:pump", "--episodes", "2", "--json"], tmp_path)
    assert done.returncode == 0 and json.loads(done.stdout)["mean"] > 90
