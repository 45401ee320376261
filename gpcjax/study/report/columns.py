"""The tables that are made of a study, and the data dictionary: each column is named here. Loads no jax."""

from collections.abc import Mapping
from typing import NamedTuple

from gpcjax.sweep.sofar import FINAL_EPISODES


class Column(NamedTuple):
    """One column."""

    name: str
    kind: str
    """Of Arrow: string, int32, int64, float64, bool."""
    unit: str
    text: str


def _columns(*rows: tuple[str, str, str, str]) -> tuple[Column, ...]:
    return tuple(Column(*row) for row in rows)


_WHO = ("participant", "int32", "", "number, by the order of joining; the code is in no table")

_RUN = _columns(
    _WHO,
    ("run", "int32", "", "number, from 1, of all runs of this participant, in their order"),
    ("phase", "string", "", "dummy (to get acquainted) or recorded"),
    ("task", "string", "", "what was to be done"),
    ("learner", "string", "", "who was taught, by the study's name for it; the participant knew the letter alone"),
    ("arm", "string", "", "of the run"),
    ("letter", "string", "", "what the participant knew the learner, in this arm, by"),
    ("met", "int32", "", "how many-th of the learners (and arms) it was that this participant met, from 1"),
    ("task_met", "int32", "", "the same of the task"),
    ("repetition", "int32", "", "of this learner on this task, from 1, dummy runs first"),
    ("seed", "int64", "", "of the starts: the same for each learner at the same repetition, a hundred apart "
     "between participants"),
    ("complete", "bool", "", "whether the run came to its last episode, or to its limit of time"),
)  # fmt: skip

PARTICIPANTS = _columns(
    _WHO,
    ("state", "string", "", "complete, active, or how it ended: declined, failed, stopped, expired"),
    ("why", "string", "", "of the end, in words"),
    ("arm", "string", "", "where arms are between participants; else all"),
    ("learners", "string", "", "learners (and arms) in the order in which they were met"),
    ("tasks", "string", "", "tasks likewise"),
    ("steps", "int32", "", "of the study that were done, consent to the last questions"),
    ("of_steps", "int32", "", "how many there are"),
    ("runs", "int32", "", "recorded runs that are complete"),
    ("minutes", "float64", "min", "from joining to the end, or to the latest sign"),
    ("width", "float64", "CSS pixels", "of the page, at the check that was passed; null before"),
    ("height", "float64", "CSS pixels", "likewise"),
    ("frame_rate", "float64", "1/s", "animation frames, likewise"),
    ("round_trip", "float64", "ms", "to the server and back, likewise"),
    ("trials", "int32", "", "attempts at the trial"),
    ("came_back", "int32", "", "times that the page was opened again: a reload, a closed browser, a broken line"),
    ("looked_away", "int32", "", "times that the page was hidden in a run"),
    ("fell_idle", "int32", "", "times that a run paused for want of keys"),
    ("problems", "int32", "", "technical ones, as in the log"),
)  # fmt: skip

RUNS = (
    *_RUN,
    Column("episodes", "int32", "", "that have ended"),
    Column("is_cut", "bool", "", "whether the limit of time ended the last of these"),
    Column("steps", "int64", "steps", "in these"),
    Column("seconds", "float64", "s", "at the task, pauses not counted, in these"),
    Column("corrections", "int64", "", "advices that the learner took, of each action dimension, in these"),
    Column("area", "float64", "the task's reward", "mean return of an episode, but for one that was cut"),
    Column("final_return", "float64", "the task's reward", f"mean of the last {FINAL_EPISODES} of these, or of all"),
)  # fmt: skip

EPISODES = (
    *_RUN,
    *_columns(
        ("episode", "int32", "", "from 1"),
        ("return", "float64", "the task's reward", "sum of rewards"),
        ("length", "int32", "steps", "until the episode ended"),
        (
            "is_cut",
            "bool",
            "",
            "whether the run's limit of time ended it: its return is no return of an episode",
        ),
        ("corrections", "int32", "", "advices that the learner took, of each action dimension"),
        ("advice_rate", "float64", "1/step", "corrections for each step"),
        ("mean_rate", "float64", "normalised action", "mean learning rate of these; null without any"),
        (
            "policy_points",
            "int32",
            "points",
            "in the policy's dictionary at the end; null for learners without",
        ),
        ("human_points", "int32", "points", "the same of the human model"),
        ("clipped", "int32", "steps", "whose action was outside [-1, 1]"),
        ("full", "int32", "", "corrections that met a full dictionary"),
    ),
)

ANSWERS = _columns(
    _WHO,
    ("question", "string", "", "its name in the study's file"),
    ("kind", "string", "", "scale, choice or text"),
    ("run", "int32", "", "after which it was asked; null at the end"),
    ("task", "string", "", "of that run; null at the end"),
    ("learner", "string", "", "likewise"),
    ("arm", "string", "", "likewise"),
    ("letter", "string", "", "likewise"),
    ("value", "string", "", "as it was given; null where it was left out"),
    ("number", "float64", "points", "of a scale, from 1; null for others"),
    ("means", "string", "", "the learner (and arm) that a choice means which is one of the participant's letters"),
)  # fmt: skip

TABLES: Mapping[str, tuple[Column, ...]] = {
    "participants": PARTICIPANTS,
    "runs": RUNS,
    "episodes": EPISODES,
    "answers": ANSWERS,
}

_WHAT = {
    "participants": "A row for each participant, those who dropped out among them.",
    "runs": "A row for each run with an episode, dummy ones and those that were broken off among them.",
    "episodes": "A row for each finished episode of these.",
    "answers": "A row for each question that a participant came to.",
}

_HEAD = """# Data dictionary

What `gpcjax study report` has made of the study's folder. Participants have numbers here; their codes are in
`participants/*/participant.json` alone. No table has a time of day. Null stands for what does not exist. Free texts
are as participants have written them: look before you publish them.

The files `NAME.parquet` hold the tables below. `rows/PHASE/TASK-LEARNER` (and -ARM where there are several) are run
folders as those of a sweep, with one seed for each participant and repetition: `gpcjax.load` and
`gpcjax.load_corrections` read them, `gpcjax compare` compares them. An episode that
the limit of time has cut has the status `cut` there, and reports and comparisons leave it out.
"""


def dictionary() -> str:
    """The page that says what the columns are, in Markdown."""
    parts = [_HEAD]
    for name, columns in TABLES.items():
        parts.append(
            f"\n## {name}.parquet\n\n{_WHAT[name]}\n\n| column | type | unit | what |\n|---|---|---|---|\n"
        )
        parts += [f"| {each.name} | {each.kind} | {each.unit} | {each.text} |\n" for each in columns]
    return "".join(parts)
