"""How much memory each process of this run of the tests held at most. A plugin of pytest, loaded by conftest.py."""

import resource
import sys

import pytest

LIMIT = 1.5e9
"""Bytes that a process of the default tier may hold."""

PEAKS = pytest.StashKey[list[int]]()


def peak():
    """Bytes that this process held at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def pytest_configure(config):
    config.stash[PEAKS] = []


def pytest_sessionfinish(session):
    """A worker of xdist tells the process that reports."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["peak"] = peak()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    if told := getattr(node, "workeroutput", {}).get("peak"):
        node.config.stash[PEAKS].append(told)


def pytest_terminal_summary(terminalreporter, config):
    terminalreporter.write_line(words(config.stash[PEAKS] or [peak()], config.option.both_tiers))


def words(peaks, both_tiers):
    """A line, which says where the default tier held more than it may."""
    held = ", ".join(f"{each / 1e9:.2f}" for each in sorted(peaks, reverse=True))
    line = f"memory held at most: {held} GB"
    if both_tiers or max(peaks) <= LIMIT:
        return line
    return f"{line}, more than the {LIMIT / 1e9:g} GB of the default tier"
