"""Which cells a share of a sweep has, and shares put together: rows that nobody computed, as a store has them."""

import dataclasses
import json
import shutil
from collections import Counter

import numpy as np
import pytest

from gpcjax.errors import UserError
from gpcjax.sweep import machine, merging, weights
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.growth import grown
from gpcjax.sweep.keeping import ENTRY, as_json, keeping_of
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.merging import merge
from gpcjax.sweep.opening import new_manifest
from gpcjax.sweep.plan import plan, program_of, specification_hash, varying
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.rows import CellRows
from gpcjax.sweep.runfolder import check_sweep
from gpcjax.sweep.shards import Shard, check_shard, held_shard, shard_of, share_of, shares
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store

SPEC = spec_of(env="mountaincar", algo=["coach", "gpc", "gpc-ns"], error=[0, 0.1], seeds=50)
CELLS = plan(SPEC)


def cost(cells):
    """Seconds of a share, as they are reckoned before anything ran."""
    first = sum(weights.of_program(program.algo) for program in {program_of(cell) for cell in cells})
    return first + sum(weights.of_episode(cell.env, cell.algo, cell.oracle) * cell.episodes for cell in cells)


class TestShares:
    @pytest.mark.parametrize("of", [1, 2, 3, 7, 64, 300])
    def test_each_cell_is_in_one_and_none_is_empty(self, of):
        parts = shares(CELLS, of)
        assert len(parts) == of and all(parts)
        assert sorted(map(repr, CELLS)) == sorted(repr(cell) for part in parts for cell in part)

    def test_they_cost_about_the_same_and_compile_little(self):
        for of in (2, 4, 8):
            parts = shares(CELLS, of)
            least = max(cost(CELLS) / of, max(cost([cell]) for cell in CELLS))
            # Wherever a program is cut, it is compiled once more.
            assert max(map(cost, parts)) <= least + weights.of_program("gpc-ns") + 1.0
            programs = [len({program_of(cell) for cell in part}) for part in parts]
            assert sum(programs) <= 3 + of - 1

    def test_which_cells_a_share_has_never_changes(self):
        """Shards that were made by another version, with another table of costs, fit together with these."""
        parts = [
            Counter(cell.algo for cell in part)
            for part in shares(plan(spec_of(env="cartpole", algo=["gpc", "gpc-ns", "coach"], seeds=100)), 3)
        ]
        assert parts == [{"gpc": 100}, {"gpc-ns": 65}, {"gpc-ns": 35, "coach": 100}]

    def test_more_than_there_are_cells(self):
        parts = shares(CELLS[:2], 4)
        assert sorted(map(len, parts)) == [0, 0, 1, 1]

    def test_the_order_of_lists_changes_nothing(self):
        turned = spec_of(env="mountaincar", algo=["gpc-ns", "coach", "gpc"], error=[0.1, 0], seeds=50)
        for number in (1, 2, 3):
            one, other = (
                share_of(new_manifest(spec, varying(spec), 300), Shard(number, 3)) for spec in (SPEC, turned)
            )
            assert set(one) == set(other)

    def test_no_cell_changes_hands_as_a_folder_grows(self):
        manifest = new_manifest(SPEC, varying(SPEC), len(CELLS))
        larger = grown(manifest, dataclasses.replace(SPEC, seeds=spec_of(env="mountaincar", seeds=80).seeds))
        before, after = ([set(share_of(each, Shard(n, 3))) for n in (1, 2, 3)] for each in (manifest, larger))
        assert all(old < new for old, new in zip(before, after, strict=True))
        assert sum(map(len, after)) == len(set().union(*after)) == 3 * 2 * 80


@pytest.mark.parametrize(
    "word", ["", "3", "0/4", "5/4", "-1/4", "1/0", "a/b", "1/4/2", "1/100001", "1.0/2", 3, None]
)
def test_a_shard_that_is_none(word):
    with pytest.raises(UserError, match=r"^--shard .*: give i/n, the i-th of n shares, as in 1/8 to 8/8$"):
        shard_of(word, "--shard")


def test_a_shard_by_its_word():
    assert shard_of(" 3/8", "") == Shard(3, 8) and str(Shard(3, 8)) == "3/8"


def made(out, spec, shard, kind=""):
    """The run folder of a share, with rows that nobody computed."""
    folder = shard.folder(out)
    folder.mkdir(parents=True)
    manifest = new_manifest(spec, varying(spec), 0)
    cells = share_of(manifest, shard)
    numbers = {"mean": 1.0, "std": 0.5, "n": 100}
    manifest |= {
        "shard": shard.as_json(),
        "cells": len(cells),
        "complete": True,
        "env_steps": 100,
        "wall_time_s": 2.0,
    }
    manifest["baselines"] = {"idle": numbers, "oracles": {"pump": numbers}}
    if kind:
        manifest["machine"] = {**machine.describe(), "cpu_model": kind}
    store = Store(folder, manifest, machine.kind_of(manifest["machine"]))
    store.append([stored(cell) for cell in cells])
    write_manifest(folder, manifest)
    return folder


def grow(folder, spec):
    """A share that was asked for more, and has it."""
    manifest = grown(read_manifest(folder), spec)
    cells = share_of(manifest, held_shard(manifest))
    manifest |= {"cells": len(cells), "complete": True}
    store = Store(folder, manifest, machine.kind_of(manifest["machine"]), request=specification_hash(spec))
    store.append([stored(cell) for cell in store.missing(cells)])
    write_manifest(folder, manifest)


def stored(cell):
    names = (
        "returns length corrections rate_sum asked chance_sum policy_points human_points clipped full".split()
    )
    episodes = {name: np.array([float(cell.seed)]) for name in names}
    corrections = {name: np.zeros((0, 3)) for name in ("moments", "values", "outcome")}
    return CellRows(cell, np.array([1]), ["ok"], episodes, corrections)


NOBODY = 2**22 + 1
"""The number of no process."""

SMALL = spec_of(env="mountaincar", algo="coach", seeds=7, episodes=1)


class TestMerging:
    @pytest.fixture
    def out(self, tmp_path):
        for number in (1, 2, 3):
            made(tmp_path / "out", SMALL, Shard(number, 3))
        return tmp_path / "out"

    def test_a_whole_is_as_if_it_had_run_alone(self, out, tmp_path):
        assert merge([out]) == out
        frame, manifest = read_episodes(out), read_manifest(out)
        assert sorted(frame["seed"]) == [0, 1, 2, 3, 4, 5, 6] and (frame["return"] == frame["seed"]).all()
        assert manifest["complete"] and manifest["cells"] == 7 and "shard" not in manifest
        assert "further_machines" not in manifest and manifest["env_steps"] == 300
        assert manifest["wall_time_s"] == 2.0 and manifest["baselines"]["idle"]["mean"] == 1.0
        folders = [Shard(number, 3).folder(out) for number in (3, 1, 2)]
        elsewhere = merge(folders, tmp_path / "elsewhere")
        assert sorted(read_episodes(elsewhere)["seed"]) == [0, 1, 2, 3, 4, 5, 6]

    def test_it_may_be_done_again(self, out):
        before = {path.name for path in (merge([out]) / "episodes").iterdir()}
        assert {path.name for path in (merge([out]) / "episodes").iterdir()} == before

    @pytest.mark.parametrize("grown", [pytest.param(False, marks=pytest.mark.slow), True])
    def test_killed_at_any_moment_it_may_be_done_again(self, tmp_path, monkeypatch, grown):
        """Before and after each file that it writes, of which the first ones are no episodes."""
        source = tmp_path / "source"
        for number in (1, 2):
            folder = made(source, SMALL, Shard(number, 2))
            if grown:
                grow(folder, dataclasses.replace(SMALL, seeds=spec_of(env="mountaincar", seeds=9).seeds))
        whole = merge([source], tmp_path / "whole")
        files = sorted(str(path.relative_to(whole)) for path in whole.rglob("*") if path.is_file())
        moments, written = 0, []

        class Killed(BaseException):
            pass

        def write(path, data):
            if len(written) == moments:
                path.with_name(f".gpcjax-{NOBODY}-{12 * 'a'}.{path.name}.tmp").write_bytes(b"half")
                raise Killed
            write_atomic(path, data)
            written.append(path)

        monkeypatch.setattr(merging, "write_atomic", write)
        while True:
            out = tmp_path / f"killed-{moments}"
            written.clear()
            try:
                merge([source], out)
                break
            except Killed:
                pass
            moments, written[:] = 10**9, []
            merge([source], out)
            moments = int(out.name.removeprefix("killed-"))
            left = [path for path in out.rglob("*") if path.is_file()]
            assert sorted(str(path.relative_to(out)) for path in left) == files
            assert read_episodes(out).equals(read_episodes(whole))
            moments += 1
        assert moments == len(files) - 1  # the manifest has a writer of its own

    def test_a_plain_sweep_may_follow_a_killed_merge(self, out):
        """Of which no episodes are there yet."""
        (part,) = (Shard(1, 3).folder(out) / "corrections").iterdir()
        (out / "corrections").mkdir()
        shutil.copy(part, out / "corrections")
        check_sweep(out, SMALL)
        with pytest.raises(UserError, match="it holds rows of another sweep and no manifest"):
            check_sweep(out, dataclasses.replace(SMALL, episodes=2))

    def test_kinds_of_machines_that_differ_are_told(self, out, capsys):
        shutil.rmtree(Shard(2, 3).folder(out))
        made(out, SMALL, Shard(2, 3), kind="another")
        merge([out])
        assert "2 kinds of machine" in capsys.readouterr().err
        assert [each["cpu_model"] for each in read_manifest(out)["further_machines"]] == ["another"]

    def test_a_missing_one(self, out):
        shutil.rmtree(Shard(2, 3).folder(out))
        with pytest.raises(UserError, match=r"^shard 2 of 3 is missing: run it, or give its folder$"):
            merge([out])

    def test_several_missing_ones(self, tmp_path):
        made(tmp_path, SMALL, Shard(2, 4))
        with pytest.raises(
            UserError, match=r"^shards 1, 3, 4 of 4 are missing: run them, or give their folders$"
        ):
            merge([tmp_path])

    def changed(self, folder, **entries):
        write_manifest(folder, {**read_manifest(folder), **entries})

    @pytest.mark.parametrize(
        ("entries", "message"),
        [
            ({"complete": False}, r"shard 2/3 is not complete \(\d of \d cells\), run it again"),
            ({"cells": 100}, r"shard 2/3 is not complete \(\d of 100 cells\), run it again"),
            ({"shard": {"number": 2, "of": 4}}, r"it is shard 2/4, .* is 1/3: give shards of one number"),
            ({"shard": {"number": 1, "of": 3}}, r"it is shard 1/3, and so is .*: give one of the two"),
            ({"shard": None}, "this is no shard of a sweep"),
        ],
    )
    def test_one_that_does_not_fit(self, out, entries, message):
        self.changed(Shard(2, 3).folder(out), **entries)
        with pytest.raises(UserError, match=message):
            merge([out])
        assert not (out / "manifest.json").exists()

    def test_other_versions(self, out):
        folder = Shard(2, 3).folder(out)
        shutil.rmtree(folder)
        versions = {**new_manifest(SMALL, [], 0)["versions"], "jax": "0.9.9"}
        made(out, SMALL, Shard(2, 3))
        for path in (folder / "episodes").iterdir():
            path.unlink()
        manifest = {**read_manifest(folder), "versions": versions}
        Store(folder, manifest, "").append([stored(cell) for cell in share_of(manifest, Shard(2, 3))])
        write_manifest(folder, manifest)
        with pytest.raises(UserError, match=r"it was made with jax 0\.9\.9, .* with \d+.*: run one again"):
            merge([out])

    def test_another_sweep(self, out):
        shutil.rmtree(Shard(2, 3).folder(out))
        made(out, dataclasses.replace(SMALL, episodes=2), Shard(2, 3))
        with pytest.raises(UserError, match="it is a shard of another sweep than"):
            merge([out])

    def test_overlapping_ones(self, out):
        folder = Shard(2, 3).folder(out)
        manifest = read_manifest(folder)
        store = Store(folder, manifest, machine.kind_of(manifest["machine"]))
        store.append([stored(share_of(manifest, Shard(1, 3))[0])])
        with pytest.raises(UserError, match="1 of its cells are in another shard too"):
            merge([out])

    def test_a_damaged_one(self, out):
        (part,) = (Shard(2, 3).folder(out) / "episodes").iterdir()
        part.write_bytes(part.read_bytes()[:-100])
        with pytest.raises(UserError, match=r"shard 2/3 is damaged \(episodes/part.*\), run it again"):
            merge([out])

    def test_a_damaged_part_of_the_whole_is_set_aside_and_not_written_over(self, out, capsys):
        part = min((merge([out]) / "episodes").iterdir())
        part.write_bytes(damaged := part.read_bytes()[:-100])
        capsys.readouterr()
        assert len(read_episodes(merge([out]))) == 7
        assert (out / "damaged" / "episodes" / part.name).read_bytes() == damaged
        line = f"{out}: 1 damaged part moved to {out / 'damaged'}, the shards have its rows (episodes/{part.name}"
        assert line in capsys.readouterr().err

    def test_a_folder_that_holds_something_else(self, out, tmp_path):
        (tmp_path / "else").mkdir()
        (tmp_path / "else" / "letter.txt").write_text("")
        with pytest.raises(UserError, match=r"it holds 'letter\.txt' and no run"):
            merge([out], tmp_path / "else")
        with pytest.raises(UserError, match="--out is missing"):
            merge([Shard(number, 3).folder(out) for number in (1, 2, 3)])

    def test_into_a_whole_that_keeps_something_else(self, out, tmp_path):
        """Half of its runs would have nothing to load, and the manifest would not say so."""
        for number in (1, 2, 3):
            self.changed(Shard(number, 3).folder(out), **{ENTRY: as_json(keeping_of("policies", "last"))})
        begun = {**read_manifest(Shard(1, 3).folder(out)), "complete": False, ENTRY: None}
        del begun["shard"]
        write_manifest(out, begun)
        with pytest.raises(
            UserError, match=r"of its runs it keeps nothing, the shards policies .*: give a new folder"
        ):
            merge([out])
        self.changed(out, **{ENTRY: as_json(keeping_of("policies", "last"))})
        assert read_manifest(merge([out]))["complete"]

    def test_shards_that_keep_different_things(self, out):
        """The first one does not say what."""
        for number, what in ((2, "policies"), (3, "states")):
            folder = Shard(number, 3).folder(out)
            self.changed(folder, **{ENTRY: as_json(keeping_of(what, "last"))})
        with pytest.raises(UserError, match=r"3-of-3: of its runs it keeps states .*, .*2-of-3 policies "):
            merge([out])
        self.changed(folder, **{ENTRY: as_json(keeping_of("policies", "last"))})
        assert ENTRY not in read_manifest(merge([out]))

    def test_runs_that_were_under_way_there_are_over(self, out):
        begun = {**read_manifest(Shard(1, 3).folder(out)), "complete": False}
        del begun["shard"]
        write_manifest(out, begun)
        (out / "checkpoints" / "1234567890-1-0").mkdir(parents=True)
        assert not (merge([out]) / "checkpoints").exists()

    def test_a_shard_is_no_whole_and_a_whole_no_shard(self, out):
        folder = Shard(1, 3).folder(out)
        with pytest.raises(
            UserError, match="it holds shard 1/3 of a sweep, give --shard 1/3 or another --out"
        ):
            check_shard(folder, None, 7)
        with pytest.raises(UserError, match="it holds a whole sweep, give no --shard or another --out"):
            check_shard(merge([out]), Shard(1, 3), 7)
        with pytest.raises(UserError, match="shard 2/8: there are 7 cells only"):
            check_shard(folder, Shard(2, 8), 7)
        check_shard(folder, Shard(1, 3), 7)
        assert json.loads((folder / "manifest.json").read_text())["shard"] == {"number": 1, "of": 3}
