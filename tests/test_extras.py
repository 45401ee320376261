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


def assert_told(extra, status, out, err, folder):
    assert (status, out) == (2, "")
    assert err.startswith("gpcjax: error: ") and err.count("\n") == 1
    assert f"pip install 'gpcjax[{extra}]'" in err
    assert not list(folder.iterdir())


ALL = """
import contextlib, io, json, sys
sys.modules.update(dict.fromkeys({hidden!r}))
from gpcjax.cli import main
told = dict()
for extra, words in {asking!r}.items():
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        status = main(words)
    told[extra] = status, out.getvalue(), err.getvalue()
print(json.dumps(told))
"""


def test_missing_extras_are_a_line_each(tmp_path):
    """One after the other in one process, which has the first module of none."""
    code = ALL.format(hidden=[*FIRST.values()], asking=ASKING)
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    told = json.loads(done.stdout)
    assert told.keys() == ASKING.keys()
    for extra, given in told.items():
        assert_told(extra, *given, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("extra", "module"), NEEDED)
def test_a_missing_module_is_one_line(extra, module, tmp_path):
    done = without([module], ASKING[extra], tmp_path)
    assert_told(extra, done.returncode, done.stdout, done.stderr, tmp_path)


def test_each_extra_is_known_here_and_in_the_lock():
    assert set(EXTRAS) == set(ASKING) == {extra for extra, _ in NEEDED}
    makefile = (ROOT / "Makefile").read_text()
    assert all(f"--extra {extra} " in makefile for extra in EXTRAS)


@pytest.mark.slow
def test_without_any_extra_policies_are_evaluated(tmp_path):
    hidden = [name for _, name in NEEDED if name != "mujoco"]  # brax has that one
    done = without(hidden, ["policy", "eval", "mountaincar:pump", "--episodes", "2", "--json"], tmp_path)
    assert done.returncode == 0 and json.loads(done.stdout)["mean"] > 90
