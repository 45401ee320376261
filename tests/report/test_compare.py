"""Run folders that are compared: which groups are paired, what is said of them, and what is written."""

import functools
import json
import re

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import gpcjax
from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.report import compare_page
from gpcjax.report.compare import folder_names, usual_out
from gpcjax.report.figures import style
from gpcjax.sweep.boxes import usual
from gpcjax.sweep.layout import part_name, sha256
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.plan import hash_of
from gpcjax.sweep.sealing import Origin, sealed
from tests.report import synthetic

LP = "policy_length_scale"
FILES = {"comparison.csv", "profiles.csv", "alone.csv", "comparison.png", "comparison.pdf", "comparison.html"}


def folder(path, loss=0.0, given=None, versions=None, sealed_parts=False, machine=None, **options):
    """A store of formulas whose returns are lower by `loss`; `given` are hyperparameters with one value."""
    options = {"algos": ("gpc", "coach"), "errors": (0.0,), "seeds": 12, "length": 6} | options
    env = options.get("env", "cartpole")
    points = options.get("points")
    frame = synthetic.episodes(**options)
    frame["return"] -= loss
    rows = synthetic.corrections(
        **{name: options[name] for name in ("algos", "errors", "seeds")}, points=points
    )
    rows["env"] = env
    names = list(points["gpc"][0]) if points else []
    manifest = synthetic.manifest(frame, names)
    manifest["specification"]["hyperparameters"] |= {name: [value] for name, value in (given or {}).items()}
    manifest["versions"] |= versions or {}
    manifest["machine"] |= machine or {}
    if not sealed_parts:
        return synthetic.write(path, frame, rows, manifest)
    manifest |= {"format": 3, "hash": hash_of(manifest["specification"])}
    origin = Origin(manifest["hash"], manifest["versions"], "")
    corrections = sealed(pa.Table.from_pandas(rows, preserve_index=False), "corrections", origin)
    table = pa.Table.from_pandas(frame, preserve_index=False)
    episodes = sealed(table, "episodes", origin, {"corrections": sha256(corrections)})
    for name, content in (("episodes", episodes), ("corrections", corrections)):
        (path / name).mkdir(parents=True)
        (path / name / part_name(0, manifest["hash"], episodes)).write_bytes(content)
    write_manifest(path, manifest)
    return path


@pytest.fixture
def unpainted(monkeypatch):
    """Every figure is made, none is painted: `test_everything_by_the_command` does it."""
    monkeypatch.setattr(style, "image", lambda figure, kind: kind.encode())


def areas(comparison):
    table = comparison.differences_table
    return table[table["statistic"] == "area"].reset_index(drop=True)


def refusal(*folders, **options):
    with pytest.raises(UserError) as caught:
        gpcjax.compare(*folders, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_folders_are_read_as_a_report_reads_them(tmp_path, monkeypatch):
    """In arrays, part by part: frames of all columns, and the corrections, would take five times the memory."""
    one, other = folder(tmp_path / "one"), folder(tmp_path / "other", loss=7.0)
    monkeypatch.setattr("gpcjax.sweep.reading.read", None)
    found = areas(gpcjax.compare(one, other))
    assert len(found) == 2 and np.allclose(found["difference"], 7.0)


class TestMatching:
    def test_the_same_learner_and_error_by_seed_and_the_rest_is_listed(self, tmp_path):
        one = folder(tmp_path / "one", errors=(0.0, 0.1))
        other = folder(
            tmp_path / "other", loss=7.0, algos=("gpc", "gpc-ns", "coach"), seeds=20, errors=(0.1, 0.2)
        )
        found = gpcjax.compare(one, other)
        table = areas(found)
        assert table["algo"].tolist() == ["gpc", "coach"] and set(table["error"]) == {0.1}
        assert table["pairs"].tolist() == [12, 12]
        assert table["difference"].to_numpy() == pytest.approx(7.0)
        alone = found.alone_table
        assert set(zip(alone["folder"], alone["algo"], alone["error"], strict=True)) == {
            ("one", "gpc", 0.0), ("one", "coach", 0.0),
            ("other", "gpc-ns", 0.1), ("other", "gpc", 0.2), ("other", "gpc-ns", 0.2), ("other", "coach", 0.2),
        }  # fmt: skip
        assert alone["missing_in"].tolist() == ["other"] * 2 + ["one"] * 4
        assert any("In one and not in other: GPC, 0% error; COACH, 0% error." in line for line in found.notes)

    def test_across_the_one_setting_in_which_they_differ(self, tmp_path):
        """COACH has no such setting, and is the same in both."""
        one, other = (folder(tmp_path / str(lp), given={LP: lp}) for lp in (0.1, 0.2))
        found = gpcjax.compare(one, other)
        table = areas(found).set_index("algo")
        assert table.loc["gpc", [f"{LP}_first", f"{LP}_second"]].tolist() == [0.1, 0.2]
        assert table.loc["coach", [f"{LP}_first", f"{LP}_second"]].isna().all()
        assert (
            "0.1 and 0.2 are matched across policy_length_scale l_p, the one setting in which they differ."
            in (found.notes)
        )
        assert compare_page.sheets(found)[0].rows[0][2] == "0.1 / 0.2"

    def test_a_preset_is_a_value(self, tmp_path):
        found = gpcjax.compare(folder(tmp_path / "a"), folder(tmp_path / "b", given={LP: 0.2}))
        assert any("policy_length_scale l_p (preset in a; 0.2 in b)" in line for line in found.notes)
        assert len(areas(found)) == 2

    def test_a_preset_is_the_value_that_it_is(self, tmp_path):
        """A folder before and after it grew by a setting, whose usual value nobody gave."""
        value = usual("cartpole", "gpc", "oracle", LP)
        points = {"gpc": [{LP: value}, {LP: 2 * value}], "coach": [{}]}
        found = gpcjax.compare(folder(tmp_path / "before"), folder(tmp_path / "after", points=points))
        table = areas(found).set_index("algo")
        assert set(table.index) == {"gpc", "coach"} and (table["pairs"] == 12).all()
        (match,) = found.matches
        assert match.across == () and not match.alone[0]
        assert [group.point.get(LP) for group in match.alone[1]] == [2 * value]

    def test_learners_when_each_folder_has_one(self, tmp_path):
        one, other = (folder(tmp_path / algo, algos=(algo,)) for algo in ("gpc", "coach"))
        table = areas(gpcjax.compare(one, other))
        assert (table["algo_first"][0], table["algo_second"][0]) == ("gpc", "coach") and len(table) == 1

    def test_a_series_is_one_value(self, tmp_path, unpainted):
        one, other = folder(tmp_path / "one"), folder(tmp_path / "other", loss=7.0)
        for path, rates in ((one, [0.1, 0.2]), (other, [0.3, 0.2, 0.1])):
            manifest = json.loads((path / "manifest.json").read_text())
            manifest["specification"]["rate_schedule"] = rates
            write_manifest(path, manifest | {"hash": hash_of(manifest["specification"])})
        found = gpcjax.compare(one, other)
        assert found.matches[0].across == ("rate_schedule",)
        assert set(areas(found)["rate_schedule_first"]) == {"0.1 0.2"}
        found.save(tmp_path / "out")
        profiles = pd.read_csv(tmp_path / "out" / "profiles.csv")
        assert set(profiles["rate_schedule"]) == {"0.1 0.2", "0.3 0.2 0.1"}
        assert "0.1 0.2 / 0.3 0.2 0.1" in (tmp_path / "out" / "comparison.html").read_text()

    def test_two_settings_only_if_asked(self, tmp_path):
        one, other = (
            folder(tmp_path / "a", given={LP: 0.1}),
            folder(tmp_path / "b", given={LP: 0.3, "beta": 2.0}),
        )
        asked = gpcjax.compare(one, other, by=[LP, "beta"])
        assert any("differs in 2 things (policy_length_scale l_p and beta)" in line for line in asked.notes)
        assert any("as asked" in line for line in asked.notes)
        gpc = [folder(tmp_path / f"{lp}-{seed}", algos=("gpc",), given={LP: lp, "beta": seed})
               for lp, seed in ((0.1, 1.0), (0.2, 2.0))]  # fmt: skip
        message = refusal(*gpc)
        assert "have no group of runs with the same settings" in message
        assert "(their specifications differ in policy_length_scale l_p (0.1 in" in message
        assert message.endswith(f"give --by {LP},beta to match across what differs")

    def test_a_grid_meets_its_own_point_first(self, tmp_path):
        grid = {"gpc": [{LP: 0.1}, {LP: 0.2}]}
        whole = folder(tmp_path / "grid", algos=("gpc",), points=grid)
        alone = folder(tmp_path / "alone", algos=("gpc",), given={LP: 0.2})
        found = gpcjax.compare(whole, alone)
        assert areas(found)["pairs"].tolist() == [12]
        assert found.alone_table[LP].tolist() == [0.1]
        shifted = folder(tmp_path / "shifted", algos=("gpc",), points={"gpc": [{LP: 0.2}, {LP: 0.4}]})
        crossed = areas(gpcjax.compare(whole, shifted, by="policy-length-scale"))
        assert crossed[[f"{LP}_first", f"{LP}_second"]].to_numpy().tolist() == [[0.1, 0.4], [0.2, 0.2]]

    def test_over_the_episodes_that_both_have(self, tmp_path):
        one, other = folder(tmp_path / "short", length=4), folder(tmp_path / "long", length=9)
        table, notes = areas(gpcjax.compare(one, other)), gpcjax.compare(one, other).notes
        assert "short and long are compared over their first 4 episodes." in notes
        frames = [gpcjax.load(each) for each in (one, other)]
        means = [f[(f["algo"] == "gpc") & (f["episode"] <= 4)]["return"].mean() for f in frames]
        assert table["difference"][0] == pytest.approx(means[0] - means[1])

    def test_three_folders_are_compared_two_by_two(self, tmp_path):
        folders = [folder(tmp_path / name, loss=loss) for name, loss in (("a", 0), ("b", 1), ("c", 3))]
        found = gpcjax.compare(*folders)
        table = areas(found)
        assert table[["first", "second"]].drop_duplicates().to_numpy().tolist() == [
            list("ab"),
            list("ac"),
            list("bc"),
        ]
        assert table["difference"].to_numpy() == pytest.approx([1, 1, 3, 3, 2, 2])
        families = found.profiles_table.groupby("family")["folder"].unique()
        assert [list(each) for each in families] == [list("abc")] * 2


class TestAcrossVersions:
    def test_formats_2_and_3_of_the_same_sweep_are_equal(self, tmp_path, capsys):
        old = folder(tmp_path / "old")
        new = folder(tmp_path / "new", sealed_parts=True, versions={"gpcjax": "0.2.0"})
        found = gpcjax.compare(old, new)
        assert capsys.readouterr().err == ""
        table = areas(found)
        assert table["equal"].tolist() == table["pairs"].tolist() == [12, 12]
        assert "Versions differ: gpcjax 0.1.0 in old; 0.2.0 in new." in found.notes
        same = "All 24 pairs of runs of old and new have the same return in every episode, to the bit."
        assert same in found.notes
        assert not any("things" in line for line in found.notes)

    def test_the_same_start_in_another_folder_is_no_other_setting(self, tmp_path):
        def begun(name, start, digest, scale):
            path = folder(tmp_path / name, given={LP: scale})
            text = json.loads((path / "manifest.json").read_text())
            text["specification"]["start"] = {"folder": str(tmp_path / start), "digest": digest}
            write_manifest(path, text | {"hash": hash_of(text["specification"])})
            return path

        one = begun("one", "first", 12 * "a", 0.1)
        other, third = begun("other", "copy", 12 * "a", 0.3), begun("third", "copy", 12 * "b", 0.1)
        found = gpcjax.compare(one, other)
        assert not any("start" in line for line in found.notes) and len(areas(found)) == 2
        found = gpcjax.compare(one, third)
        told = "start (first (aaaaaaaaaaaa) in one; copy (bbbbbbbbbbbb) in third)"
        assert any(told in line for line in found.notes)
        assert set(areas(found)["start_second"]) == {"copy (bbbbbbbbbbbb)"}

    def test_more_than_one_thing_is_said_before_all(self, tmp_path):
        bits = (
            "architecture",
            "cpu_family",
            "cpu_model",
            "vector_features",
            "vector_width",
            "xla_flags",
            "lapack",
        )
        one = folder(tmp_path / "a", machine=dict.fromkeys(bits, "x"))
        other = folder(
            tmp_path / "b", given={LP: 0.3}, versions={"jax": "0.11.0"}, machine=dict.fromkeys(bits, "y")
        )
        found = gpcjax.compare(one, other)
        assert found.notes[0].startswith(
            "What is compared differs in 3 things (policy_length_scale l_p, the versions and the kind of machine)"
        )
        (machines,) = [line for line in found.notes if line.startswith("Kinds of machine differ")]
        assert "vector width, xla flags, lapack" in machines

    def test_what_only_one_folder_has_is_no_such_thing(self, tmp_path):
        one = folder(tmp_path / "a")
        other = folder(tmp_path / "b", algos=("gpc", "gpc-ns", "coach"), versions={"jax": "0.11.0"})
        assert not any("things" in line for line in gpcjax.compare(one, other).notes)


class TestRefusals:
    def test_what_is_no_run_folder(self, tmp_path):
        one = folder(tmp_path / "a")
        assert "no such folder" in refusal(one, tmp_path / "none")
        assert "manifest.json: cannot be read" in refusal(one, tmp_path)

    def test_fewer_than_two(self, tmp_path):
        one = folder(tmp_path / "a")
        assert "needs two run folders" in refusal(one) == refusal()
        assert "is given twice" in refusal(one, tmp_path / "a" / ".." / "a")

    def test_tasks_that_differ(self, tmp_path):
        one, other = folder(tmp_path / "a"), folder(tmp_path / "b", env="pendulum")
        assert "the tasks differ (cartpole in a, pendulum in b)" in refusal(one, other)

    def test_no_common_seed(self, tmp_path):
        one, other = folder(tmp_path / "a"), folder(tmp_path / "b", seeds=24)
        for path in (other / "episodes").glob("*.parquet"):
            frame = pd.read_parquet(path)
            frame[frame["seed"] >= 12].to_parquet(path, index=False)
        for path in (other / "corrections").glob("*.parquet"):
            frame = pd.read_parquet(path)
            frame[frame["seed"] >= 12].to_parquet(path, index=False)
        assert "a and b have no seed in common" in refusal(one, other)

    @pytest.mark.parametrize(
        ("by", "message"),
        [
            ("policy_length", "no setting of these folders (did you mean policy_length_scale?)"),
            (f"{LP},{LP}", "is given twice"),
            ("algo", f"the folders have the same values of it, give {LP}"),
        ],
    )
    def test_settings_that_cannot_differ(self, tmp_path, by, message):
        one, other = (folder(tmp_path / str(lp), given={LP: lp}) for lp in (0.1, 0.2))
        assert message in refusal(one, other, by=by)


def test_names_tell_folders_apart(tmp_path):
    paths = [tmp_path / "x" / "run", tmp_path / "y" / "run", tmp_path / "other"]
    assert folder_names(paths) == ["x/run", "y/run", "other"]
    assert str(usual_out(["x/run", "other"])) == "runs/compare-x-run-other"
    long = [usual_out([f"{letter * 80}", "b" * 80]).name for letter in "ac"]
    assert len(set(long)) == 2 and all(len(name) < 50 for name in long)


class TestSaved:
    def test_everything_by_the_command(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr(style, "image", functools.partial(style.image, dpi=20))
        monkeypatch.chdir(tmp_path)
        folder(tmp_path / "a$b_c", loss=0.0), folder(tmp_path / "<b>", loss=40.0, errors=(0.0, 0.1))
        assert cli.main(["compare", "a$b_c", "<b>"]) == 0
        out = tmp_path / "runs" / "compare-a-b_c-b"
        printed = capsys.readouterr().out
        assert {path.name for path in out.iterdir()} == FILES
        assert "differences, a$b_c - <b>" in printed and "40.0 [40.0, 40.0] **" in printed
        assert "In <b> and not in a$b_c: GPC, 10% error; COACH, 10% error." in printed
        table = pd.read_csv(out / "comparison.csv")
        assert table["difference"].to_numpy() == pytest.approx(40.0) and table["survives"].all()
        profiles = pd.read_csv(out / "profiles.csv")
        assert (
            set(profiles["statistic"]) == {"area", "final_return"} and profiles["above"].between(0, 1).all()
        )
        page = (out / "comparison.html").read_text()
        assert "&lt;b&gt;" in page and "<b>" not in page and not re.search(r"https?://|<script|<link", page)

    def test_a_mistake_is_one_line_and_status_2(self, tmp_path, capsys):
        one = folder(tmp_path / "a")
        assert cli.main(["compare", str(one)]) == 2
        error = capsys.readouterr().err
        assert (
            error
            == "gpcjax: error: a comparison needs two run folders or more: give them one after the other\n"
        )
        assert not [path for path in tmp_path.iterdir() if path != one]

    def test_one_seed_and_stopped_runs(self, tmp_path, unpainted):
        one, other = folder(tmp_path / "a", seeds=1), folder(tmp_path / "b", seeds=1, loss=1.0)
        manifest = json.loads((other / "manifest.json").read_text())
        for path in (other / "episodes").glob("*.parquet"):
            frame = pd.read_parquet(path)
            frame.loc[(frame["algo"] == "gpc") & (frame["episode"] == 6), "status"] = "full"
            frame.to_parquet(path, index=False)
        assert cli.main(["compare", str(one), str(other), "--out", str(tmp_path / "out")]) == 0
        assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
        found = gpcjax.compare(one, other)
        assert any(line.startswith("b: 1 run stopped and count") for line in found.notes)
        table = areas(found)
        assert table["difference_lower"].isna().all() and np.isfinite(table["difference"]).all()
        idle = manifest["baselines"]["idle"]["mean"]
        frames = [
            frame[frame["algo"] == "gpc"]["return"].to_numpy() for frame in map(gpcjax.load, (one, other))
        ]
        assert table["difference"][0] == pytest.approx(frames[0].mean() - (frames[1][:5].sum() + idle) / 6)
