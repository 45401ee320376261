"""The best of a grid as a file, and a real search."""

import contextlib
import json
import subprocess
import sys

import pytest

from gpcjax import cli, load
from gpcjax.report.figures import style
from gpcjax.sweep import run as run_module
from gpcjax.sweep.seeds import LARGEST_SEED, Seeds
from gpcjax.sweep.spec import make_spec, read_toml, spec_of
from gpcjax.sweep.store import Store
from gpcjax.tune.best import other_seeds, write_best
from tests.sweep.folders import begun, manifest_of
from tests.tune.landscape import Landscape, scored

VALUES = {"policy_length_scale": [0.25, 0.5, 4.0], "human_length_scale": [1.0, 2.0]}


def held(out, spec):
    """A run folder with all rows of a specification."""
    from gpcjax.sweep.plan import plan

    store = Store(begun(out, spec), manifest_of(spec))
    store.missing([])
    store.append([scored(cell) for cell in plan(spec)])
    return out


def test_the_best_of_a_grid(tmp_path):
    spec = spec_of(
        env="cartpole", algo="gpc", seeds=3, episodes=3, error=[0, 0.2], policy_variance=0.3, **VALUES
    )
    (path,) = write_best(held(tmp_path / "o", spec), spec)
    best = make_spec(read_toml(path))
    point = {"policy_length_scale": (0.5,), "human_length_scale": (2.0,), "policy_variance": (0.3,)}
    assert best.hyperparameters == point
    assert best.seeds == Seeds.of("3-5") and best.error == (0.0, 0.2) and best.episodes == 3
    assert path.read_text().startswith(
        "# The best of 6 points by the final return on 3 seeds; 0 others are tied"
    )


def test_one_for_each_learner_that_it_concerns(tmp_path):
    spec = spec_of(env="cartpole", algo=["gpc", "gpc-ns", "coach"], seeds=2, episodes=3, **VALUES)
    paths = write_best(held(tmp_path / "o", spec), spec)
    assert [path.name for path in paths] == ["best-gpc.toml", "best-gpc-ns.toml"]
    assert [make_spec(read_toml(path)).algo for path in paths] == [("gpc",), ("gpc-ns",)]


def test_other_seeds_are_others():
    last = f"{LARGEST_SEED - 9}-{LARGEST_SEED}"
    for text in ("5", "3,7", "100-199", last, f"0-9,{last}", f"0-9,12,{last}"):
        seeds = Seeds.of(text)
        others = other_seeds(seeds, len(seeds))
        assert len(others) == len(seeds) and not any(seed in seeds for seed in others)


def test_no_seed_of_the_folder_has_a_part_in_what_follows(tmp_path):
    """A folder that has more seeds than the grid that is asked for now: they neither choose nor are left."""
    more, fewer = (spec_of(env="cartpole", algo="gpc", seeds=n, episodes=3, **VALUES) for n in (20, 10))
    out = held(tmp_path / "o", more)
    (path,) = write_best(out, fewer)
    assert make_spec(read_toml(path)).seeds == Seeds.of("20-29")
    assert path.read_text().startswith("# The best of 6 points by the final return on 10 seeds;")
    (path,) = write_best(out)
    assert make_spec(read_toml(path)).seeds == Seeds.of("20-39")
    assert path.read_text().startswith("# The best of 6 points by the final return on 20 seeds;")


def test_a_grid_in_shards_has_one_best_when_they_are_merged(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_module, "Processes", lambda jobs: Landscape())
    monkeypatch.setattr(style, "image", lambda figure, kind: kind.encode())
    words = "grid --env cartpole --algo gpc --seeds 2 --episodes 3 --policy-length-scale 0.25,0.5,4".split()
    for number in "12":
        assert cli.main([*words, "--out", "o", "--shard", f"{number}/2"]) == 0
    assert "best settings" not in capsys.readouterr().out and not list((tmp_path / "o").rglob("best*"))
    assert cli.main(["merge", "o"]) == 0
    assert (
        "o/best.toml: the best settings, with other seeds: gpcjax sweep o/best.toml"
        in capsys.readouterr().out
    )
    best = make_spec(read_toml(tmp_path / "o" / "best.toml"))
    assert best.hyperparameters["policy_length_scale"] == (0.5,) and str(best.seeds) == "2-3"
    assert cli.main([*words, "--out", "plain"]) == 0
    assert (tmp_path / "plain" / "best.toml").read_text() == (
        tmp_path / "o" / "best.toml"
    ).read_text().replace("o/best", "plain/best")
    capsys.readouterr()
    assert cli.main([*words, "--out", "told", "--json"]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert events[-1] == {"event": "best", "out": "told", "files": ["told/best.toml"]}
    assert (tmp_path / "told" / "best.toml").exists()


@pytest.mark.slow
def test_from_bad_length_scales_it_finds_the_performance_of_the_thesis(tmp_path):
    """Five decades around them, most of which teach nothing; judged on seeds that chose nothing."""
    words = [
        "tune",
        "--env",
        "cartpole",
        "--algo",
        "gpc",
        "--objective",
        "area",
        "--trials",
        "96",
        "--rungs",
        "4",
        "--json",
    ]
    ranges = ["--search", "policy-length-scale=0.002:200", "--search", "human-length-scale=0.002:200"]
    done = subprocess.run(
        [sys.executable, "-m", "gpcjax", *words, *ranges, "--out", str(tmp_path / "o")],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    tuned = json.loads(done.stdout.splitlines()[-1])
    area = next(each for each in tuned["check"] if each["statistic"] == "area")
    assert area["pairs"] == 100
    # Of 2,500 steps: not worse than the thesis's values by more than 3 in a hundred.
    assert area["difference_upper"] > 0 or area["difference"] > -75


@pytest.mark.slow
def test_killed_again_and_again_it_comes_to_the_same(tmp_path):
    """kill -9 of a real search, at other moments each time."""
    words = (
        "tune --env mountaincar --algo coach --search beta=5:60 --search magnitude=1:10 --trials 8".split()
    )
    words += "--batch 4 --seeds 2 --episodes 4 --check-seeds 100-101 --rungs 1 --eta 2 --jobs 1".split()

    def start(out):
        given = [sys.executable, "-m", "gpcjax", *words, "--out", str(tmp_path / out)]
        return subprocess.Popen(given, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    assert start("whole").wait(600) == 0
    for seconds in (2.0, 6.0, 9.0, 12.0):
        child = start("pieces")
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(seconds)
        child.kill()
        child.wait()
    assert start("pieces").wait(600) == 0
    assert (tmp_path / "pieces" / "tune.csv").read_bytes() == (tmp_path / "whole" / "tune.csv").read_bytes()
    rows = [load(tmp_path / out / "search") for out in ("whole", "pieces")]
    assert rows[0].equals(rows[1]) and len(rows[0]) > 0
