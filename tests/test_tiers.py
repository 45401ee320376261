"""Which tests run when: in a project of four tests, two of them slow."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = """
import pytest

class TestOne:
    @pytest.mark.slow
    def test_slow(self):
        pass

@pytest.mark.parametrize("size", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_sizes(size):
    pass

def test_quick():
    pass
"""
LINE = "{} slow tests were left out: make test-all runs every one (pytest: --all)"


@pytest.fixture
def ran(tmp_path):
    """Runs pytest on the project, with these words: what passed, and its last line."""
    (tmp_path / "test_it.py").write_text(PROJECT)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")

    def run(*words):
        ours = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1]), "PYTEST_ADDOPTS": ""}
        ours["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # some load jax
        ours.pop("PYTEST_XDIST_WORKER", None)
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "xdist", "-p", "tests.tiers", "-v", *words],
            cwd=tmp_path,
            env=ours,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        lines = done.stdout.splitlines()
        passed = {line.split()[-1 if "-n" in words else 0] for line in lines if "PASSED" in line}
        return {name.removeprefix("test_it.py::") for name in passed}, lines[-1]

    return run


QUICK = {"test_sizes[1]", "test_quick"}
ALL = QUICK | {"TestOne::test_slow", "test_sizes[2]"}


@pytest.mark.parametrize("words", [["-n0"], ["-n", "2"]], ids=["alone", "xdist"])
def test_what_is_slow_is_left_out_and_told(ran, words):
    assert ran(*words) == (QUICK, LINE.format(2))


def test_what_is_asked_for_runs(ran):
    assert ran("-n0", "--all")[0] == ALL
    assert ran("-n0", "-m", "slow")[0] == ALL - QUICK
    passed, last = ran("-n0", "test_it.py::TestOne", "test_it.py::test_sizes[2]")
    assert passed == ALL - QUICK and "left out" not in last
    assert ran("-n0", "test_it.py::test_sizes")[0] == {"test_sizes[1]", "test_sizes[2]"}


def test_a_selection_counts_only_what_it_would_have_run(ran):
    assert ran("-n0", "-k", "sizes") == ({"test_sizes[1]"}, LINE.format(1).replace("tests were", "test was"))
