"""What a study is: one frozen `Study`, which `gpcjax.study.reading` makes of its file. Loads no jax."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from urllib.parse import quote

from gpcjax.study.design import Arm, Cell, Treatment
from gpcjax.study.questions import Question
from gpcjax.teach.course import Course


@dataclass(frozen=True)
class Runs:
    """How often and how long each learner is taught each task."""

    dummy: int
    """Runs to get acquainted, before those that are recorded for the analysis; their recordings are kept, too."""
    recorded: int
    episodes: Mapping[str, int]
    """Of each run, by task."""
    seconds: float
    """At the task, after which a run ends; pauses do not count."""
    rest: float
    """Seconds before the next run can be begun."""
    idle: float | None
    """Seconds without a key after which a run pauses and asks; None: never."""


@dataclass(frozen=True)
class Check:
    """What a participant's machine must come up to; None where anything does."""

    width: int | None
    height: int | None
    """Of the page, in CSS pixels."""
    frame_rate: float | None
    """Animation frames a second, at least."""
    round_trip: float | None
    """Milliseconds to the server and back, at most."""


@dataclass(frozen=True)
class Trial:
    """What must be managed before the runs begin."""

    task: str
    course: Course
    passes: str
    """By "keys", each pressed `presses` times, or by the "return" of an episode, `total` or more."""
    presses: int
    total: float
    episodes: int
    seconds: float
    attempts: int


@dataclass(frozen=True)
class Ending:
    """What a participant sees at an end, and what a platform wants to hear of it."""

    text: str
    code: str | None = None
    link: str | None = None
    """`{code}` in it stands for the participant's own."""

    def link_of(self, participant: str) -> str | None:
        """The link for one participant."""
        return None if self.link is None else self.link.replace("{code}", quote(participant, safe=""))


CODE_WORDS = "1 to 64 letters, digits and _.@-"
_CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")


def is_code(text: object) -> bool:
    """Whether a text may be a participant's code."""
    return isinstance(text, str) and _CODE.fullmatch(text) is not None


@dataclass(frozen=True)
class Joining:
    """Who may come in, and how."""

    parameters: tuple[str, ...]
    """Of the page's address that may hold the code, as recruiting platforms pass it."""
    codes: frozenset[str] | None
    """The codes that are admitted; None: any."""
    typed: bool
    """Whether a code may be typed on the first page."""
    hours: float
    """For which somebody who left the page may come back; the place is given to another then."""
    a_minute: int
    """New participants at most."""


@dataclass(frozen=True)
class Study:
    """A study as its file has it."""

    title: str
    seed: int
    participants: int
    tasks: tuple[str, ...]
    courses: Mapping[tuple[str, str, str], Course]
    """By learner, arm and task; their seed is 0."""
    arms: tuple[Arm, ...]
    within: bool
    outer: str
    """What changes slowest in a participant's runs: tasks or learners."""
    runs: Runs
    consent: str
    instructions: str
    check: Check
    trial: Trial | None
    questions: tuple[Question, ...]
    completed: Ending
    declined: Ending
    failed: Ending
    joining: Joining
    slots: tuple[Cell, ...]
    """For each participant an arm and an order, in the order in which they come (`gpcjax.study.design`)."""

    def course(self, treatment: Treatment, task: str, seed: int) -> Course:
        """What is taught in a run."""
        known = self.courses[treatment.learner, treatment.arm, task]
        return replace(known, seed=seed)

    def arm(self, name: str) -> Arm:
        """The arm of this name."""
        return next(arm for arm in self.arms if arm.name == name)

    def every_course(self) -> list[Course]:
        """Each that somebody can be taught with, once."""
        trial = [self.trial.course] if self.trial is not None else []
        return list(dict.fromkeys([*self.courses.values(), *trial]))
