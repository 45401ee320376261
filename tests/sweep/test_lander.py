"""A small real sweep of the lunar lander, which the host simulates: the same rows however they came about."""

import json

import pytest

from gpcjax.sweep import worker
from gpcjax.sweep.executors import InProcess
from gpcjax.sweep.reading import read_corrections, read_episodes
from gpcjax.sweep.run import sweep
from tests.sweep.test_sweeps import kill_and_resume

SETTINGS = {"env": "lunarlander", "algo": ["gpc", "coach"], "seeds": 2, "episodes": 2}
STARTS = 3
"""That baselines are of, where they are not what is tested."""


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The sweep in one process, never interrupted."""
    return sweep(tmp_path_factory.mktemp("both") / "out", jobs=1, **SETTINGS)


@pytest.fixture(scope="module", params=["coach", pytest.param("both", marks=pytest.mark.slow)])
def reference(request, tmp_path_factory):
    """That of both learners, and that of COACH alone, here: its programs are quickly traced, and it has no tiers."""
    if request.param == "both":
        return request.getfixturevalue("both")
    out = tmp_path_factory.mktemp("coach") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "BASELINE_STARTS", STARTS)
        return sweep(out, executor=InProcess(), **SETTINGS | {"algo": "coach"})


def test_what_it_holds(reference):
    frame, corrections = read_episodes(reference), read_corrections(reference)
    algos = [algo for algo in SETTINGS["algo"] if algo in set(frame["algo"])]
    assert frame[["algo", "seed", "episode"]].values.tolist() == [
        [algo, seed, episode] for algo in algos for seed in (0, 1) for episode in (1, 2)
    ]
    assert set(frame["oracle"]) == {"heuristic"} and set(frame["status"]) == {"ok"}
    assert frame["return"].nunique() == len(frame) and frame["length"].between(50, 1000).all()
    # Both actions are advised, at a step where either coin allows it.
    assert set(corrections["action_dim"]) == {0, 1} and len(corrections) == frame["corrections"].sum()
    assert frame["asked"].gt(0).all() and (frame["corrections"] <= 2 * frame["asked"]).all()
    assert frame["chance"].to_numpy() == pytest.approx(0.05)
    # Every learner of a seed begins alike: the same start, the same coins.
    first = corrections.groupby(["algo", "seed"]).first()[["episode", "step", "action_dim"]]
    assert all(first.loc[algo].equals(first.loc["coach"]) for algo in algos)


def test_the_manifest(reference):
    manifest = json.loads((reference / "manifest.json").read_text())
    assert manifest["complete"] and manifest["specification"]["max_capacity"] == 4096
    assert manifest["env_steps"] == read_episodes(reference)["length"].sum()
    idle, oracle = manifest["baselines"]["idle"], manifest["baselines"]["oracles"]["heuristic"]
    starts = STARTS if "gpc" not in manifest["specification"]["algo"] else worker.BASELINE_STARTS
    assert idle["n"] == oracle["n"] == starts and idle["mean"] < -100 and oracle["mean"] > 200


@pytest.mark.slow
def test_killed_and_resumed_by_two_processes(both, tmp_path):
    kill_and_resume(SETTINGS, both, tmp_path, jobs=2)
