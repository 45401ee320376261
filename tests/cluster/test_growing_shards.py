"""Sweeps in shards that grow: also by little, and where a shard is lost."""

import json
import shutil

import pytest

from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.sweep import run as run_module
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.merging import merge
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.shards import Shard
from tests.sweep.pretended import Pretended

SETTINGS = {"env": "mountaincar", "algo": "coach", "episodes": 3}


@pytest.fixture(autouse=True)
def pretended(monkeypatch):
    pretended = Pretended()
    monkeypatch.setattr(run_module, "Processes", pretended)
    return pretended


def run(out, number, **settings):
    return sweep(out, **SETTINGS, **settings, shard=f"{number}/2")


def seeds(out):
    return sorted(set(read_episodes(out)["seed"]))


@pytest.mark.usefixtures("figures_unpainted")
def test_by_fewer_cells_than_shares(tmp_path):
    out = tmp_path / "o"
    for settings in ({"seeds": 4}, {"seeds": "0-4"}, {"seeds": "5-5"}):
        for number in (1, 2):
            run(out, number, **settings)
    assert seeds(merge([out])) == [0, 1, 2, 3, 4, 5]
    assert cli.main(["merge", str(out)]) == 0
    with pytest.raises(UserError, match="shard 1/2: there are 1 cells only, give i/n with n up to that"):
        run(tmp_path / "new", 1, seeds=1)


def test_for_programs_each_line_is_json(tmp_path, capsys):
    words = "sweep --env mountaincar --algo coach --episodes 3 --seeds 4 --jobs 1 --shard 1/2"
    assert cli.main([*words.split(), "--out", str(tmp_path / "o"), "--json"]) == 0
    *_, end, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert (end["event"], end["complete"]) == ("end", True)
    assert last == {"event": "shard", "shard": "1/2", "out": str(Shard(1, 2).folder(tmp_path / "o"))}


@pytest.mark.parametrize(
    ("before", "last"),
    [
        ([{"seeds": 4}], {"seeds": 8}),
        pytest.param([{"seeds": 4}], {"seeds": "4-7"}, marks=pytest.mark.slow),
        ([{"seeds": 4}, {"seeds": 6}], {"seeds": 6, "beta": [3, 5]}),
        pytest.param([{"seeds": 4}, {"seeds": 6}], {"seeds": "9-9"}, marks=pytest.mark.slow),
        pytest.param([{"seeds": 4}, {"seeds": "4-7"}], {"seeds": 8}, marks=pytest.mark.slow),
    ],
)
def test_a_lost_one_is_made_again_by_the_last_command_alone(tmp_path, capsys, before, last):
    out, expected = tmp_path / "o", tmp_path / "expected"
    for whole in (out, expected):
        for settings in [*before, last]:
            for number in (1, 2):
                run(whole, number, **settings)
    shutil.rmtree(Shard(2, 2).folder(out))
    capsys.readouterr()
    again = run(out, 2, **last)
    assert f"gpcjax: {again}: the other shards were asked for other things before" in capsys.readouterr().err
    manifest = read_manifest(again)
    assert manifest["complete"] and manifest["asked"] == read_manifest(Shard(2, 2).folder(expected))["asked"]
    assert read_episodes(merge([out])).equals(read_episodes(merge([expected])))


def test_so_is_one_by_a_command_that_was_nothing_new(tmp_path, capsys):
    """The others have all of it from one request, and no request of its own."""
    out = tmp_path / "o"
    for settings in ({"seeds": 6}, {"seeds": "4-9"}, {"seeds": 3}):
        run(out, 1, **settings)
    capsys.readouterr()
    again = run(out, 2, seeds=3)
    assert f"gpcjax: {again}: the other shards were asked for other things before" in capsys.readouterr().err
    assert seeds(merge([out])) == [*range(10)]


def test_one_that_lost_its_manifest_keeps_its_share(tmp_path):
    """Which depends on what was asked for first, even if it was asked for again since."""
    out, requests = tmp_path / "o", [{"seeds": "4-6"}, {"seeds": 8}, {"seeds": 12}]
    for settings in requests:
        for number in (1, 2):
            run(out, number, **settings)
    one = Shard(1, 2).folder(out)
    before, rows = read_manifest(one), read_episodes(one)
    (one / "manifest.json").write_text("{")
    run(out, 1, **requests[-1])
    assert read_manifest(one)["asked"] == before["asked"] and read_episodes(one).equals(rows)
    assert seeds(merge([out])) == [*range(12)]


def test_a_new_one_grows_with_the_others(tmp_path):
    """What is asked for next was not asked of the others yet."""
    out = tmp_path / "o"
    run(out, 1, seeds=4)
    run(out, 2, seeds=8)
    run(out, 1, seeds=8)
    assert seeds(merge([out])) == [*range(8)]


def test_those_of_another_sweep_are_none(tmp_path):
    out = tmp_path / "o"
    run(out, 1, seeds=4)
    sweep(out, **SETTINGS | {"episodes": 4}, seeds=4, shard="2/2")
    with pytest.raises(UserError, match=r"2-of-2: it is a shard of another sweep than .*1-of-2$"):
        merge([out])


def test_in_another_order_they_have_other_shares(tmp_path):
    """Which is no fault of another version."""
    folders, requests = [], [{"seeds": 5}, {"seeds": "3-9"}]
    for number, asked in ((1, requests), (2, requests[::-1])):
        for settings in asked:
            folder = run(tmp_path / str(number), number, **settings)
        folders.append(folder)
    with pytest.raises(UserError, match=r"it was not asked for the same things as .*, one after the other: "):
        merge(folders, tmp_path / "whole")


def test_elsewhere_the_refusal_says_what_to_do(tmp_path):
    """Shards on disks of their own know nothing of each other."""
    one, other = tmp_path / "one", tmp_path / "other"
    for settings in ({"seeds": 4}, {"seeds": 8}):
        run(one, 1, **settings)
    folders = [Shard(1, 2).folder(one), run(other, 2, seeds=8)]
    message = r"2-of-2: it was not asked for the same things as .*1-of-2, one after the other: run it again into a new "
    with pytest.raises(
        UserError, match=message + r"folder with the commands that `gpcjax show` tells of that one"
    ):
        merge(folders, tmp_path / "whole")
    shutil.rmtree(other)
    run(other, 2, seeds=4)
    with pytest.raises(
        UserError, match=r"2-of-2: it was asked for less than .*1-of-2: give it the later commands"
    ):
        merge(folders, tmp_path / "whole")
    run(other, 2, seeds=8)
    assert seeds(merge(folders, tmp_path / "whole")) == [*range(8)]
