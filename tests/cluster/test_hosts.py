"""Two hosts of one core each, in network namespaces or on loopback: what becomes of a sweep as one of them fails.

Runs of the lander last for seconds, so that there is something to lose. Rows are the plain sweep's in the end.
"""

import json
import os
import signal
import time

import pytest

from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.run import sweep
from tests.cluster.hosts import hosts
from tests.cluster.test_ray import assert_same_rows
from tests.sweep.processes import alive

pytestmark = pytest.mark.slow
SETTINGS = {"env": "lunarlander", "algo": "coach", "seeds": 8, "episodes": 40}
WORDS = [
    "--env",
    "lunarlander",
    "--algo",
    "coach",
    "--seeds",
    "8",
    "--episodes",
    "40",
    "--checkpoint",
    "1",
    "--json",
]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return sweep(tmp_path_factory.mktemp("plain") / "out", **SETTINGS)


@pytest.fixture(scope="module")
def two():
    """They last for all tests of this module: the last one takes the second of them down."""
    with hosts() as made:
        yield made


class Running:
    """A sweep that is driven from the first host, with workers on both."""

    def __init__(self, two, out):
        self.out, self._log = out, out.with_suffix(".log")
        words = ["-m", "gpcjax", "sweep", *WORDS, "--engine", "ray", "--address", "auto", "--out", str(out)]
        with open(self._log, "ab") as log:
            self.process = two[0].python(*words, stdout=log, stderr=log)
        self.until(lambda: all(host.workers() for host in two))
        self.until(lambda: list(out.glob("checkpoints/[0-9]*")))

    def until(self, condition):
        """Waits for it, while the sweep runs."""
        end = time.monotonic() + 300.0
        while not condition():
            assert self.process.poll() is None and time.monotonic() < end, self.log
            time.sleep(0.1)

    def finish(self):
        assert self.process.wait(300) == 0, self.log

    @property
    def log(self):
        return self._log.read_text()

    @property
    def events(self):
        return [json.loads(line) for line in self.log.splitlines() if line.startswith("{")]


def test_a_slow_host(two, plain, tmp_path):
    running = Running(two, tmp_path / "out")
    (worker,) = two[1].workers()
    os.kill(worker, signal.SIGSTOP)
    try:
        running.finish()  # what it has runs on the other one, too
        assert_same_rows(running.out, plain)
        assert "is lost" not in running.log
    finally:
        if alive(worker):
            os.kill(worker, signal.SIGCONT)


def test_a_driver_that_is_killed_and_started_again(two, plain, tmp_path):
    running = Running(two, tmp_path / "out")
    running.process.kill()
    running.process.wait()
    end = time.monotonic() + 60.0
    while any(host.workers() for host in two):  # nobody is left that computes for nobody
        assert time.monotonic() < end
        time.sleep(0.1)
    assert not read_manifest(running.out)["complete"]
    again = Running(two, running.out)
    again.finish()
    assert_same_rows(again.out, plain)


def test_a_host_that_is_lost(two, plain, tmp_path):
    running = Running(two, tmp_path / "out")
    two[1].kill()
    running.finish()
    assert running.log.count("is lost, its runs go to others") == 1
    assert_same_rows(running.out, plain)
    assert read_manifest(running.out)["complete"]
