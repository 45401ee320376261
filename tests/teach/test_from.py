"""Lessons that begin with what a run of a sweep had learned, or a learner that was saved."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest

import gpcjax
from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.learners.factory import make_learner
from gpcjax.policies.folder import read_arrays, read_card, write_folder
from gpcjax.registry import built_in
from gpcjax.sweep.build import learner_of
from gpcjax.sweep.kept import kept_rows
from gpcjax.sweep.run import sweep
from gpcjax.teach.course import COURSE, SAVES, START, Course
from gpcjax.teach.origin import of_run
from gpcjax.teach.protocol import Press
from gpcjax.teach.saved import of_saved
from gpcjax.teach.taught import Taught
from tests.sweep.learned import Learned

OBS = np.array([0.5, 0.01])

ROOM = 16
"""Points of a dictionary."""


@pytest.fixture(scope="module", autouse=True)
def small_dictionaries():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gpcjax.teach.beginning.DICTIONARY", ROOM)
        yield


@functools.cache
def learner_and_state(algo, way):
    """A mountain car's, taught to go this way there."""
    learner = make_learner(algo, "mountaincar", **({"capacity": ROOM} if algo == "gpc" else {}))
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


@pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow)])
def test_it_goes_on_with_the_newest_state_of_the_run(folder, tmp_path, algo):
    """Also another learner, to which it means as much."""
    assert of_run(folder, "gpc-ns", 1, {"error": "0.1"}).algo == "gpc-ns"
    run = of_run(folder, algo, 1, {"error": "0.1"})
    assert (run.env, run.algo, run.seed, run.row["episode"]) == ("mountaincar", algo, 1, 3)
    course = Course("mountaincar", algo, seed=1)
    taught = Taught.begin(tmp_path, course, run)
    state = taught.session.state
    assert int(state.policy.count[0]) == 1
    assert float(taught.session.act(OBS)[0]) < 0 and float(acted("gpc", 1)) > 0
    # Another process goes on from the folder alone.
    assert (tmp_path / START / "card.json").is_file()
    taught.close("reset")
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


@pytest.mark.parametrize("card", ["", "{}", '{"arrays": 3}', '{"arrays": {"learner.noise": ["f8", [9]]}}'])
def test_a_damaged_state_of_a_run_is_told(folder, monkeypatch, card):
    kept = kept_rows(folder, "state", {}).assign(card=card)
    monkeypatch.setattr("gpcjax.teach.origin.kept_rows", lambda *given: kept)
    with pytest.raises(UserError, match=r"--from .*: what gpc learned with seed 0 is damaged"):
        of_run(folder, "gpc", 0, {"error": "0"})


def test_what_means_nothing_to_the_learner_is_refused(folder, tmp_path):
    run = of_run(folder, "gpc", 0, {"error": "0"})
    with pytest.raises(UserError, match=r"--from .*2 numbers of an observation, the task has 3"):
        Taught.begin(tmp_path, Course("pendulum", "gpc"), run)


def learned_by_cells(cell):
    """What the learner of each cell learns of two keys."""
    learner = learner_of(cell, ROOM)
    state = learner.init()
    for way in (1.0, -1.0):
        state, _ = learner.correct(state, way * OBS, np.zeros(1), np.array([way]))
    yield cell.episodes, 1.0, learner, state


@pytest.mark.parametrize(
    ("algo", "settings", "variants"),
    [
        (
            "gpc",
            {"policy_length_scale": 2.0, "constant_rate": 0.3, "credit": 0.2},
            {"scaling": (1.0, 2.0), "human_scaling": (1.0, 1.0, 2.0), "sparsify": False},
        ),
        pytest.param(
            "gpc-ns", {"static_rate": 0.3}, {"human_scaling": (1.0, 2.0, 1.0)}, marks=pytest.mark.slow
        ),
        pytest.param("d-coach", {"width": 8}, {"scaling": (1.0, 2.0)}, marks=pytest.mark.slow),
    ],
)
def test_a_run_goes_on_with_the_settings_of_it(algo, settings, variants, course_of, tmp_path):
    given = {"env": "mountaincar", "algo": algo, "seeds": 1, "episodes": 2, **settings, **variants}
    out = sweep(tmp_path / "out", executor=Learned("states", learned_by_cells), keep="states", **given)
    course, run = course_of("--from", str(out))
    assert (dict(course.settings), dict(course.variants)) == (settings, variants)
    (tmp_path / "lesson").mkdir()
    taught = Taught.begin(tmp_path / "lesson", course, run)
    frame = gpcjax.load_states(out)
    np.testing.assert_array_equal(
        taught.session.act(2 * OBS), frame["learner"][0].act(frame["state"][0], 2 * OBS)
    )
    assert Course.read(tmp_path / "lesson") == course
    taught.end("reset")
    taught.keep()()
    told = json.loads((tmp_path / "lesson" / "manifest.json").read_bytes())["specification"]
    assert told["hyperparameters"] == {name: [value] for name, value in settings.items()}
    assert {name: told.get(name) for name in variants} == {
        name: value if isinstance(value, bool) else list(value) for name, value in variants.items()
    }
    # Another learner and another task have settings of their own.
    if algo == "gpc":
        assert not course_of("--from", str(out), "--algo", "gpc-ns")[0].settings
        course = course_of("--from", str(out), "--policy-length-scale", "3")[0]
        assert dict(course.settings) == {**settings, "policy_length_scale": 3.0}


def test_settings_that_vary_are_those_of_the_run(course_of, tmp_path):
    given = {"policy_length_scale": [0.4, 2.0], "credit": [0.0, 0.4]}
    learn = Learned("states", lambda cell: [(2, 1.0, learner_of(cell, ROOM), learner_of(cell, ROOM).init())])
    out = sweep(
        tmp_path / "out",
        executor=learn,
        keep="states",
        env="mountaincar",
        algo="gpc",
        seeds=1,
        episodes=2,
        **given,
    )
    where = ("--where", "policy_length_scale=2", "--where", "credit=0.4")
    assert dict(course_of("--from", str(out), *where)[0].settings) == {
        "policy_length_scale": 2.0,
        "credit": 0.4,
    }
    where = ("--where", "policy_length_scale=0.4", "--where", "credit=0")
    assert dict(course_of("--from", str(out), *where)[0].settings) == {"credit": 0.0}


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


@pytest.mark.parametrize("words", [(), ("--set", "reach=3")])
def test_a_learner_of_ones_own_goes_on_with_the_room_that_it_had(course_of, tmp_path, words):
    names = {"algo": "tests.teach.drifting:Growing", "oracle": "pump", "env": "mountaincar"}
    out = sweep(
        tmp_path / "out",
        executor=Learned("states", learned_by_cells),
        keep="states",
        **names,
        seeds=1,
        episodes=3,
    )
    (tmp_path / "lesson").mkdir()
    taught = Taught.begin(tmp_path / "lesson", *course_of("--from", str(out), *words))
    assert taught.session.state["seen"].shape == (4, 2) and np.any(taught.session.state["weights"])


# --- with a saved learner


@pytest.fixture
def course_of(monkeypatch, tmp_path):
    """What would be taught with these words, and what with."""
    monkeypatch.chdir(tmp_path)
    taught = []
    monkeypatch.setattr("gpcjax.teach.run.teach", lambda *given: taught.append(given[1:3]) or 0)

    def asked(*words):
        assert cli.main(["teach", *words]) == 0
        return taught[-1]

    return asked


def saved(path, algo, env, told=True, learned=True, **options):
    """What learned one thing, or nothing, where a test asks for its settings alone."""
    room = {"capacity": ROOM} if algo in ("gpc", "gpc-ns") else {}
    learner = make_learner(algo, env, **room | options)
    size, state = learner.action_size, learner.init()
    if learned:
        state, _ = learner.correct(state, np.ones(learner.obs_size), np.zeros(size), np.ones(size))
    gpcjax.save_learner(path, learner, state, **({"env": env} if told else {}))
    return learner, state


def test_the_learner_that_was_saved_is_taught_by_its_name_with_its_settings(course_of, tmp_path):
    saved(
        "kept", "gpc", "mountaincar", policy_length_scale=3.0, constant_rate=0.5, on_full="error", capacity=8
    )
    course, origin = course_of("--from", "kept")
    assert (course.env, course.algo) == ("mountaincar", "gpc")
    assert dict(course.settings) == {"policy_length_scale": 3.0, "constant_rate": 0.5}
    (tmp_path / "out").mkdir()
    taught = Taught.begin(tmp_path / "out", course, origin)
    learner, state = taught.session.learner, taught.session.state
    assert float(learner.policy.kernel.length_scale) == 3.0 and float(learner.constant_rate) == 0.5
    # Room, and what becomes of a full dictionary, are those of any lesson.
    assert learner.on_full == "replace-nearest" and state.policy.points.shape[1] == ROOM
    assert int(state.policy.count[0]) == 1
    taught.step()
    taught.end("over")
    taught.keep()()
    told = json.loads((tmp_path / "out" / "manifest.json").read_bytes())["specification"]
    assert told["hyperparameters"] == {"policy_length_scale": [3.0], "constant_rate": [0.5]}
    again = Taught.resume(tmp_path / "out", lambda line: None, whole=True)
    np.testing.assert_array_equal(again.session.act(np.ones(2)), taught.session.act(np.ones(2)))


def test_what_is_given_beside_counts(course_of, capsys):
    saved("kept", "gpc", "mountaincar", learned=False, policy_length_scale=3.0, constant_rate=0.3)
    settings = course_of("--from", "kept", "--static-rate", "0.1", "--policy-length-scale", "2")[0].settings
    assert dict(settings) == {"policy_length_scale": 2.0, "static_rate": 0.1}
    assert not capsys.readouterr().err
    assert not course_of("--from", "kept", "--algo", "gpc-ns")[0].settings
    assert capsys.readouterr().err == (
        "gpcjax: --from kept: gpc-ns goes on with what another learner learned, with settings of its own\n"
    )
    course, _ = course_of("--from", "kept", "--env", "tests.teach.drifting:Drift", "--algo", "gpc")
    assert not course.settings
    assert (
        "what was learned on mountaincar is taught tests.teach.drifting:Drift now, with the settings of gpc there"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("algo", built_in("learner"))
@pytest.mark.parametrize("env", ["cartpole", pytest.param("lunarlander", marks=pytest.mark.slow)])
def test_usual_settings_are_not_named(algo, env, tmp_path):
    saved(tmp_path / "kept", algo, env, learned=False)
    assert of_saved(tmp_path / "kept", None, None)[1:] == (env, algo, {})


@pytest.mark.parametrize(
    ("algo", "options"),
    [
        ("gpc", {"noise": 1e-5, "policy_nu": 2.5}),
        pytest.param("gpc-ns", {"human_noise": 1e-5, "human_variance": 2.0}, marks=pytest.mark.slow),
        ("coach", {"beta": 7.0, "coach_constant": 0.5}),
        (
            "d-coach",
            {"width": 8, "learning_rate": 0.1, "magnitude": 0.5, "scaling": (2.0, *[1.0] * 7)},
        ),
    ],
)
def test_its_settings_are_read_from_what_was_saved(algo, options, tmp_path):
    saved(tmp_path / "kept", algo, "lunarlander", learned=False, **options)
    assert of_saved(tmp_path / "kept", None, None).settings == options


@pytest.mark.parametrize(
    ("algo", "options"),
    [
        ("gpc", {"human_scaling": (1.0, 2.0, 3.0), "sparsify": False}),
        pytest.param("gpc", {"scaling": (1.0, 1.0)}, marks=pytest.mark.slow),
        pytest.param("gpc-ns", {"scaling": (1.0, 1.0)}, marks=pytest.mark.slow),
        pytest.param("gpc-ns", {"human_scaling": (1.0, 2.0, 3.0)}, marks=pytest.mark.slow),
        pytest.param("d-coach", {"scaling": (2.0, 2.0)}, marks=pytest.mark.slow),
    ],
)
def test_what_is_no_number_is_taken_from_what_was_saved(algo, options, course_of, tmp_path):
    learner, state = saved("kept", algo, "mountaincar", **options)
    course, origin = course_of("--from", "kept")
    assert (dict(course.settings), dict(course.variants)) == ({}, options)
    (tmp_path / "lesson").mkdir()
    taught = Taught.begin(tmp_path / "lesson", course, origin)
    np.testing.assert_array_equal(taught.session.act(OBS), learner.act(state, OBS))
    # Versions that know no variants refuse it, and damaged ones are told.
    file = tmp_path / "lesson" / COURSE
    content = json.loads(file.read_bytes())
    assert content["format"] == 2
    for wrong in ({"scaling": [1.0]}, {"sparsify": 3}, {"rate": 0.5}, []):
        file.write_text(json.dumps({**content, "variants": wrong}))
        with pytest.raises(UserError):
            Course.read(tmp_path / "lesson")


def test_what_no_setting_says_is_not_taught_as_something_else(course_of, tmp_path):
    learner = make_learner("tests.teach.drifting:Turned", "mountaincar", way="back")
    gpcjax.save_learner("kept", learner, learner.init(), env="mountaincar")
    (tmp_path / "lesson").mkdir()
    line = r"--from .*kept: its way is 'back', and no setting of a lesson says so \(it would be 'forth'\)"
    for words in ((), ("--set", "reach=2")):
        with pytest.raises(UserError, match=line):
            Taught.begin(tmp_path / "lesson", *course_of("--from", "kept", *words))
    learner = make_learner("tests.teach.drifting:Turned", "mountaincar", reach=3.0)
    gpcjax.save_learner("other", learner, learner.init(), env="mountaincar")
    course, origin = course_of("--from", "other")
    assert dict(course.settings) == {"reach": 3.0}
    assert float(Taught.begin(tmp_path / "lesson", course, origin).session.learner.reach) == 3.0


@pytest.mark.parametrize("credit", ["[[0.1], [0.2, 1]]", "1" + "0" * 400])
def test_a_setting_that_is_no_number_is_told_with_its_folder(credit, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    saved("kept", "gpc", "mountaincar", learned=False)
    card = read_card("kept", "learner")
    card["provenance"]["session"] = {"settings": {"credit": json.loads(credit)}}
    write_folder(tmp_path / "odd", card, read_arrays("kept", card, "learner"))
    assert cli.main(["teach", "--from", "odd"]) == 2
    said = capsys.readouterr().err
    assert "--from odd: its credit" in said and "is no number" in said and said.count("\n") == 1


@pytest.mark.parametrize("damaged", [{"shapes": "x"}, {"recipe": {"settings": "gpc"}}])
def test_a_damaged_card_of_a_learner_of_ones_own_is_told(damaged, tmp_path):
    saved(tmp_path / "kept", "tests.teach.drifting:Turned", "mountaincar")
    card = read_card(tmp_path / "kept", "learner")
    arrays = read_arrays(tmp_path / "kept", card, "learner")
    told = {
        name: {**card[name], **value} if isinstance(value, dict) else value for name, value in damaged.items()
    }
    write_folder(tmp_path / "odd", {**card, **told}, arrays)
    with pytest.raises(UserError, match=r"odd/card\.json: this is not a learner's card"):
        gpcjax.load_learner(tmp_path / "odd")


def test_variants_are_given_by_flags(course_of):
    words = ("--scaling", "1,2", "--human-scaling", "1,2,3", "--no-sparsify")
    course, _ = course_of("--env", "mountaincar", *words)
    assert dict(course.variants) == {
        "scaling": (1.0, 2.0),
        "human_scaling": (1.0, 2.0, 3.0),
        "sparsify": False,
    }
    saved("kept", "gpc", "mountaincar", learned=False, scaling=(3.0, 4.0), sparsify=False)
    course, _ = course_of("--from", "kept", "--scaling", "1,2", "--sparsify")
    assert dict(course.variants) == {"scaling": (1.0, 2.0), "sparsify": True}


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            "rate=0.5",
            "--set rate: what a person teaches has no such setting, give policy_length_scale, policy_v",
        ),
        ("beta=3", "--set beta: with gpc alone it changes nothing, give it with coach"),
        ("nose=3", "--set nose: what a person teaches has no such setting (did you mean noise?), give"),
    ],
)
def test_what_is_no_setting_of_a_lesson_is_refused(words, line, capsys):
    assert cli.main(["teach", "--env", "mountaincar", "--set", words]) == 2
    assert line in capsys.readouterr().err


def test_a_setting_for_each_action_dimension_is_none_of_a_lesson(tmp_path):
    saved(tmp_path / "kept", "coach", "lunarlander", beta=(1.0, 2.0))
    with pytest.raises(UserError, match="its beta is another one in each action dimension"):
        of_saved(tmp_path / "kept", None, None)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--env", "cartpole", "--algo", "gpc"), "it holds what coach learned, which means nothing to gpc"),
        ((), "--from kept: it does not say what it learned, give the task (--env)"),
    ],
)
def test_another_learner_is_not_taught_under_its_name(words, line, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    saved("kept", "coach", "cartpole", told=False)
    assert cli.main(["teach", "--from", "kept", *words]) == 2
    said = capsys.readouterr().err
    assert line in said and said.count("\n") == 1
    (tmp_path / "out").mkdir()
    with pytest.raises(UserError, match="it holds what coach learned, which means nothing to gpc"):
        Taught.begin(tmp_path / "out", Course("cartpole", "gpc"), tmp_path / "kept")
    assert not list((tmp_path / "out").iterdir())


def test_a_lessons_own_save_needs_no_further_word(course_of, tmp_path):
    (tmp_path / "one").mkdir()
    course = Course("mountaincar", "gpc", (("human_noise", 1e-3), ("credit", 0.2)), 4)
    taught = Taught.begin(tmp_path / "one", course)
    taught.advise(Press(1, 0, 1, 0, 0.0, 0.0, False))
    taught.save("a")
    save = tmp_path / "one" / SAVES / "a"
    assert course_of("--from", str(save))[0] == Course("mountaincar", "gpc", course.settings)
    # Of a version that did not write the task down the lesson beside it tells.
    card = read_card(save, "learner")
    del card["provenance"]["env"]
    arrays = read_arrays(save, card, "learner")
    write_folder(tmp_path / "one" / SAVES / "older", card, arrays)
    assert course_of("--from", f"one/{SAVES}/older")[0] == Course("mountaincar", "gpc", course.settings)


def test_lessons_that_began_with_a_saved_learner_of_another_name_go_on(tmp_path):
    """As versions before wrote them: what was saved lies in `start` as it was."""
    saved(tmp_path / "kept", "coach", "mountaincar")
    (tmp_path / "lesson").mkdir()
    taught = Taught.begin(tmp_path / "lesson", Course("mountaincar", "coach"), tmp_path / "kept")
    taught.step()
    taught.end("over")
    file = tmp_path / "lesson" / COURSE
    file.write_text(file.read_text().replace('"coach"', '"gpc"'))
    again = Taught.resume(tmp_path / "lesson", lambda line: None, whole=True)
    assert type(again.session.learner).__name__ == "COACH"
