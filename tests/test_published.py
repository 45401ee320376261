"""Numbers and pictures of README and docs are those that this version makes: else `make publish` is due."""

import json
import shutil
from pathlib import Path

import pytest

from docs import publish

ROOT = publish.ROOT
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


def test_publishing_writes_each_block_between_its_marks(record, tmp_path, monkeypatch, capsys):
    """Of experiments made of formulas, in a copy of the pages: what is not run is not touched, all else is new."""
    for name in ("RECORD", "PAGES", "ROOT"):
        monkeypatch.setattr(publish, name, tmp_path / getattr(publish, name).relative_to(publish.ROOT))
    shutil.copytree(ROOT / "docs" / "reproduction", publish.PAGES)
    pages = {tmp_path / page.relative_to(ROOT): names for page, names in publish.BLOCKS.items()}
    for page in pages:
        shutil.copy(ROOT / page.relative_to(tmp_path), page)
    before = {page: page.read_text() for page in pages}
    monkeypatch.setattr(publish, "BLOCKS", pages)
    monkeypatch.setattr(publish, "results_of", lambda folder: publish.fixed_data())
    publish.publish(Path("nowhere"))
    assert "not run yet" in capsys.readouterr().err
    now = {page: page.read_text() for page in pages}
    changed = [page.name for page in pages if now[page] != before[page]]
    assert changed == ["README.md", "results.md"]  # thesis.md has what a whole reproduction alone can make
    results = tmp_path / "docs" / "results.md"
    assert "| 0% | COACH | 1030 [" in now[results]
    for text in (before, now):
        assert text[results].startswith("# Final returns") and text[results].rstrip().endswith("15 episodes.")
    kept = json.loads(publish.RECORD.read_text())
    assert set(kept["files"]) == {"docs/cartpole.png", "README.md: caption", "docs/results.md: results"}
    assert set(record["files"]) > set(kept["files"])
