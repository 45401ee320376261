"""Figures that several processes paint."""

import json
import os
import subprocess
import sys

import pytest

from gpcjax.report.figures import painted
from tests.report.painting import ASKED


@pytest.fixture(scope="module")
def answers():
    """What was wrong with each, by its name; in a process without jax."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.report.painting"], capture_output=True, text=True, timeout=300
    )
    assert not done.returncode, done.stderr
    return dict(map(json.loads, done.stdout.splitlines()))


@pytest.mark.parametrize("function", ASKED, ids=lambda function: function.__name__)
def test(answers, function):
    assert not answers[function.__name__]


def test_where_jax_is_there_are_no_copies(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2})
    monkeypatch.setitem(sys.modules, "jax", sys)
    assert set(painted.spread(lambda item: os.getpid(), range(3))) == {os.getpid()}
