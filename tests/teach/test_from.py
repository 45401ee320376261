"""Lessons that begin with what a run of a sweep had learned."""

from pathlib import Path

import numpy as np
import pytest

from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.learners.factory import make_learner
from gpcjax.sweep.run import sweep
from gpcjax.teach.course import START, Course
from gpcjax.teach.origin import of_run
from gpcjax.teach.taught import Taught
from tests.sweep.learned import Learned

OBS = np.array([0.5, 0.01])


@pytest.fixture(scope="module", autouse=True)
def small_dictionaries():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gpcjax.teach.beginning.DICTIONARY", 64)
        yield


def learner_and_state(algo, way):
    """A mountain car's, taught to go this way there."""
    learner = make_learner(algo, "mountaincar")
    state, _ = learner.correct(learner.init(), OBS, np.zeros(1), np.array([way]))
    return learner, state


def learned(cell):
    ways = {0: 1, 1: -1}
    yield 2, 5.0, *learner_and_state(cell.algo, -ways[cell.seed])
    yield 3, 4.0, *learner_and_state(cell.algo, ways[cell.seed])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "out"
    settings = {"algo": ["gpc", "coach"], "error": [0, 0.1], "seeds": 2, "episodes": 3}
    return sweep(out, executor=Learned("states", learned), keep="states", env="mountaincar", **settings)


def test_it_goes_on_with_the_newest_state_of_the_run(folder, tmp_path):
    run = of_run(folder, "gpc-ns", 1, {"error": "0.1"})
    assert (run.env, run.algo, run.seed, run.row["episode"]) == ("mountaincar", "gpc-ns", 1, 3)
    course = Course("mountaincar", "gpc-ns", seed=1)
    taught = Taught.begin(tmp_path, course, run)
    state = taught.session.state
    assert int(state.policy.count[0]) == 1
    assert float(taught.session.act(OBS)[0]) < 0 and float(acted("gpc", 1)) > 0
    # Another process goes on from the folder alone.
    assert (tmp_path / START / "card.json").is_file()
    taught.session.end_episode()
    again = Taught.resume(tmp_path, print)
    np.testing.assert_array_equal(again.session.act(OBS), taught.session.act(OBS))


def acted(algo, way):
    learner, state = learner_and_state(algo, way)
    return learner.act(state, OBS)[0]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            (),
            "8 runs of it may be meant, which differ in algo (gpc, coach), error (0.0, 0.1), seed (0, 1): say which",
        ),
        (
            ("--seed", "1", "--algo", "coach"),
            "2 runs of it may be meant, which differ in error (0.0, 0.1): say which",
        ),
        (("--seed", "5"), "no run with seed 5 was kept, give 0, 1"),
        (("--algo", "d-coach"), "it holds what coach, gpc learned, which means nothing to d-coach"),
        (("--where", "size=3"), "'size' is no column of its runs, give env, algo, oracle, error, seed"),
        (
            ("--seed", "1", "--algo", "gpc", "--where", "error=0", "--policy-length-scale", "1,2"),
            "give one value",
        ),
    ],
)
def test_it_must_be_clear_which(folder, words, line, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("gpcjax.teach.run.compute_here", lambda: None)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["teach", "--from", str(folder), *words]) == 2
    said = capsys.readouterr().err
    assert line in said and said.count("\n") == 1 and not list(tmp_path.iterdir())


def test_what_means_nothing_to_the_learner_is_refused(folder, tmp_path):
    run = of_run(folder, "gpc", 0, {"error": "0"})
    with pytest.raises(UserError, match=r"--from .*2 numbers of an observation, the task has 3"):
        Taught.begin(tmp_path, Course("pendulum", "gpc"), run)


def test_a_learner_of_ones_own_goes_on_too(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "foreign")
    names = {"algo": "drifting:Linear", "oracle": "pump", "env": "mountaincar"}

    def learned(cell):
        yield 3, 1.0, make_learner(cell.algo, cell.env), np.array([[1.0, 2.0]])

    out = sweep(
        tmp_path / "out", executor=Learned("states", learned), keep="states", **names, seeds=1, episodes=3
    )
    (tmp_path / "lesson").mkdir()
    taught = Taught.begin(
        tmp_path / "lesson", Course("mountaincar", names["algo"]), of_run(out, None, None, {})
    )
    np.testing.assert_allclose(taught.session.act(OBS), OBS @ [1.0, 2.0])
