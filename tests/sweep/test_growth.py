"""Run folders that are asked for more, with workers that are only pretended."""

import dataclasses
import itertools
import json
import shutil

import numpy as np
import pandas as pd
import pytest

from gpcjax.errors import UserError
from gpcjax.sweep import growth, origin, store
from gpcjax.sweep import run as run_module
from gpcjax.sweep.growth import covering, grown, hashes
from gpcjax.sweep.layout import GROWN
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.opening import new_manifest
from gpcjax.sweep.parts import origins_of
from gpcjax.sweep.plan import count, plan, specification_hash, varying
from gpcjax.sweep.reading import load, read_corrections, read_episodes, read_kept
from gpcjax.sweep.run import sweep
from gpcjax.sweep.runfolder import check_sweep
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import as_dict, spec_of
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun, manifest_of
from tests.sweep.pretended import Pretended, rows

BASE = {"env": "cartpole", "algo": ["gpc", "coach"], "error": 0.1, "seeds": 2, "episodes": 3, "oracle": "lqr"}
KEYS = ["algo", "oracle", "error", "seed", "episode"]
PRESET = 1.0
"""The policy's length-scale of GPC on cart-pole (Table 5.2)."""


@pytest.fixture
def pretended(monkeypatch):
    pretended = Pretended()
    monkeypatch.setattr(run_module, "Processes", pretended)
    return pretended


def ran(pretended):
    """The cells of the last sweep."""
    return pretended.calls[-1][0]


def grow(out, pretended, *requests):
    """The folder after each request, and what each of them ran."""
    counts = []
    for request in requests:
        before = len(pretended.calls)
        sweep(out, **(BASE | request))
        counts.append(len(ran(pretended)) if len(pretended.calls) > before else 0)
    return counts


@pytest.mark.parametrize(
    ("requests", "counts", "seeds"),
    [
        ([{}, {"seeds": 5}, {"seeds": 3}], [4, 6, 0], 5),
        ([{}, {"seeds": "10-12"}, {"seeds": "11-14"}], [4, 6, 4], "0-1,10-14"),
        ([{"seeds": "1-2"}, {"seeds": 1}], [4, 2], 3),
        ([{}, {"error": [0.1, 0.2]}, {"error": [0, 0.2]}], [4, 4, 4], 2),
        ([{"algo": "coach"}, {"algo": "gpc-ns"}, {"algo": ["gpc", "coach"]}], [2, 2, 2], 2),
        ([{}, {"oracle": ["lqr", "gpc"]}], [4, 4], 2),
        ([{}, {"delta": [0.05, 0.1]}, {"rate": [0.05, 0.5]}], [4, 4, 4], 2),
        ([{}, {"error": 0.3, "seeds": "7-7"}], [4, 2], "0-1,7"),
    ],
    ids=["seeds", "range", "before", "errors", "learners", "oracles", "teacher", "corner"],
)
def test_what_is_missing_runs_and_all_is_read(tmp_path, pretended, requests, counts, seeds):
    assert grow(tmp_path, pretended, *requests) == counts
    frame, manifest = read_episodes(tmp_path), read_manifest(tmp_path)
    keys = [*KEYS, *manifest["varying"]]
    assert len(frame) == 3 * sum(counts) and not frame.duplicated(keys).any()
    assert frame[keys].notna().all().all()
    assert manifest["complete"] and manifest["cells"] == sum(counts)
    assert manifest["specification"]["seeds"] == seeds
    assert len(manifest["asked"]) == sum(map(bool, counts)) and manifest["format"] == GROWN
    assert load(tmp_path).equals(frame)


def test_the_rows_are_those_of_one_sweep(tmp_path, pretended):
    grow(
        tmp_path / "grown",
        pretended,
        {"seeds": 1, "delta": 0.1},
        {"delta": [0.05, 0.1], "policy_variance": [0.1, 0.2]},
    )
    grow(tmp_path / "grown", pretended, {"delta": 0.05, "policy_variance": [0.2, 0.3]})
    sweep(tmp_path / "whole", **(BASE | {"delta": [0.05, 0.1], "policy_variance": [0.1, 0.2, 0.3]}))
    for read in (read_episodes, read_corrections):
        grown, whole = read(tmp_path / "grown"), read(tmp_path / "whole")
        both = whole.merge(grown, how="left", indicator=True)
        missing = both[both["_merge"] != "both"]
        # 0.3 was asked with delta 0.05 only; the first request had the usual variance, which the second has not.
        assert set(zip(missing["policy_variance"], missing["delta"], strict=True)) == {(0.3, 0.1)}


def test_the_usual_value_is_told_from_given_ones(tmp_path, pretended):
    counts = grow(
        tmp_path, pretended, {"algo": "gpc"}, {"policy_length_scale": [0.2, PRESET], "algo": "gpc"},
        {"algo": ["gpc", "coach"]},
    )  # fmt: skip
    assert counts == [2, 2, 2]  # what is usual is there already
    frame = read_episodes(tmp_path)
    values = frame.groupby("algo")["policy_length_scale"].agg(lambda each: sorted(set(each)))
    assert values["gpc"] == [0.2, PRESET] and frame[frame.algo == "coach"]["policy_length_scale"].isna().all()
    corrections = read_corrections(tmp_path)
    assert set(corrections[corrections.algo == "gpc"]["policy_length_scale"]) == {0.2, PRESET}


def test_a_setting_that_nobody_knows_is_refused(tmp_path, pretended):
    sweep(tmp_path, **BASE)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match=r"static_rate was not given to gpc in one of the two"):
        sweep(tmp_path, **(BASE | {"static_rate": 0.1}))
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"episodes": 4}, "episodes 3, not 4"),
        ({"sparsify": False}, "sparsify True, not False"),
        ({"max_capacity": 64, "on_full": "drop"}, "on_full 'error', not 'drop', max_capacity 1024, not 64"),
        ({"rate_schedule": [0.1, 0.2]}, r"rate_schedule as usual, not \[0.1, 0.2\]"),
        ({"env": "pendulum", "oracle": "energy", "algo": "coach"}, "env 'cartpole', not 'pendulum'"),
    ],
)
def test_what_contradicts_is_refused_with_the_difference(tmp_path, pretended, change, what):
    sweep(tmp_path, **BASE)
    with pytest.raises(UserError, match=rf"it holds another specification \({what}"):
        check_sweep(tmp_path, spec_of(**(BASE | change)))


def test_seeds_that_are_not_held_are_not_taken_for_held(tmp_path):
    """Together they are more than a sweep has, which is said, and not forgotten."""
    half = {"env": "mountaincar", "algo": "coach", "episodes": 1}
    spec, other = (spec_of(**half, seeds=seeds) for seeds in ("0-599999", "600000-1199999"))
    assert (spec.seeds | other.seeds).spans == ((0, 1_199_999),)
    assert covering(manifest_of(spec), other) is None and covering(manifest_of(spec), spec) is not None
    message = r"^1,200,000 seeds in all: a folder has 1,000,000 at most, give a new one \(--out\)$"
    with pytest.raises(UserError, match=message):
        check_sweep(begun(tmp_path, spec), other)
    with pytest.raises(UserError, match=message):
        grown(manifest_of(spec), other)


def test_another_version_is_refused(tmp_path, pretended, monkeypatch):
    sweep(tmp_path, **BASE)
    versions = origin.versions()
    monkeypatch.setattr(origin, "versions", lambda: {**versions, "jax": "99"})
    with pytest.raises(UserError, match=r"it was begun with jax .*, this is 99"):
        sweep(tmp_path, **(BASE | {"seeds": 3}))


def test_an_earlier_request_that_was_interrupted_is_not_complete(tmp_path, monkeypatch):
    failing = Pretended(fails_after=1)
    monkeypatch.setattr(run_module, "Processes", failing)
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path, **BASE)
    monkeypatch.setattr(run_module, "Processes", Pretended())
    sweep(tmp_path, **(BASE | {"error": 0.2}))
    assert not read_manifest(tmp_path)["complete"] and len(load(tmp_path)) == 3 * 5
    sweep(tmp_path, **BASE)
    assert read_manifest(tmp_path)["complete"] and len(load(tmp_path)) == 3 * 8


@pytest.mark.parametrize("what", ["damaged", "gone"])
def test_rows_of_another_request_that_are_lost_are_missing(tmp_path, pretended, capsys, what):
    """A request that has all of its own rows runs nothing, and does not leave a folder that says to be complete."""
    grow(tmp_path, pretended, {}, {"error": 0.2})
    first = next((tmp_path / "episodes").glob("part-00000-*"))
    first.write_bytes(b"x")
    if what == "gone":
        first.unlink()
    capsys.readouterr()
    assert grow(tmp_path, pretended, {"error": 0.2}) == [0]
    manifest = read_manifest(tmp_path)
    assert (manifest["complete"], manifest["finished"], manifest["cells"]) == (False, 4, 8)
    if what == "damaged":
        moved = f"1 damaged part moved to {tmp_path / 'damaged'}"
        said = capsys.readouterr().err
        assert f"{moved}, what is missing runs again by the command that asked for it (gpcjax show) (" in said
    assert grow(tmp_path, pretended, {}) == [4]
    assert read_manifest(tmp_path)["complete"] and len(load(tmp_path)) == 3 * 8


@pytest.mark.parametrize("asked", [0, 1], ids=["by the first request", "by the second"])
def test_a_lost_manifest_is_made_anew_from_the_parts(tmp_path, pretended, asked):
    requests = [{}, {"seeds": "5-6", "error": 0.2}]
    grow(tmp_path, pretended, *requests)
    before, rows = read_manifest(tmp_path), read_episodes(tmp_path)
    (tmp_path / "manifest.json").unlink()
    assert grow(tmp_path, pretended, requests[asked]) == [0]
    after = read_manifest(tmp_path)
    if asked == 1:  # parts that were written before the second request know nothing of it
        assert after["cells"] == before["cells"] and after["specification"]["seeds"] == "0-1,5-6"
        pd.testing.assert_frame_equal(read_episodes(tmp_path), rows)
    assert grow(tmp_path, pretended, *requests[asked:]) == [0] * (2 - asked)
    pd.testing.assert_frame_equal(read_episodes(tmp_path), rows)


@pytest.mark.parametrize("asked", [0, 1, 2])
def test_so_is_one_of_requests_that_later_ones_cover(tmp_path, pretended, capsys, asked):
    """Parts have the hash of the request that they were made for, whichever of them has asked for their cells since."""
    requests = [{}, {"seeds": "1-3"}, {"seeds": 5}]
    assert grow(tmp_path, pretended, *requests) == [4, 4, 2]
    before, rows = read_manifest(tmp_path), read_episodes(tmp_path)
    (tmp_path / "manifest.json").write_text("{")
    capsys.readouterr()
    assert grow(tmp_path, pretended, requests[asked]) == [0]
    after = read_manifest(tmp_path)
    assert [after[name] for name in ("asked", "hash", "cells")] == [
        before[name] for name in ("asked", "hash", "cells")
    ]
    pd.testing.assert_frame_equal(read_episodes(tmp_path), rows)
    assert "not rows of this sweep" not in capsys.readouterr().err


def test_a_larger_request_makes_a_lost_manifest_anew(tmp_path, pretended, capsys):
    """Parts say what they are of: who asks for more need not have asked for it before."""
    assert grow(tmp_path, pretended, {}, {"error": 0.3}) == [4, 4]
    (tmp_path / "manifest.json").unlink()
    capsys.readouterr()
    assert grow(tmp_path, pretended, {"error": [0.1, 0.3], "seeds": 3}) == [4]
    said = capsys.readouterr().err
    assert "is missing: made anew from the parts" in said and "it grows by 4 to 12 cells" in said
    manifest = read_manifest(tmp_path)
    assert manifest["complete"] and [each["specification"]["seeds"] for each in manifest["asked"]] == [
        2,
        2,
        3,
    ]
    assert len(load(tmp_path)) == 12 * 3
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(UserError, match="it holds rows of another sweep and no manifest"):
        grow(tmp_path, pretended, {"episodes": 4})


def test_so_it_knows_what_of_its_runs_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "Processes", Pretended(kept=True))
    for seeds in (2, 3):
        sweep(tmp_path, **(BASE | {"seeds": seeds}), keep="states", keep_at="best")
        (tmp_path / "manifest.json").unlink()
    with pytest.raises(
        UserError, match="of its runs it keeps states after the best episode, not nothing: give --keep"
    ):
        sweep(tmp_path, **(BASE | {"seeds": 4}))
    sweep(tmp_path, **(BASE | {"seeds": 4}), keep="states", keep_at="best")
    assert read_manifest(tmp_path)["keeping"] == {"what": "states", "every": 0, "best": True}
    assert len(load(tmp_path)) == 8 * 3 and len(read_kept(tmp_path)) == 8


def test_parts_of_many_requests_are_put_together(tmp_path, pretended, monkeypatch):
    """And say all that was asked for, each request in one of them; so no part grows with the number of requests."""
    monkeypatch.setattr(store, "TOGETHER", 4)  # which so few of them have, too: parts of parts
    requests = [
        {"algo": "gpc", "seeds": f"{number}-{number}", "noise": 0.1 + number / 100} for number in range(18)
    ]
    assert sum(grow(tmp_path, pretended, *requests)) == 18
    assert grow(tmp_path, pretended, {"algo": "coach"}, {"algo": "coach", "error": 0.5}) == [2, 2]
    assert len(list((tmp_path / "episodes").iterdir())) < 8
    before, rows = read_manifest(tmp_path), read_episodes(tmp_path)
    assert len(rows) == 22 * 3 and len(read_corrections(tmp_path)) == 22 * 2
    gpc = rows[rows["algo"] == "gpc"].drop_duplicates("seed")
    assert (
        np.array_equal(gpc["noise"], 0.1 + gpc["seed"] / 100)
        and rows[rows["algo"] == "coach"]["noise"].isna().all()
    )
    named = [each.named for each in origins_of(tmp_path)]
    assert sum(map(len, named)) < 2 * 20 and {*itertools.chain(*named)} == {*hashes(before)}
    (tmp_path / "manifest.json").unlink()
    assert grow(tmp_path, pretended, requests[3]) == [0]
    after = read_manifest(tmp_path)
    assert [each["hash"] for each in after["asked"]] == [each["hash"] for each in before["asked"]]
    pd.testing.assert_frame_equal(read_episodes(tmp_path), rows)
    # A setting that begins to vary has the value that it had, of each request that a part has rows of.
    assert grow(tmp_path, pretended, requests[0] | {"rate": 0.5}) == [1]
    rates = load(tmp_path).drop_duplicates(["algo", "error", "seed", "rate", "noise"])["rate"]
    assert rates.value_counts().to_dict() == {0.05: 22, 0.5: 1}


def test_what_several_requests_have_asked_for_together_is_nothing_new(tmp_path, pretended, capsys):
    """It grew by no cell, which left it unfinished, and with a further request for ever."""
    requests = [{}, {"seeds": "2-4"}, {"error": 0.2}, {"seeds": "2-4", "error": 0.2}]
    assert grow(tmp_path, pretended, *requests) == [4, 6, 4, 6]
    before = read_manifest(tmp_path)
    capsys.readouterr()
    assert grow(tmp_path, pretended, {"seeds": "1-3", "error": [0.1, 0.2]}, {"seeds": 5}) == [0, 0]
    assert read_manifest(tmp_path) == before and "grows" not in capsys.readouterr().err
    assert grow(tmp_path, pretended, {"seeds": "4-6", "error": [0.1, 0.2, 0.3]}) == [14]
    # What was lost is made again, under the hash of one of these requests.
    for folder in ("episodes", "corrections"):
        shutil.rmtree(tmp_path / folder)
    assert grow(tmp_path, pretended, {"seeds": 5, "error": [0.1, 0.2]}) == [20]
    assert len(load(tmp_path)) == 20 * 3


def test_a_folder_that_grew_step_by_step_is_as_if_it_had_been_asked_at_once():
    """What is known of earlier requests is not worked out anew: it comes to the same."""
    steps = [
        {"algo": "gpc"},
        {
            "algo": "gpc",
            "seeds": "3-4",
            "points": [{"policy_length_scale": 0.3}, {"policy_length_scale": 2.0}],
        },
        {"algo": ["coach", "gpc-ns"], "error": [0.3, 0.1]},
        {"algo": "gpc", "points": [{"policy_length_scale": 0.3, "human_length_scale": 0.7}], "delta": 0.1},
        {"algo": "gpc", "human_length_scale": [0.7, 0.2], "oracle": ["gpc", "lqr"]},
        {"algo": "gpc", "policy_length_scale": 0.9, "seeds": "1-7"},
    ]
    specs = [spec_of(**(BASE | step)) for step in steps]
    manifest = new_manifest(specs[0], varying(specs[0]), count(specs[0]))
    for number, spec in enumerate(specs[1:], 2):
        manifest = grown(manifest, spec)
        union, names = growth._united(specs[:number]), manifest["varying"]
        assert manifest["specification"] == as_dict(union) and names == varying(union)
        assert [each["filled"] for each in manifest["asked"]] == [
            growth._filled(one, names) for one in specs[:number]
        ]
        assert [each["specification"] for each in manifest["asked"]] == list(map(as_dict, specs[:number]))
        assert list(hashes(manifest)) == list(map(specification_hash, specs[:number]))


def test_what_was_measured_is_not_taken_for_a_setting(tmp_path, pretended):
    """A learner of one's own may measure what is a setting of a learner that comes later."""
    settings = BASE | {"algo": "gpc"}
    spec = spec_of(**settings)
    write_manifest(tmp_path, held := new_manifest(spec, [], len(plan(spec))))
    measured = {"beta": np.array([7.0, 8.0, 9.0])}
    Store(tmp_path, held).append([dataclasses.replace(rows(cell), own=measured) for cell in plan(spec)])
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    with pytest.raises(UserError, match="beta varies now, and a learner has measured a beta there"):
        sweep(tmp_path, **(settings | {"algo": ["gpc", "coach"], "beta": [1, 2]}))
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before
    sweep(tmp_path, **(settings | {"seeds": 3}))
    assert len(load(tmp_path)) == 9


def test_parts_of_a_sweep_that_was_not_asked_here_stay_foreign(tmp_path, pretended):
    grow(tmp_path / "one", pretended, {}, {"seeds": 3})
    sweep(tmp_path / "other", **(BASE | {"error": 0.5}))
    rows = read_episodes(tmp_path / "one")
    for folder in ("episodes", "corrections"):
        shutil.copytree(tmp_path / "other" / folder, tmp_path / "one" / folder, dirs_exist_ok=True)
    with pytest.warns(UserWarning, match=r"not rows of this sweep"):
        pd.testing.assert_frame_equal(read_episodes(tmp_path / "one"), rows)


def test_a_folder_that_grew_is_one_line(tmp_path, pretended, capsys):
    grow(tmp_path, pretended, {}, {"seeds": 3})
    assert f"gpcjax: {tmp_path}: it grows by 2 to 6 cells\n" in capsys.readouterr().err
    assert json.loads((tmp_path / "manifest.json").read_text())["cells"] == 6


def test_cells_are_those_of_the_request(tmp_path, pretended):
    grow(tmp_path, pretended, {}, {"seeds": "100-199"})
    assert ran(pretended) == plan(spec_of(**(BASE | {"seeds": range(100, 200)})))


@pytest.mark.parametrize(
    ("value", "spans", "as_json"),
    [
        (3, [(0, 2)], 3),
        ("100-199", [(100, 199)], "100-199"),
        ("3, 7", [(3, 3), (7, 7)], "3,7"),
        ("0-2,3,4", [(0, 4)], 5),
        ([5, 1, 0], [(0, 1), (5, 5)], "0-1,5"),
        ("5-5", [(5, 5)], "5-5"),
        (range(10, 12), [(10, 11)], "10-11"),
    ],
)
def test_seeds(value, spans, as_json):
    seeds = Seeds.of(value)
    assert seeds.spans == tuple(spans) and seeds.as_json() == as_json
    assert Seeds.of(as_json) == seeds and list(seeds) == sorted(set(seeds)) and len(seeds) == len(list(seeds))
    assert all(seed in seeds for seed in seeds) and spans[-1][1] + 1 not in seeds


@pytest.mark.parametrize(
    "value", [0, "", "9-3", "1-", "-1", "0-1000000", 2.0, True, [1, -1], [0.5], "٣", None, {}]
)
def test_what_are_no_seeds(value):
    assert Seeds.of(value) is None
