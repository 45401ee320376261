"""A study's folder as if people had been there: rows of known numbers, without a hall."""

import numpy as np

from gpcjax.study.register import Register
from gpcjax.teach.rows import write_rows
from tests.study.example import study_with

CHECKED = {"width": 900.0, "height": 700.0, "frame_rate": 60.0, "round_trip": 3.0}


def returns_of(run, number, episodes=2):
    """GPC is better by its participant's number, the second recorded run by 1."""
    base = 100.0 * (run.task == "cartpole") + 10.0 * number + run.repetition
    return base + number * (run.treatment.learner == "gpc") + np.arange(episodes)


def write_run(participant, run, returns):
    """What a hall leaves of a run, without recording and policy."""
    folder = participant.run_folder(run)
    folder.mkdir(parents=True, exist_ok=True)
    course = participant.study.course(run.treatment, run.task, participant.seed + run.repetition)
    course.write(folder)
    count = len(returns)
    numbers = {
        name: np.full(count, value)
        for name, value in {
            "length": 10, "corrections": 3, "policy_points": 2, "human_points": 2, "clipped": 0, "full": 0, "asked": 0,
        }.items()
    }  # fmt: skip
    episodes = {
        "returns": np.asarray(returns, float),
        "rate_sum": np.full(count, 0.3),
        "chance_sum": np.zeros(count),
        "whole": np.ones(count, bool),
    }
    log = {
        "moments": np.zeros((1, 3), int),
        "values": np.full((1, 3), 0.1),
        "outcome": np.zeros((1, 3), bool),
    }
    write_rows(folder, course, numbers | episodes, {}, log)


def goes(participant, steps=None, answers=None):
    """Does so many steps, or all; an answer to each question by its kind."""
    done = 0
    while (step := participant.step) is not None and done != steps:
        match step.kind:
            case "check":
                participant.checked(CHECKED, True)
            case "trial":
                participant.attempted(True)
            case "run":
                write_run(participant, step.run, returns_of(step.run, participant.kept.number))
                participant.advance("run")
            case "questions":
                values = {
                    "scale": 1
                    + participant.kept.number % 6
                    + (step.run is not None and step.run.letter == "A"),
                    "choice": "A",
                    "text": "a | *text* <b>",
                }
                participant.answered({each.name: (answers or values)[each.kind] for each in step.questions})
            case kind:
                participant.advance(kind)
        done += 1


def study_of(folder, codes=("one", "two", "three"), old="", new=""):
    """A study with these participants, who have done all."""
    out, study = study_with(folder, old, new)
    register = Register(out, study)
    for code in codes:
        goes(register.admit(code))
    return out, register
