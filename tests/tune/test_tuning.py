"""A search from its words to its page: the runs follow a formula, all else is real."""

import contextlib
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pytest
from matplotlib.figure import Figure

import gpcjax
from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.report.figures import compare_figure, style
from gpcjax.sweep.spec import make_spec, read_toml, spec_of
from gpcjax.tune import carrying_out, searching
from tests.docs.pages import ROOT, blocks
from tests.sweep.folders import begun
from tests.tune.landscape import Landscape

SEARCH = ("--search", "policy-length-scale=0.01:100", "--search", "human-length-scale=0.01:100")
WORDS = (
    "tune",
    "--env",
    "cartpole",
    "--seeds",
    "2",
    "--episodes",
    "3",
    "--check-seeds",
    "100-102",
    "--batch",
    "4",
    "--out",
    "o",
)


@pytest.fixture
def workers(monkeypatch, tmp_path):
    """Has searches run on these workers; what they draw is made, and not painted, which takes most of the time."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(style, "image", lambda figure, kind: kind.encode())

    def use(landscape):
        monkeypatch.setattr(carrying_out, "Processes", lambda jobs: landscape)
        return landscape

    use(Landscape())
    return use


@pytest.fixture
def undrawn(workers, monkeypatch):
    """Nor do these searches draw anything: `searched` does."""
    empty = style.Drawing(Figure(), "nothing", "nothing")
    monkeypatch.setattr(carrying_out, "draw", lambda folder, anew: None)
    monkeypatch.setattr(carrying_out, "drawn", lambda found, told: None)
    monkeypatch.setattr(compare_figure, "drawn", lambda comparison: empty)
    return workers


def tuned(folder):
    return make_spec(read_toml(folder / "best.toml"))


def table(folder):
    return pd.read_csv(folder / "tune.csv")


class Searched(NamedTuple):
    """A search that ended: its folder, what was said, and how many runs were scored at a time."""

    folder: Path
    out: str
    err: str
    scored: list[int]


def searched_in(folder):
    """By six trials, with the command."""
    counts, gather = [], searching.gather

    def counted(episodes, manifest):
        counts.append(len(episodes.seeds))
        return gather(episodes, manifest)

    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(searching, "gather", counted)
        patch.setattr(carrying_out, "Processes", lambda jobs: Landscape())
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            assert cli.main([*WORDS, *SEARCH, "--trials", "6"]) == 0
    return Searched(folder / "o", out.getvalue(), err.getvalue(), counts)


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """It is not painted."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "image", lambda figure, kind: kind.encode())
        return searched_in(tmp_path_factory.mktemp("searched"))


@pytest.mark.parametrize("painted", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_from_words_to_the_page(tmp_path, request, painted):
    folder, out, err, _ = searched_in(tmp_path) if painted else request.getfixturevalue("searched")
    assert "trials 0 to 3 of 6" in err and "trials 4 to 5 of 6, best area so far" in err
    assert "area, tuned minus usual, on seeds 100-102: " in out
    found = table(folder)
    assert len(found) == 6 and list(found["area"]) == sorted(found["area"], reverse=True)
    assert (found["runs"] == 2).all() and found["tied"].iloc[0]
    best = tuned(folder)
    # Older versions of pandas read a number to its last bit but one.
    first = found["policy_length_scale"][0]
    assert best.hyperparameters["policy_length_scale"] == pytest.approx((first,), rel=1e-15)
    assert str(best.seeds) == "100-102" and best.episodes == 3
    page = (folder / "tune.html").read_text()
    assert "GPC on Cart-pole, tuned" in page and "no difference shown" not in page
    for name in ("tune.png", "study.db", "search/report.html", "check/comparison.html"):
        assert (folder / name).stat().st_size > 0


@pytest.mark.parametrize(
    "rungs",
    [
        pytest.param((), id="all", marks=pytest.mark.slow),
        pytest.param(("--rungs", "1x2,1", "--eta", "2"), id="halved"),
    ],
)
def test_stopped_anywhere_it_goes_on_to_the_same(undrawn, tmp_path, capsys, rungs):
    """No cell runs once more, and the tables, the best and the check are what they are without a stop."""
    words = [*WORDS, *SEARCH, "--trials", "6", *rungs]
    whole = undrawn(Landscape())
    assert cli.main(words) == 0
    expected, best = table(tmp_path / "o"), tuned(tmp_path / "o")
    (tmp_path / "o").rename(tmp_path / "whole")
    ran = []
    for _ in range(20):
        pieces = undrawn(Landscape(fails_after=11))
        status = cli.main(words)
        ran += pieces.cells
        if status == 0:
            break
        assert status == 130
        assert "o keeps what is finished, the same command goes on" in capsys.readouterr().err
    assert Counter(ran) == Counter(whole.cells)
    pd.testing.assert_frame_equal(table(tmp_path / "o"), expected)
    assert tuned(tmp_path / "o") == best


def test_points_are_scored_once(searched):
    """There are ever more of them in a folder."""
    assert searched.scored == [4 * 2, 2 * 2]


def test_halving_runs_fewer_cells_and_tells_of_all(workers, tmp_path, capsys):
    landscape = workers(Landscape())
    assert cli.main([*WORDS, *SEARCH, "--trials", "8", "--rungs", "1x2", "--eta", "4"]) == 0
    searched = [cell for cell in landscape.cells if cell.seed < 2]
    assert sorted({(cell.seed, cell.episodes) for cell in searched}) == [(0, 2), (0, 3), (1, 3)]
    assert len(searched) == 8 + 2 * 2
    assert len(table(tmp_path / "o")) == 2
    assert "6 more trials were given up" in (tmp_path / "o" / "tune.html").read_text()


def test_a_front(undrawn, tmp_path, capsys):
    words = [*WORDS, *SEARCH, "--trials", "8", "--objective", "area,corrections"]
    assert cli.main(words) == 0
    found = table(tmp_path / "o")
    used = 3 * round(10 * found["policy_length_scale"][0])  # of a run; the usual one has 20 in each episode
    told = re.search(
        r"corrections on the same seeds: (\S+) tuned, 60.0 usual; tuned .* (\S+) \[", capsys.readouterr().out
    )
    assert told and [float(number) for number in told.groups()] == [used, used - 60]
    on = found[found["front"]]
    assert found["front"].iloc[0] and 1 <= len(on) < len(found)
    for _, each in found.iterrows():
        better = found[(found["area"] >= each["area"]) & (found["corrections"] <= each["corrections"])]
        beaten = ((better["area"] > each["area"]) | (better["corrections"] < each["corrections"])).any()
        assert each["front"] == (not beaten)


def test_a_grid_has_all_points(undrawn, tmp_path, capsys):
    words = [*WORDS[:-4], "--out", "o", "--method", "grid", "--search", "policy_length_scale=0.25,0.5,1"]
    assert cli.main([*words, "--search", "human_length_scale=1,2"]) == 0
    found = table(tmp_path / "o")
    assert len(found) == 6
    assert dict(found.iloc[0][["policy_length_scale", "human_length_scale"]]) == {
        "policy_length_scale": 0.5,
        "human_length_scale": 2.0,
    }


def test_settings_of_a_file(undrawn, tmp_path, capsys):
    (tmp_path / "a.toml").write_text(
        'env = "cartpole"\nseeds = 2\nepisodes = 3\n[tune]\ntrials = 4\ncheck-seeds = "100-102"\nbatch = 2\n'
        '[tune.search]\npolicy_length_scale = "0.01:100"\nhuman_length_scale = [0.5, 2]\n'
    )
    assert cli.main(["tune", "a.toml", "--trials", "2", "--out", "o", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["event"] == "tuned" and set(lines[-1]["best"]) == {
        "policy_length_scale",
        "human_length_scale",
    }
    assert {line["event"] for line in lines} == {"begin", "progress", "end", "tuned"} - {"progress"}
    assert len(table(tmp_path / "o")) == 2


def test_what_is_refused_before_anything_runs(workers, tmp_path, capsys):
    landscape = workers(Landscape())
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    (tmp_path / "a.toml").write_text('env = "cartpole"\n[tune]\ntrial = 4\n')
    cases = {
        (): "no search: give --search NAME=LOW:HIGH",
        ("--search", "beta=1:2"): "--search: point 1: beta is no setting of points",
        (
            "--search",
            "policy_length_scale=-1:2",
        ): "--search: point 1: policy_length_scale -1.0: give a number above 0",
        ("--search", "policy_nu=0.5:2"): "policy_nu 2.0: give 0.5, 1.5 or 2.5",
        (*SEARCH, "--policy-length-scale", "1"): "it is a setting of the points, too",
        (
            *SEARCH,
            "--policy-variance",
            "1,2",
        ): "--policy-variance: give one value, or --search policy_variance=A,B",
        (*SEARCH, "--algo", "gpc,coach"): "give one learner",
        (*SEARCH, "--check-seeds", "1-3"): "--check-seeds 1-3: seed 1 has a part in the search",
        (*SEARCH, "--rungs", "3"): "there are 2 seeds and 3 episodes",
        (*SEARCH, "--method", "grid"): "--batch: with --method grid it changes nothing",
        (*SEARCH, "--objective", "x"): "--objective 'x': give area,",
        (*SEARCH, "--trials", "0"): "--trials 0: give a whole number",
        (*SEARCH, "--keep", "states"): "--keep: a search has none",
        (*SEARCH, "--engine", "ray"): "--engine: a search has none, leave it out",
        (*SEARCH, "--address", "auto"): "--address: a search has none, leave it out",
        (*SEARCH, "--shard", "1/2"): "--shard: a search has none, leave it out",
        (*SEARCH, "--checkpoint", "0"): "--checkpoint: a search has none, leave it out",
        (*SEARCH, "--out", "full"): "full: this is no folder of a search, and it is not empty",
        ("--method", "mll", *SEARCH): "--batch: with --method mll it changes nothing",
        ("a.toml", *SEARCH): "a.toml: [tune] trial is no setting of a search",
    }
    for words, message in cases.items():
        given = (
            [word for word in WORDS if word not in ("--check-seeds", "100-102")]
            if "--check-seeds" in words
            else WORDS
        )
        given = [word for word in given if word not in ("--out", "o")] if "--out" in words else given
        assert cli.main([*given, *words]) == 2, words
        assert message in capsys.readouterr().err
    assert not landscape.cells and not (tmp_path / "o").exists()


def test_what_a_fit_needs_is_refused_before_anything_runs(workers, tmp_path, capsys):
    begun(tmp_path / "kept", spec_of(env="cartpole", algo="gpc", seeds=2, episodes=3))
    (tmp_path / "kept" / "episodes").mkdir()
    (tmp_path / "kept" / "episodes" / "one.parquet").touch()
    cases = {
        (): "no runs: give --runs FOLDER",
        ("--runs", "none"): "none: ",
        ("--runs", "kept", *SEARCH): "--search: with --method mll all is fitted that can be, leave it out",
        (
            "--runs",
            "kept",
            "--env",
            "cartpole",
        ): "--env: with --method mll the folder of --runs says it, leave it out",
        ("--runs", "kept", "--take", "length"): "--take 'length': give length_scale, variance, noise",
        ("--runs", "kept", "--check-seeds", "1-3"): "--check-seeds 1-3: seed 1 has a part in the search",
        ("--runs", "kept", "--algo", "gpc,gpc-ns"): "--algo: give one learner",
    }
    for words, message in cases.items():
        assert cli.main(["tune", "--method", "mll", "--out", "o", *words]) == 2, words
        assert message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
    assert cli.main(["tune", "--method", "mll", "--runs", "kept", "--dry-run", "--out", "o"]) == 0


def test_a_folder_holds_one_search(searched, undrawn, tmp_path, capsys):
    shutil.copytree(searched.folder, tmp_path / "o")
    assert cli.main([*WORDS, *SEARCH, "--trials", "7"]) == 0  # more of the same
    assert len(table(tmp_path / "o")) == 7
    capsys.readouterr()
    assert cli.main([*WORDS, *SEARCH, "--trials", "7", "--objective", "final_return"]) == 2
    assert "o: it holds another search (objectives ['area'], not ['final_return'])" in capsys.readouterr().err


@pytest.mark.parametrize(
    "sampler", ["0", *(pytest.param(sampler, marks=pytest.mark.slow) for sampler in "12")]
)
@pytest.mark.parametrize(
    "words",
    [
        pytest.param((*SEARCH, "--trials", "1"), id="one trial"),
        pytest.param(
            (*SEARCH, "--trials", "3", "--rungs", "1"), id="one of three goes on", marks=pytest.mark.slow
        ),
        pytest.param(
            (*SEARCH[:2], "--search", "human-length-scale=0.5,2", "--trials", "2"), id="one value of a list"
        ),
    ],
)
def test_one_point_is_enough(workers, tmp_path, capsys, words, sampler):
    """At its end, and when it goes on: what has one value in all rows is no column of them."""
    for _ in range(2):
        assert cli.main([*WORDS, "--sampler-seed", sampler, *words]) == 0
    found, best = table(tmp_path / "o"), tuned(tmp_path / "o").hyperparameters
    for name in ("policy_length_scale", "human_length_scale"):
        assert best[name] == pytest.approx((found[name][0],), rel=1e-15)
        assert 0.01 <= best[name][0] <= 100


def test_another_best_or_other_seeds_are_judged_alone(undrawn, tmp_path, capsys):
    """What an earlier check has left stays, and has no part in a later one."""

    def judged(out, trials, seeds):
        capsys.readouterr()
        given = [word for word in WORDS[:-2] if word not in ("--check-seeds", "100-102")]
        words = [*given, "--check-seeds", seeds, "--trials", trials, "--objective", "area,corrections"]
        assert cli.main([*words, *SEARCH, "--out", out]) == 0
        printed = capsys.readouterr().out
        told = re.findall(r"^.* on (?:seeds|the same) .*$", printed.replace("\n  ", " "), re.MULTILINE)
        return told, pd.read_csv(tmp_path / out / "check" / "comparison.csv")

    first, _ = judged("o", "2", "100-102")
    best = tuned(tmp_path / "o").hyperparameters
    later, numbers = judged("o", "6", "200-201")
    assert tuned(tmp_path / "o").hyperparameters != best
    held = gpcjax.load(tmp_path / "o" / "check" / "tuned")
    assert set(held["seed"]) == {100, 101, 102, 200, 201}
    command = "gpcjax compare"  # which would compare all that is there
    assert command not in (tmp_path / "o" / "tune.html").read_text()
    shutil.rmtree(tmp_path / "o" / "check")
    fresh, expected = judged("o", "6", "200-201")
    assert command in (tmp_path / "o" / "tune.html").read_text()
    assert later == fresh != first and len(later) >= 3 and "on seeds 200-201" in "".join(later)
    pd.testing.assert_frame_equal(numbers, expected)
    assert set(numbers["pairs"]) == {2}


def test_help_offers_what_a_search_has(capsys):
    with pytest.raises(SystemExit):
        cli.main(["tune", "--help"])
    told = capsys.readouterr().out
    assert "--search" in told and "--jobs" in told
    for name in ("--keep", "--engine", "--address", "--shard", "--checkpoint", "--rate-from"):
        assert name not in told


def test_killed_before_it_said_what_it_is(undrawn, tmp_path, capsys):
    """The lock, and a file that was being written: no folder of somebody else's."""
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / ".gpcjax.lock").touch()
    half = tmp_path / "o" / f".gpcjax-{2**22 + 1}-{12 * 'a'}.tune.json.tmp"
    half.touch()
    assert cli.main([*WORDS, *SEARCH, "--trials", "1"]) == 0
    assert not half.exists()


@pytest.mark.parametrize("text", ["[]", "3", "null", "{", '{"method": []}'])
def test_a_state_that_is_none(workers, tmp_path, capsys, text):
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "tune.json").write_text(text)
    assert cli.main([*WORDS, *SEARCH, "--trials", "2"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("gpcjax: error: o") and "give a new folder" in line


def test_without_optuna_it_is_one_line(workers, capsys, monkeypatch):
    find = carrying_out.__spec__.loader and __import__("importlib.util").util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "optuna" else find(name))
    assert cli.main([*WORDS, *SEARCH]) == 2
    assert "--method tpe needs Optuna: pip install 'gpcjax[tune]'" in capsys.readouterr().err


def test_checking_needs_the_standard_library_alone():
    """As `make tune` checks before there is a .venv: no numpy, no optuna."""
    code = (
        "import sys\nfrom gpcjax import cli\n"
        f"assert cli.main({[*WORDS, *SEARCH, '--dry-run']!r}) == 0\n"
        "assert not {'numpy', 'jax', 'optuna', 'pandas'} & set(sys.modules), 'too much'"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (
        done.stdout
        == "100 trials: 200 cells of cartpole, then 6 to judge, in 2 processes, into o\n".replace(
            "in 2 processes", f"in {cli.usable_cores()} processes"
        )
    )


def test_from_python(searched, undrawn, tmp_path):
    """The search of the command line, to the same points; what it found is at hand."""
    search = {"policy_length_scale": "0.01:100", "human-length-scale": "0.01:100"}
    settings = {
        "env": "cartpole",
        "seeds": 2,
        "episodes": 3,
        "check_seeds": "100-102",
        "batch": 4,
        "trials": 6,
    }
    found = gpcjax.run_tuning(search, out=tmp_path / "python", **settings)
    pd.testing.assert_frame_equal(table(found.folder), table(searched.folder))
    assert len(found.points) == 6 and found.points["tied"].iloc[0]
    assert found.best == dict(found.points.iloc[0][["policy_length_scale", "human_length_scale"]])
    assert set(found.check.differences_table["pairs"]) == {3}
    assert "area" in found.check.differences_table["statistic"].tolist()
    again = gpcjax.run_tuning(search, out=found.folder, **settings)  # nothing runs once more
    assert again.best == found.best


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, r"^no search: give search NAME=LOW:HIGH"),
        ({"search": {"beta": "1:2"}}, r"^search: point 1: beta is no setting of points"),
        ({"search": {"policy_nu": 3}}, r'^search policy_nu 3: give "LOW:HIGH" in quotes, or a list'),
        ({"search": {"policy_nu": [0.5]}, "trials": "many"}, r"^trials 'many': give a whole number"),
        (
            {"search": {"policy_nu": [0.5]}, "method": "grid", "batch": 4},
            r"^batch: with method grid it changes",
        ),
        ({"method": "mll"}, r"^no runs: give runs FOLDER"),
        (
            {"search": {"policy_nu": [0.5]}, "check_seeds": 3},
            r"^check_seeds 3: seed 0 has a part in the search",
        ),
    ],
)
def test_what_python_is_refused(workers, tmp_path, settings, message):
    sweep = {} if settings.get("method") == "mll" else {"env": "cartpole"}
    with pytest.raises(UserError, match=message):
        gpcjax.run_tuning(**sweep, **settings, out=tmp_path / "o")
    assert not (tmp_path / "o").exists()


def test_the_page_of_the_docs(workers, tmp_path):
    """docs/tuning.md: its search runs as it stands, and leaves what is said there."""
    page = ROOT / "docs" / "tuning.md"
    workers(Landscape())
    search = next(block.commands[0] for block in blocks(page) if block.language == "sh")
    assert cli.main(shlex.split(search)[1:]) == 0
    text = page.read_text()
    left = text[text.index("## What it leaves") : text.index("## Points of")]
    for name in re.findall(r"^\| `([^`]+)`", left, re.MULTILINE):
        if "rung" not in name:
            assert (tmp_path / "runs" / "tuned" / name).exists()
