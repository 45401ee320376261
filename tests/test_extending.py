"""docs/extending.md, as a reader would follow it: its files are written, its commands typed, its loop run."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import gpcjax
from gpcjax.sweep.store import read_episodes

PAGE = (Path(__file__).parent.parent / "docs" / "extending.md").read_text()
FILES = dict(re.findall(r"```python file=(\S+)\n(.*?)```", PAGE, re.DOTALL))
COMMANDS = re.findall(r"```sh\n(.*?)\n```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files of the page."""
    folder = tmp_path_factory.mktemp("extending")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


def run(folder, *words):
    ours = os.environ | {"PYTHONPATH": str(Path(gpcjax.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=ours,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_page(folder):
    """Every file and every command; a session first, whose record a command replays."""
    said = run(folder, "robot.py")
    corrections, same = re.fullmatch(r"(\d+) corrections, angle .* rad\n(\w+)\n", said).groups()
    assert int(corrections) > 0 and same == "True"
    for command in COMMANDS:
        program, *words = shlex.split(command)
        assert program == "gpcjax"
        run(folder, "-m", "gpcjax", *words)
    outs = {re.search(r"--out runs/(\w+)", command)[1] for command in COMMANDS}
    rows = {out: read_episodes(folder / "runs" / out) for out in outs}
    assert {(frame["status"] == "ok").all() for frame in rows.values()} == {True}
    assert set(rows["linear"]["algo"]) == {"gpc-ns", "mylearner:Linear"}
    assert rows["late"].groupby("delay")["corrections"].sum().gt(0).all()
    assert rows["replayed"]["corrections"].sum() > 0


def test_no_file_is_long():
    """What is said to be 25 lines and 50 is no more."""
    code = {name: [line for line in text.splitlines() if line.strip()] for name, text in FILES.items()}
    assert len(code["mytask.py"]) <= 25 and len(code["mylearner.py"]) <= 25 and len(code["robot.py"]) <= 50
