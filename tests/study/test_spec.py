"""A study's file: what it says, and one line for each mistake."""

from pathlib import Path

import pytest

from gpcjax.errors import UserError
from gpcjax.study.reading import read_study
from gpcjax.study.steps import steps_of
from tests.study.example import TOML, study_with

SWEEPS = Path(__file__).parents[2] / "sweeps"


def test_the_study_of_the_thesis():
    """Of 4.1.2: two dummy runs and two recorded ones, of each learner on each task."""
    study = read_study(SWEEPS / "study_thesis.toml")
    assert study.participants == 4 and study.tasks == ("pendulum", "cartpole", "lunarlander")
    assert {course.algo for course in study.every_course()} == {"gpc", "coach"}
    assert [cell.treatments[0].learner for cell in study.slots].count("gpc") == 2
    steps = steps_of(study, study.slots[0])
    assert [step.kind for step in steps[:4]] == ["consent", "check", "instructions", "trial"]
    runs = [step.run for step in steps if step.run is not None and step.kind == "run"]
    assert len(runs) == 24 and [run.folder for run in runs[:6]] == [
        "01-dummy-A-pendulum", "02-dummy-A-pendulum", "03-recorded-A-pendulum", "04-recorded-A-pendulum",
        "05-dummy-B-pendulum", "06-dummy-B-pendulum",
    ]  # fmt: skip
    assert [step.kind for step in steps[8:9]] == ["questions"] and steps[-1].name == "questions-end"


def test_arms_within_participants_share_the_letters(tmp_path):
    late = '[[arms]]\nname = "late"\ncredit = 0.2\ncue = true\ndelay = 0.1\n'
    arms = f'arms_are = "within"\n[[arms]]\nname = "plain"\n{late}'
    text = TOML.replace('algo = "coach"', 'algo = "gpc-ns"')
    _, study = study_with(tmp_path, "[[learners]]", f"{arms}[[learners]]", text)
    assert len(study.slots[0].treatments) == 4 and study.slots[0].arm is None
    treatment = next(each for each in study.slots[0].treatments if each == ("gpc", "late"))
    assert dict(study.course(treatment, "pendulum", 3).settings) == {"credit": 0.2}
    assert study.arm("late").cue and study.arm("late").delay == 0.1


def test_a_learner_may_scale_and_do_without_sparsification(tmp_path):
    plain = '[[learners]]\nname = "plain"\nalgo = "gpc"\nsparsify = false\nscaling = [1, 2, 3]\n[orders]'
    _, study = study_with(
        tmp_path, "[orders]", plain, TOML.replace('["pendulum", "cartpole"]', '["pendulum"]')
    )
    treatment = next(each for slot in study.slots for each in slot.treatments if each.learner == "plain")
    course = study.course(treatment, "pendulum", 3)
    assert dict(course.variants) == {"scaling": (1.0, 2.0, 3.0), "sparsify": False} and course.seed == 3
    cell = course.cell(1)
    assert (cell.scaling, cell.sparsify) == ((1.0, 2.0, 3.0), False)


def test_arms_between_participants(tmp_path):
    arms = '[[arms]]\nname = "few"\nparticipants = 1\n[[arms]]\nname = "gpc"\nlearners = ["gpc"]\n'
    _, study = study_with(tmp_path, "[[learners]]", f"{arms}[[learners]]")
    assert sorted(cell.arm for cell in study.slots) == ["few", "gpc", "gpc", "gpc"]


@pytest.mark.parametrize(
    "old, new, told",
    [
        ('title = "Small"', "", "title is missing"),
        ('title = "Small"', "title = 3", "title 3: give a text"),
        ("participants = 4", "participants = 0", "participants 0: give a whole number from 1"),
        ("participants = 4", "particpants = 4", "participants is missing"),
        ('"pendulum", "cartpole"', '"pendulum", "pendulum"', "'pendulum' is given twice"),
        ('"pendulum", "cartpole"', '"pendulm"', "did you mean pendulum"),
        ('algo = "coach"', 'algo = "gpc"', "[[learners]] 2: name: 'gpc' is given twice"),
        ('algo = "coach"', 'algo = "coach"\nbeta = 3\ncredti = 1', "credti"),
        ('algo = "coach"', 'algo = "coach"\nsparsify = true', "[[learners]] 2: sparsify"),
        ('algo = "coach"', 'algo = "coach"\nenv = "cartpole"', "[[learners]] 2: env: it is known already"),
        ("dummy = 1", "dumy = 1", "[runs] 'dumy' is not known (did you mean dummy?)"),
        ("recorded = 1", "recorded = 0", "[runs] recorded 0: nothing would be recorded"),
        ("episodes = 2", "[runs.episodes]\nlander = 2", "'lander' is no task of this study"),
        ('tasks = "fixed"', 'tasks = "random"', "[orders] tasks 'random': give complete, latin or fixed"),
        ('tasks = "fixed"', 'tasks = "fixed"\nparticipants = 1', "the caps of orders and arms leave room for"),
        ("width = 300", 'width = "wide"', "[check] width 'wide': give a whole number"),
        ('task = "cartpole"', 'task = "cartpole"\npasses = "return"', "[trial] return is missing"),
        ('kind = "scale"', 'kind = "slider"', "[[questions]] 1: kind 'slider': give scale, choice or text"),
        ('labels = ["hard", "easy"]', 'labels = ["hard"]', "labels"),
        ('name = "remarks"', 'name = "easy"', "'easy' is given twice"),
        ('name = "remarks"', 'name = "Re marks"', "give small letters"),
        ("https://example.org", "http://example.org", "[completed] link"),
        ("https://example.org/", "https://{code}/", "[completed] link"),
        ("https://example.org/", "javascript:alert(1)//", "[completed] link"),
        ("[completed]", "[joining]\ncodes = ['a b']\n[completed]", "[joining] codes 'a b'"),
        ("[[learners]]", "[[arms]]\nname = 'cue'\ncue = true\n[[learners]]",
         "coach cannot say how sure it is, which would tell them apart"),
        ("[[learners]]", "[[arms]]\nname = 'cue'\ncue = true\nlearners = ['coach']\n[[learners]]",
         "coach cannot say how sure it is: give"),
        ("[completed]", "[completd]", "'completd' is not known"),
        ("[check]\nwidth = 300\nround_trip = 500", "[[check]]\nwidth = 3", "[check] [{'width': 3}]: give a table"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_with_its_place(tmp_path, old, new, told):
    with pytest.raises(UserError) as error:
        study_with(tmp_path, old, new)
    line = str(error.value)
    assert told in line and str(tmp_path / "study_small.toml") in line and "\n" not in line


def test_another_study_does_not_go_on_in_a_folder(tmp_path):
    study_with(tmp_path)
    study_with(tmp_path)
    with pytest.raises(UserError, match=r"keeps another study .*seed = 7000"):
        study_with(tmp_path, "seed = 7000", "seed = 8000")


def test_the_example_is_what_it_seems(tmp_path):
    out, study = study_with(tmp_path)
    assert (out / "study.toml").read_text() == TOML
    assert study.completed.link_of("a&b=c/d") == "https://example.org/back?who=a%26b%3Dc%2Fd"
