"""What of its runs a folder keeps: its manifest says it, and nothing else is mixed in."""

import json
import shlex

import pytest

from gpcjax import cli
from gpcjax.cli import words
from gpcjax.errors import UserError
from gpcjax.sweep import run as run_module
from gpcjax.sweep.keeping import Keeping, held_keeping
from gpcjax.sweep.listing import commands
from gpcjax.sweep.manifest import DamagedManifest, read_manifest, write_manifest
from gpcjax.sweep.merging import merge
from gpcjax.sweep.reading import read_kept
from gpcjax.sweep.run import sweep
from gpcjax.sweep.shards import Shard
from gpcjax.sweep.spec import make_spec, spec_of
from tests.sweep.pretended import Pretended

SETTINGS = {"env": "mountaincar", "algo": "coach", "episodes": 3}


@pytest.fixture(autouse=True)
def pretended(monkeypatch):
    """Workers that keep states where anything is kept."""

    class Keeps(Pretended):
        def run(self, desk):
            self.kept = desk.orders.keeping is not None
            super().run(desk)

    pretended = Keeps()
    monkeypatch.setattr(run_module, "Processes", pretended)
    return pretended


def old(out):
    """The manifest as versions before wrote it."""
    manifest = {
        name: value for name, value in read_manifest(out).items() if name not in ("keeping", "sha256")
    }
    write_manifest(out, manifest)


@pytest.mark.parametrize(
    ("first", "then", "difference"),
    [
        ({}, {"keep": "states"}, r"nothing, not states after the last episode: give no --keep"),
        (
            {"keep": "policies"},
            {},
            r"policies after the last episode, not nothing: give --keep policies",
        ),
        (
            {"keep": "states", "keep_at": "best"},
            {"keep": "states", "keep_at": 5},
            r"states after the best episode, not states after every 5 episodes and the last: "
            r"give --keep states --keep-at best",
        ),
    ],
)
def test_something_else_is_refused(tmp_path, pretended, first, then, difference):
    out = sweep(tmp_path / "o", **SETTINGS, seeds=4, **first)
    before = sorted(path.name for path in out.rglob("*"))
    message = rf"^{out}: of its runs it keeps {difference}, or a new folder \(--out\)$"
    with pytest.raises(UserError, match=message):
        sweep(out, **SETTINGS, seeds=6, **then)
    assert sorted(path.name for path in out.rglob("*")) == before and len(pretended.calls) == 1
    sweep(out, **SETTINGS, seeds=6, **first)
    assert len(read_kept(out)) == (6 if first else 0)


def test_a_complete_folder_is_asked_for_what_it_does_not_keep(tmp_path):
    out = sweep(tmp_path / "o", **SETTINGS, seeds=4)
    with pytest.raises(UserError, match="of its runs it keeps nothing, not states"):
        sweep(out, **SETTINGS, seeds=4, keep="states")


def test_to_ask_for_nothing_where_nothing_runs_is_no_difference(tmp_path, pretended):
    """As a report of a folder that keeps something; unless some of it was lost."""
    out = sweep(tmp_path / "o", **SETTINGS, seeds=4, keep="states")
    sweep(out, **SETTINGS, seeds=4)
    assert len(pretended.calls) == 1
    next((out / "episodes").iterdir()).unlink()
    with pytest.raises(UserError, match=r"of its runs it keeps states .* not nothing"):
        sweep(out, **SETTINGS, seeds=4)


def test_the_flags_are_checked_before_anything_is_made(tmp_path, monkeypatch, capsys, pretended):
    monkeypatch.chdir(tmp_path)
    out = sweep(tmp_path / "o", **SETTINGS, seeds=4)
    typed = shlex.split("sweep --env mountaincar --algo coach --episodes 3 --seeds 6 --out o --keep states")
    assert cli.main([*typed, "--dry-run"]) == 2 and cli.main(typed) == 2
    assert capsys.readouterr().err.count("error: o: of its runs it keeps nothing, not states") == 2
    assert len(pretended.calls) == 1 and read_manifest(out)["cells"] == 4


def test_an_older_manifest_does_not_say(tmp_path, capsys):
    out = sweep(tmp_path / "o", **SETTINGS, seeds=4)
    old(out)
    capsys.readouterr()
    sweep(out, **SETTINGS, seeds=4, keep="states")
    told = f"gpcjax: {out}: its manifest does not say what of its runs is kept: those that are there stay as they are"
    assert told in capsys.readouterr().err.splitlines()
    sweep(out, **SETTINGS, seeds=6, keep="states")
    assert "keeping" not in read_manifest(out) and set(read_kept(out)["seed"]) == {4, 5}
    assert cli.main(["show", str(out)]) == 0
    assert "keeps" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "entry", ["states", {"what": "all", "every": 0, "best": False}, {"what": "states"}, 3]
)
def test_a_damaged_entry(tmp_path, entry):
    out = sweep(tmp_path / "o", **SETTINGS, seeds=1)
    write_manifest(out, {**read_manifest(out), "keeping": entry})
    with pytest.raises(DamagedManifest, match="its keeping is damaged"):
        read_manifest(out)


def test_shards_that_keep_something_else_are_not_merged(tmp_path):
    out = tmp_path / "o"
    sweep(out, **SETTINGS, seeds=6, shard="1/2", keep="states")
    second = sweep(out, **SETTINGS, seeds=6, shard="2/2")
    message = "2-of-2: of its runs it keeps nothing, .*1-of-2 states after the last episode: run one again"
    with pytest.raises(UserError, match=message):
        merge([out])
    old(second)  # of an earlier version: nobody knows
    assert "keeping" not in read_manifest(merge([out]))


def test_a_whole_keeps_what_its_shards_keep(tmp_path):
    out = tmp_path / "o"
    for shard in ("1/2", "2/2"):
        sweep(out, **SETTINGS, seeds=6, shard=shard, keep="states", keep_at="best")
    assert held_keeping(read_manifest(merge([out]))) == Keeping("states", best=True)
    assert len(read_kept(out)) == 6


def test_show_tells_it_and_how_to_go_on(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = sweep("o", **SETTINGS, seeds=6, shard="2/2", keep="policies", keep_at=5)
    (line,) = commands(read_manifest(out), out)
    given = words.settings(words.parse_words(shlex.split(line)[1:]))
    assert {name: given[name].value for name in ("keep", "keep_at", "shard", "out")} == {
        "keep": "policies",
        "keep_at": "5",
        "shard": "2/2",
        "out": "o",
    }
    assert make_spec(given) == spec_of(**SETTINGS, seeds=6)
    assert Shard(2, 2).folder(tmp_path / given["out"].value) == tmp_path / out
    assert cli.main([*shlex.split(line)[1:], "--dry-run"]) == 0
    capsys.readouterr()
    assert cli.main(["show", str(out)]) == 0
    assert "policies after every 5 episodes and the last" in capsys.readouterr().out
    assert cli.main(["show", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["keeping"]["what"] == "policies"
    out.rename(tmp_path / "brought")
    (line,) = commands(read_manifest(tmp_path / "brought"), tmp_path / "brought")
    assert line.endswith(
        "--out " + str(tmp_path / "brought") + "  # where this folder is shards/2-of-2 of that one"
    )
