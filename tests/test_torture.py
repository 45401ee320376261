"""A sample of `make torture`: every fault alone, and a few together."""

import subprocess
import sys
from pathlib import Path

import pytest

import gpcjax
from gpcjax.sweep.spec import spec_of
from tests.torture import folders, shards
from tests.torture.faults import FAULTS

ALL = len(FAULTS)


def wrong(judged):
    """The cases that were not right, and why."""
    return "\n".join(f"{name}\n{why}" for name, status, why in judged if status is None)


@pytest.fixture
def half_as_large(monkeypatch):
    """Sweeps of four runs, each in a part of its own: those of GPC."""
    for name, seeds in (("FIRST", 1), ("SPEC", 2)):
        monkeypatch.setattr(folders, name, spec_of(algo="gpc", seeds=seeds, **folders.SETTINGS))


@pytest.mark.usefixtures("half_as_large")
def test_every_fault_is_found_in_a_small_folder():
    _judge(ALL, sealed=True)


@pytest.mark.slow
@pytest.mark.parametrize(("sealed", "cases"), [(True, 42), (False, ALL)])
def test_every_fault_is_found(sealed, cases):
    _judge(cases, sealed)


def _judge(cases, sealed):
    judged = list(folders.torture(cases, seed=1, sealed=sealed))
    assert not wrong(judged)
    # And what could be mended was: of a store with sums only another's manifest stands in the way.
    refused = {name.partition(": ")[2] for name, status, _ in judged if status == "refused"}
    assert all("manifest: " in name for name in refused)
    if sealed:
        assert all("manifest: of another sweep" in name for name in refused)
        assert sum(status == "computed again" for _, status, _ in judged) > cases / 2


@pytest.mark.parametrize("cases", [6, pytest.param(shards.OF * ALL, marks=pytest.mark.slow)])
def test_nothing_is_merged_of_spoiled_shards_but_rows_of_the_sweep(cases):
    judged = list(shards.torture(cases, seed=1))
    assert not wrong(judged)
    assert sum(status == "merged when it had run again" for _, status, _ in judged) > cases / 2


PRIVATE = """
import runpy, sys
from tests.torture.disk import in_private

module = sys.argv.pop(1)
in_private(module)
runpy.run_module(module, run_name="__main__")
"""
"""Before the module is imported, which would be done twice."""


@pytest.mark.parametrize(
    ("module", "cases"),
    [
        ("disks", 3),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (("disks", 60), ("disks_saving", 60), ("disks_underway", 4))
        ),
    ],
)
def test_disks_become_full_or_read_only_and_folders_go(module, cases):
    """In a process that mounts them for itself and forks."""
    words = ["-c", PRIVATE, f"tests.torture.{module}", "--cases", str(cases)]
    root = Path(gpcjax.__file__).parents[1]
    done = subprocess.run([sys.executable, *words], cwd=root, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
