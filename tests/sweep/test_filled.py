"""Rows of a setting that began to vary later, in folders that were asked for one learner after the other."""

import shutil

import pyarrow.parquet as pq
import pytest

from gpcjax.sweep import parts
from gpcjax.sweep import run as run_module
from gpcjax.sweep import store as store_module
from gpcjax.sweep.blocks import block_of
from gpcjax.sweep.growth import algos_of
from gpcjax.sweep.layout import parse_part
from gpcjax.sweep.listing import contents, look
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.merging import merge
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_corrections, read_episodes, read_kept
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.sweep.pretended import Pretended, rows

BASE = {"env": "cartpole", "error": 0.1, "seeds": 2, "episodes": 3, "oracle": "lqr"}
GPC, COACH, BOTH = ({"algo": algo} for algo in ("gpc", "coach", ["gpc", "coach"]))
NAME, USUAL = "human_length_scale", 0.2
"""A setting that concerns GPC alone, and its value on cart-pole."""
OTHER = GPC | {NAME: 0.3}


@pytest.fixture
def pretended(monkeypatch):
    pretended = Pretended(kept=True)
    monkeypatch.setattr(run_module, "Processes", pretended)
    return pretended


def ask(out, pretended, *requests, **more):
    """How many cells each of these ran."""
    counts = []
    for request in requests:
        pretended.calls.clear()
        sweep(out, **(BASE | request), keep="states", **more)
        counts.append(sum(len(cells) for cells, *_ in pretended.calls))
    return counts


def lose(out):
    """All rows, but not the manifest."""
    for folder in ("episodes", "corrections", "kept"):
        shutil.rmtree(out / folder)


def values(out):
    """Of the setting, by learner, in each table."""
    frames = [read(out) for read in (read_episodes, read_corrections, read_kept)]
    return [
        {
            algo: sorted(each[NAME].dropna().unique()) + ["none"] * bool(each[NAME].isna().any())
            for algo, each in frame.groupby("algo")
        }
        for frame in frames
    ]


def right(out):
    """Whether GPC has both values in each table, and COACH none."""
    return values(out) == 3 * [{"gpc": [USUAL, 0.3], "coach": ["none"]}]


def named_right(out):
    """Whether each part is named after a request that asked for its learners."""
    manifest = read_manifest(out)
    return all(
        {*pq.read_table(path, columns=["algo"]).column("algo").to_pylist()} <= algos_of(manifest, named.hash)
        for path in (out / "episodes").iterdir()
        if (named := parse_part(path.name))
    )


@pytest.fixture
def as_before(monkeypatch):
    """Rows go under the one request, whichever learners it asked for: as versions before did."""

    def only(self, algos):
        return self._origin.hash

    monkeypatch.setattr(Store, "_request_of", only)
    return monkeypatch


def after_a_loss(out, pretended):
    """GPC, then COACH in the same folder; what was lost of both is asked for by both at once."""
    assert ask(out, pretended, GPC, COACH) == [2, 2]
    lose(out)
    assert ask(out, pretended, BOTH) == [4]


def grown_right(out, pretended):
    assert ask(out, pretended, OTHER) == [2]
    assert right(out)
    assert ask(out, pretended, GPC, COACH, OTHER) == [0, 0, 0]
    assert contents(look(out)).finished == look(out).cells == 6


def test_rows_go_under_a_request_that_asked_for_their_learner(tmp_path, pretended):
    after_a_loss(tmp_path, pretended)
    assert named_right(tmp_path) and len(list((tmp_path / "episodes").iterdir())) == 2
    grown_right(tmp_path, pretended)


def test_a_request_that_was_interrupted(tmp_path, monkeypatch, pretended):
    monkeypatch.setattr(run_module, "Processes", Pretended(fails_after=1, kept=True))
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path, **(BASE | GPC), keep="states")
    monkeypatch.setattr(run_module, "Processes", pretended)
    assert ask(tmp_path, pretended, COACH, BOTH) == [2, 1]
    assert named_right(tmp_path)
    grown_right(tmp_path, pretended)


def test_what_went_under_another_request_is_read_right(tmp_path, pretended, as_before):
    after_a_loss(tmp_path, pretended)
    as_before.undo()
    as_before.setattr(run_module, "Processes", pretended)
    assert not named_right(tmp_path)
    grown_right(tmp_path, pretended)
    # Nor is it put together with what its request asked for.
    as_before.setattr(store_module, "TOGETHER", 3)
    assert ask(tmp_path, pretended, *(COACH | {"seeds": seeds} for seeds in range(3, 8))) == [1] * 5
    assert right(tmp_path) and ask(tmp_path, pretended, GPC, OTHER) == [0, 0]


def test_so_is_what_was_put_together_without_its_value(tmp_path, pretended, as_before):
    """There the column is no longer missing."""
    as_before.setattr(parts, "filled_in_order", lambda *_: {NAME: {"gpc": None, "coach": None}})
    after_a_loss(tmp_path, pretended)
    assert ask(tmp_path, pretended, OTHER) == [2]
    manifest = read_manifest(tmp_path)
    store = Store(tmp_path, manifest, request=manifest["asked"][1]["hash"])
    store.missing([])
    (wrong,) = [path.name for path in (tmp_path / "episodes").iterdir() if path.name.startswith("part-00000")]
    store._put_together([wrong], "", store._origin.hash)
    assert values(tmp_path)[0]["gpc"] == [0.3, "none"]
    as_before.undo()
    assert right(tmp_path)


def test_a_shard_that_is_begun_after_the_sweep_has_grown(tmp_path, pretended):
    """It is asked for all at once: each learner goes under its own request."""
    assert ask(tmp_path, pretended, GPC | {"seeds": 4}, COACH, shard="1/2") == [2, 1]
    assert ask(tmp_path, pretended, COACH, shard="2/2") == [3]
    assert all(named_right(each) for each in (tmp_path / "shards").iterdir())
    merge([tmp_path])
    assert ask(tmp_path, pretended, OTHER) == [2]
    assert right(tmp_path) and ask(tmp_path, pretended, GPC | {"seeds": 4}, COACH) == [0, 0]


def test_so_does_a_block_of_several_learners(tmp_path, pretended):
    """As a worker of another machine hands it in."""
    ask(tmp_path, pretended, GPC, COACH)
    lose(tmp_path)
    store = Store(tmp_path, read_manifest(tmp_path), request=read_manifest(tmp_path)["asked"][1]["hash"])
    cells = [
        cell
        for pair in zip(*(plan(spec_of(**(BASE | one))) for one in (GPC, COACH)), strict=True)
        for cell in pair
    ]
    store.append([block_of([rows(cell, kept=True) for cell in cells], ())])
    assert named_right(tmp_path) and len(read_episodes(tmp_path)) == 12 and len(read_kept(tmp_path)) == 4
    grown_right(tmp_path, pretended)


def test_rows_of_a_learner_whom_nobody_has_asked_for_are_damaged(tmp_path, pretended, capsys):
    """Their settings are not known."""
    ask(tmp_path, pretended, GPC)
    manifest = read_manifest(tmp_path)
    Store(tmp_path, manifest).append([rows(cell, kept=True) for cell in plan(spec_of(**(BASE | COACH)))])
    write_manifest(tmp_path, manifest)
    ask(tmp_path, pretended, OTHER)
    assert ": it has rows of coach, which nobody has asked for)" in capsys.readouterr().err
    assert {*read_episodes(tmp_path)["algo"]} == {"gpc"} and len(
        list((tmp_path / "damaged").rglob("*.parquet"))
    ) == 3
