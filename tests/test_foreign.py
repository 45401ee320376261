"""A stranger's package is swept by name: its task, its learner, its teacher, among the built-in ones and alone."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gpcjax
from gpcjax import cli, registry
from gpcjax.cli import words as flags
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.errors import ForeignError, UserError
from gpcjax.learners.factory import make_learner
from gpcjax.report import words
from gpcjax.report.groups import gather
from gpcjax.sweep import labels
from gpcjax.sweep import run as run_module
from gpcjax.sweep.executors import Processes
from gpcjax.sweep.fitting import left_out
from gpcjax.sweep.growth import grown
from gpcjax.sweep.listing import commands
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import make_spec, read_toml, spec_of
from gpcjax.tune.toml import text_of
from tests.sweep.folders import manifest_of
from tests.sweep.pretended import Pretended
from tests.sweep.test_sweeps import kill_and_resume

FOREIGN = Path(__file__).parent / "foreign"
SETTINGS = {
    "env": "drifting:Drift",
    "oracle": "drifting:expert",
    "error": 0.1,
    "rate": 0.3,
    "seeds": 2,
    "episodes": 3,
}


BOTH = SETTINGS | {"algo": ["gpc", "drifting:Linear"], "step_size": [0.2, 0.5]}
BOTH |= {"max_capacity": 16, "on_full": "replace-nearest"}
"""With dictionaries that do not grow: a program of GPC is enough."""


@pytest.fixture(scope="module", autouse=True)
def installed():
    """Its folder is where Python looks, with what an installation leaves there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOREIGN))
        registry._entry_points.cache_clear()
        yield
    registry._entry_points.cache_clear()
    for kind, name in [key for key in registry._FOUND if key[1] not in registry.built_in(key[0])]:
        del registry._FOUND[kind, name]


@pytest.fixture(scope="module")
def both(tmp_path_factory, workers_in_process):
    """A built-in learner and the stranger's, which has a grid of its own."""
    folder = tmp_path_factory.mktemp("both") / "out"
    return sweep(folder, **BOTH)


def test_it_is_swept_among_built_in_ones(both):
    rows = read_episodes(both)
    assert rows.groupby("algo")["seed"].nunique().to_dict() == {"drifting:Linear": 2, "gpc": 2}
    mine = rows[rows["algo"] == "drifting:Linear"]
    assert sorted(mine["step_size"].unique()) == [0.2, 0.5]
    assert mine["corrections"].sum() > 0 and (mine["weight"] > 0).all()
    assert mine[["policy_points", "human_points"]].isna().all(axis=None)
    others = rows[rows["algo"] == "gpc"]
    assert others[["step_size", "weight"]].isna().all(axis=None) and (others["policy_points"] > 0).any()


@pytest.mark.slow
def test_by_an_entry_point_alone_it_has_the_same_bits(both, tmp_path):
    settings = {**SETTINGS, "env": "drift"}
    alone = read_episodes(sweep(tmp_path / "out", algo="linear", step_size=0.5, **settings))
    rows = read_episodes(both).query("algo == 'drifting:Linear' and step_size == 0.5").reset_index(drop=True)
    for name in ("seed", "episode", "return", "length", "corrections", "mean_rate", "weight"):
        pd.testing.assert_series_equal(alone[name], rows[name], check_exact=True)


@pytest.mark.slow
def test_after_kill_9_too(tmp_path, monkeypatch):
    """As uninterrupted, by workers too: what runs here is compiled more quickly than they do."""
    monkeypatch.setenv("PYTHONPATH", str(FOREIGN))
    monkeypatch.setattr(run_module, "Processes", Processes)
    kill_and_resume(BOTH, sweep(tmp_path / "whole", jobs=1, **BOTH), tmp_path)


def test_advice_that_is_none(tmp_path, workers_in_process):
    """Its runs stop there, with a status of their own; those of one who speaks as teachers do go on."""
    settings = SETTINGS | {"algo": "drifting:Linear", "teacher": "drifting:Loud", "loudness": [1, 2]}
    for name in ("error", "rate"):
        del settings[name]
    rows = read_episodes(sweep(tmp_path / "out", **settings | {"seeds": 1}))
    usual, loud = (rows[rows["loudness"] == loudness] for loudness in (1, 2))
    assert set(usual["status"]) == {"ok"} and (usual["corrections"] > 0).all()
    assert set(loud["status"]) == {"invalid"} and (loud["corrections"] == 0).all()


@pytest.mark.slow
def test_the_usual_learners_in_processes(tmp_path):
    """Nobody says who learns, and the workers are real: COACH, which has no grid for this task, is not among them."""
    words = "--env drifting:Drift --oracle drifting:expert --seeds 2 --episodes 2 --jobs 2 --out".split()
    done = subprocess.run(
        [sys.executable, "-m", "gpcjax", "sweep", *words, tmp_path / "out"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": f"{FOREIGN}{os.pathsep}{Path(__file__).parents[1]}"},
    )
    assert done.returncode == 0, done.stderr
    assert "gpcjax: drifting:Drift: without coach, which needs lower, upper, counts of" in done.stderr
    assert sorted(read_episodes(tmp_path / "out")["algo"].unique()) == ["gpc", "gpc-ns"]


def test_the_usual_learners():
    """Those that a task has all for; who is left out is told."""
    env = {"env": "drifting:Drift", "oracle": "drifting:expert"}
    assert spec_of(**env).algo == ("gpc", "gpc-ns") and len(left_out("drifting:Drift")) == 1
    assert spec_of(env="drifting:DRIFT").algo == ("gpc", "gpc-ns", "coach") and not left_out("drifting:DRIFT")
    assert spec_of(env="drifting:DRIFT", algo="coach").algo == ("coach",)
    with pytest.raises(
        UserError, match="algo coach: it needs lower, upper, counts, which drifting:Drift does not give"
    ):
        spec_of(**env, algo=["gpc", "coach"])
    assert make_learner("coach", "drifting:DRIFT").grid.counts == (5, 5)


def test_a_teacher_without_an_expert(tmp_path, workers_in_process, figures_unpainted):
    """On a task that has none: nobody's return is measured, and all else is there."""
    settings = SETTINGS | {"algo": "drifting:Linear", "teacher": "drifting:HOMEWARD"}
    for name in ("error", "oracle"):
        del settings[name]
    out = sweep(tmp_path / "out", **settings)
    rows = read_episodes(out)
    assert set(rows["oracle"]) == {"none"} and rows["corrections"].sum() > 0
    baselines = json.loads((out / "manifest.json").read_text())["baselines"]
    assert baselines["oracles"] == {} and baselines["idle"]["n"] == 100
    gpcjax.draw_report(out)
    assert "oracle none" in (out / "report.html").read_text()


def test_a_report_has_the_words_of_descriptions(tmp_path, monkeypatch):
    """Of tasks and learners, from the manifest: where the report is drawn, nobody's module is run."""
    monkeypatch.setattr(run_module, "Processes", Pretended())
    out = sweep(
        tmp_path / "out",
        env="drifting:DRIFT",
        algo=["drifting:LINEAR", "coach"],
        rate=0.3,
        seeds=2,
        episodes=3,
    )
    manifest = read_manifest(out)
    assert manifest["labels"] == {
        "task": {"drifting:DRIFT": {"label": "Drifting", "unit": "metres, negative", "actions": ["push"]}},
        "learner": {"drifting:LINEAR": {"label": "A line"}},
    }
    more = spec_of(env="drifting:DRIFT", algo=["coach", "drifting:Linear"], rate=0.3, seeds=2, episodes=3)
    assert grown(manifest, more)["labels"] == manifest["labels"]
    monkeypatch.setattr(registry, "_FOUND", {})
    monkeypatch.setattr(labels, "_TOLD", {})
    monkeypatch.setattr(registry, "described", lambda *_: pytest.fail("a module was run"))
    study = gather(read_episodes(out), manifest)
    assert words.return_label(study) == "return (metres, negative)" and words.action(study.env, 0) == "push"
    assert (words.task(study.env), words.algorithm("drifting:LINEAR")) == ("Drifting", "A line")
    assert words.task("drifting:Drift") == "drifting:Drift"


def test_words_of_brax_need_no_brax():
    assert words.task("brax:reacher") == "Reacher (brax)" and words.action("brax:reacher", 1) == "elbow"


@pytest.mark.parametrize(
    "said", [None, 3, [], {"task": 3}, {"task": {"a": 3}}, {"task": {"a": {"actions": 3}}}]
)
def test_damaged_words_are_left_out(said):
    labels.remember({"labels": said})
    assert words.task("a") == "a"


def test_names():
    """Those of entry points are the same things."""
    assert "drift" in registry.names("task") and "linear" in registry.names("learner")
    assert type(make_env("drift")) is type(make_env("drifting:Drift"))
    assert type(make_learner("linear", "drift")) is type(make_learner("drifting:Linear", "drifting:Drift"))
    assert spec_of(**{**SETTINGS, "env": "drift"}, algo="linear").algo == ("linear",)
    assert registry.built_in("task") == ("cartpole", "pendulum", "lunarlander", "mountaincar")


def test_from_python():
    """Task, expert and learner by name."""
    env, push = make_env("drifting:Drift", speed=0.2), make_expert("drifting:Drift", "drifting:expert")
    assert float(env.speed) == 0.2 and env.max_steps == 40
    np.testing.assert_allclose(push(np.array([0.1, 0.0])), [-0.3])
    learner = make_learner("drifting:Linear", "drifting:Drift", step_size=0.1)
    state, info = learner.correct(learner.init(), [0.5, 1.0], [0.0], [1])
    np.testing.assert_allclose(state, [[0.05, 0.1]])
    np.testing.assert_allclose(info.rate, [0.125])
    np.testing.assert_allclose(learner.act(state, [1.0, 0.0]), [0.05])
    dropped, info = learner.correct(state, [np.nan, 1.0], [0.0], [1])
    np.testing.assert_array_equal(dropped, state)
    assert int(info.status) == 2 and float(info.rate[0]) == 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"env": "nowhere:Drift"}, "env nowhere:Drift: there is no module nowhere, neither installed nor in"),
        ({"env": "drifting:Drfit"}, r"env drifting:Drfit: drifting has no Drfit \(did you mean Drift\?\)"),
        ({"env": "drifting:expert"}, "env drifting:expert: it cannot be made .TypeError"),
        ({"env": "drifting:Drift"}, "drifting:Drift has no expert of its own: give the folder"),
        (
            {"env": "gym:CartPole-v1"},
            r"gym:CartPole-v1: its actions are Discrete\(2\), a bounded flat Box is",
        ),
        ({"env": "gym:FrozenLake-v1"}, r"gym:FrozenLake-v1: its observations are Discrete\(16\), a flat Box"),
        ({"env": "gym:Nope-v0"}, "gym:Nope-v0: gymnasium cannot make 'Nope-v0'"),
        (
            {"env": "cartpole", "algo": "drifting:Drift"},
            "algo drifting:Drift: .* is no learner, give a subclass",
        ),
        (
            {"env": "cartpole", "teacher": "drifting:Drift"},
            "teacher drifting:Drift: .* is no teacher, give a",
        ),
        ({"env": "cartpole", "oracle": "drifting:nobody"}, "oracle drifting:nobody: drifting has no nobody"),
        (
            {"env": "cartpole", "oracle": "nowhere:nobody"},
            "oracle nowhere:nobody: there is no module nowhere",
        ),
        (
            {"env": "lunarlander", "oracle": "drifting:expert"},
            r"oracle drifting:expert: its action has shape \(1,\), lunarlander takes \(2,\)",
        ),
        (
            {"env": "cartpole", "oracle": "drifting:DRIFT"},
            "oracle drifting:DRIFT: TaskSpec.* is none, give a function",
        ),
        ({"env": "cartpole", "step_size": 1}, "'step_size' is no setting"),
        (
            {"env": "cartpole", "algo": "drifting:Linear", "beta": 1},
            "beta: with drifting:Linear alone it changes",
        ),
        (
            {"env": "cartpole", "algo": "drifting:Linear", "step_size": "x"},
            "step_size 'x': give a finite number",
        ),
    ],
)
def test_refused(settings, message):
    with pytest.raises(UserError, match=message):
        spec_of(**settings)


def test_a_module_that_ends_the_program(tmp_path, monkeypatch):
    (tmp_path / "ending_task.py").write_text("import sys\n\nsys.exit(3)\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        ForeignError, match=r"env ending_task:Task: ending_task cannot be imported .SystemExit: 3"
    ):
        spec_of(env="ending_task:Task")


def test_what_fails_in_their_module_is_told_as_theirs(tmp_path, monkeypatch):
    (tmp_path / "broken_task.py").write_text("import math\n\nvalue = math.sqrt(-1)\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        ForeignError, match=r"env broken_task:Task: broken_task cannot be imported \(ValueError"
    ) as told:
        spec_of(env="broken_task:Task")
    assert 'broken_task.py", line 3' in told.value.details and "registry.py" not in told.value.details
    done = subprocess.run(
        [sys.executable, "-m", "gpcjax", "sweep", "--env", "broken_task:Task"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert done.returncode == 2
    *traceback, line = done.stderr.splitlines()
    assert traceback[0].startswith("Traceback") and line.startswith(
        "gpcjax: error: --env broken_task:Task: broken_task"
    )


@pytest.mark.parametrize("algo", ["d-coach", "gpc", "drifting:Linear", "gpc-ns,d-coach"])
def test_what_is_told_to_have_made_it_is_taken(tmp_path, algo):
    """A task without an expert, whose own bound of a dictionary's points concerns some of the learners alone."""
    settings = {"env": "drifting:SMALL", "teacher": "drifting:HOMEWARD", "seeds": 2}
    spec = spec_of(algo=algo.split(","), **settings)
    assert spec.oracle == ("none",) and spec.max_capacity == 256
    (line,) = commands(manifest_of(spec), tmp_path / "out")
    assert ("--max-capacity 256" in line) == (algo != "d-coach")
    file = tmp_path / "best.toml"
    file.write_text(text_of(spec))
    # Only its module could tell that the bound does not concern this one.
    if algo != "drifting:Linear":
        given = flags.settings(flags.parse_words(shlex.split(line)[1:]))
        given.pop("out")
        assert make_spec(given) == spec
        assert cli.main([*shlex.split(line)[1:], "--dry-run"]) == 0
    assert make_spec(read_toml(file)) == spec
    assert cli.main(["sweep", str(file), "--dry-run"]) == 0
