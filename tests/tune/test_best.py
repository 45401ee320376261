"""The best of a grid as a file, and a real search."""

import json
import subprocess
import sys

import pytest

from gpcjax.sweep.seeds import LARGEST_SEED, Seeds
from gpcjax.sweep.spec import make_spec, read_toml, spec_of
from gpcjax.sweep.store import Store
from gpcjax.tune.best import other_seeds, write_best
from tests.sweep.folders import begun, manifest_of
from tests.tune.landscape import scored

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
    for text in ("5", "3,7", "100-199", f"{LARGEST_SEED - 9}-{LARGEST_SEED}"):
        seeds = Seeds.of(text)
        others = other_seeds(seeds)
        assert len(others) == len(seeds) and not any(seed in seeds for seed in others)


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
