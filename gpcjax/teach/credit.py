"""Which of the steps of an episode an advice of a lesson is about, as far as one can be named."""

import math
from typing import NamedTuple

from gpcjax.engine.history import Credit
from gpcjax.lateness import CREDIT
from gpcjax.registry import find
from gpcjax.teach.course import Course


class Credited(NamedTuple):
    """How late advice is, in steps."""

    back: int = 0
    """To the step that it is shown to be about."""
    least: int = 0
    """To the latest one that it may be about: as long as there is none, it is about nothing."""


def credited(course: Course) -> Credited:
    """Of what is taught in a course."""
    settings, time_step = dict(course.settings), find("task", course.env).seconds
    seconds, longest, shape = (settings.get(name) for name in CREDIT)
    credit = Credit.of(seconds, longest, shape, time_step)
    back = math.floor(settings.get("credit", 0.0) / time_step + 0.5)
    return Credited(back, 0 if credit is None else credit.first)
