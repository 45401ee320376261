"""Which tests run when: in a project of four tests, two of them slow."""

import json
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
END = "the end of a run\n"
RUNS = f"""
import json, sys
import pytest

for words in json.loads(sys.argv[1]):
    assert pytest.main(["-p", "xdist", "-p", "tests.tiers", "-v", *words]) == 0
    print({END!r}, end="", flush=True)
"""
"""In one process: most of a run is what it imports."""

LINE = "{} slow tests were left out: make test-all runs every one (pytest: --all)"


@pytest.fixture
def ran(tmp_path):
    """Runs pytest on the project, with each of these words: what passed, and the last line."""
    (tmp_path / "test_it.py").write_text(PROJECT)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")

    def run(*runs):
        ours = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1]), "PYTEST_ADDOPTS": ""}
        ours["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # some load jax
        ours.pop("PYTEST_XDIST_WORKER", None)
        done = subprocess.run(
            [sys.executable, "-c", RUNS, json.dumps(runs)],
            cwd=tmp_path,
            env=ours,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return [told(text, "-n" in words) for text, words in zip(done.stdout.split(END), runs, strict=False)]

    def told(text, by_others):
        lines = text.splitlines()
        passed = {line.split()[-1 if by_others else 0] for line in lines if "PASSED" in line}
        return {name.removeprefix("test_it.py::") for name in passed}, lines[-1]

    return run


QUICK = {"test_sizes[1]", "test_quick"}
ALL = QUICK | {"TestOne::test_slow", "test_sizes[2]"}


@pytest.mark.slow
def test_of_several_processes_one_tells_it(ran):
    assert ran(["-n", "2"]) == [(QUICK, LINE.format(2))]


def test_what_is_slow_is_left_out_unless_it_is_asked_for(ran):
    usual, chosen, whole, slow, named, of_all_sizes = ran(
        ["-n0"],
        ["-n0", "-k", "sizes"],
        ["-n0", "--all"],
        ["-n0", "-m", "slow"],
        ["-n0", "test_it.py::TestOne", "test_it.py::test_sizes[2]"],
        ["-n0", "test_it.py::test_sizes"],
    )
    assert usual == (QUICK, LINE.format(2))
    # A selection counts only what it would have run.
    assert chosen == ({"test_sizes[1]"}, LINE.format(1).replace("tests were", "test was"))
    assert whole[0] == ALL and slow[0] == named[0] == ALL - QUICK and "left out" not in named[1]
    assert of_all_sizes[0] == {"test_sizes[1]", "test_sizes[2]"}
