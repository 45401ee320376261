"""The line about memory at the end of a run of the tests."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import memory

PROJECT = """
import pytest

@pytest.mark.slow
def test_that_is_left_out():
    pass

def test_that_holds_much():
    assert len(b"." * 160_000_000)

def test_that_holds_nothing():
    pass
"""


@pytest.mark.parametrize(
    ("peaks", "both_tiers", "line"),
    [
        ([1.2e9], False, "memory held at most: 1.20 GB"),
        ([0.9e9, 1.4e9], False, "memory held at most: 1.40, 0.90 GB"),
        ([1.6e9], False, "memory held at most: 1.60 GB, more than the 1.5 GB of the default tier"),
        ([1.6e9], True, "memory held at most: 1.60 GB"),
    ],
)
def test_what_it_says(peaks, both_tiers, line):
    assert memory.words(peaks, both_tiers) == line


def test_each_process_tells_what_it_held(tmp_path):
    (tmp_path / "test_it.py").write_text(PROJECT)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    ours = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1]), "PYTEST_ADDOPTS": ""}
    ours["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # some load jax
    ours.pop("PYTEST_XDIST_WORKER", None)
    plugins = ["-p", "xdist", "-p", "tests.tiers", "-p", "tests.memory"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *plugins, "-n", "2"],
        cwd=tmp_path,
        env=ours,
        capture_output=True,
        text=True,
    )
    found = re.search(r"^memory held at most: (\S+), (\S+) GB$", done.stdout, re.MULTILINE)
    assert found, done.stdout + done.stderr
    assert "1 slow test was left out" in done.stdout  # each process has left it out, one tells it
    most, least = map(float, found.groups())
    assert most >= 0.16 and 0 < least < most
