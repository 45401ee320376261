"""Two tiers of tests: the default has one good test of each thing; what is marked `slow` runs where all are asked for.

`make test` is the first, `make test-all` both. Slow are repetitions of a claim that a quicker test makes too: over
further learners, tasks and sizes, in whole processes, over whole pages. A plugin of pytest, loaded by conftest.py.
"""

import pytest

LEFT_OUT = pytest.StashKey[int]()
"""How many tests this run has left out."""


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", dest="both_tiers", help="run what is marked slow too")


def pytest_configure(config):
    config.stash[LEFT_OUT] = 0


@pytest.hookimpl(trylast=True)  # after -k: what that leaves out is not ours
def pytest_collection_modifyitems(config, items):
    """Leaves out what is slow, unless all is asked for, or a test by its own name or by its marker."""
    if config.option.both_tiers or config.option.markexpr:
        return
    named = [argument.split("::") for argument in config.args if "::" in argument]
    slow = [item for item in items if item.get_closest_marker("slow") and not _is_named(item, named)]
    config.stash[LEFT_OUT] = len(slow)
    if slow:
        items[:] = [item for item in items if item not in set(slow)]
        config.hook.pytest_deselected(items=slow)


def _is_named(item, named):
    """Whether `FILE::NAME`, or that of its class or of all its parameters, was given."""
    for file, *names in named:
        if (item.config.invocation_params.dir / file).resolve() != item.path:
            continue
        own = item.nodeid.split("::")[1:][: len(names)]
        if own[:-1] == names[:-1] and (own[-1] == names[-1] or own[-1].startswith(f"{names[-1]}[")):
            return True
    return False


def pytest_sessionfinish(session):
    """A worker of xdist tells the process that reports."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = session.config.stash[LEFT_OUT]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Each worker has collected all tests; one that crashed has told nothing."""
    told = getattr(node, "workeroutput", {}).get("left_out", 0)
    node.config.stash[LEFT_OUT] = max(node.config.stash[LEFT_OUT], told)


def pytest_unconfigure(config):
    """The last line of all."""
    count, reporter = config.stash[LEFT_OUT], config.pluginmanager.get_plugin("terminalreporter")
    if count and reporter and not hasattr(config, "workerinput"):
        tests = "test was" if count == 1 else "tests were"
        reporter.write_line(f"{count:,} slow {tests} left out: make test-all runs every one (pytest: --all)")
