"""Numbers and pictures of README and docs are those that this version makes: else `make publish` is due."""

import json

from docs import publish

RECORD = json.loads(publish.RECORD.read_text())
STALE = "stale: run `make publish`"


def test_nothing_was_edited_by_hand():
    assert publish.published_files() == RECORD["files"], STALE
    assert {"README.md: caption", "README.md: results", "README.md: claims"} <= set(RECORD["files"])


def test_the_experiments_are_those_of_the_checkout():
    now = publish.specifications()
    assert {name: now[name] for name in RECORD["experiments"]} == RECORD["experiments"], STALE
    assert set(RECORD["experiments"]) | set(RECORD["missing"]) == set(now)
    page = (publish.PAGES / "README.md").read_text()
    for name in RECORD["missing"]:
        assert f"not run: {name}" in page


def test_this_version_makes_the_same_of_the_same_data():
    assert publish.fingerprint(publish.fixed_data()) == RECORD["drawn"], STALE
