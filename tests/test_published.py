"""Numbers and pictures of README and docs are those that this version makes: else `make publish` is due."""

import json

import pytest

from docs import publish

STALE = "stale: run `make publish`"


@pytest.fixture
def record():
    assert publish.RECORD.exists(), STALE
    return json.loads(publish.RECORD.read_text())


def test_nothing_was_edited_by_hand(record):
    assert publish.published_files(whole=not record["missing"]) == record["files"], STALE
    assert {"README.md: caption", "docs/results.md: results", "docs/cartpole.png"} <= set(record["files"])


def test_the_experiments_are_those_of_the_checkout(record):
    now = publish.specifications()
    assert {name: now[name] for name in record["experiments"]} == record["experiments"], STALE
    assert set(record["experiments"]) | set(record["missing"]) == set(now)


def test_this_version_makes_the_same_of_the_same_data(record):
    assert publish.fingerprint(publish.fixed_data()) == record["drawn"], STALE
