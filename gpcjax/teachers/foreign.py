"""Teachers from elsewhere: the description of a class or a function in a person's own module."""

import functools
import inspect
from collections.abc import Callable
from typing import Any

from gpcjax.allowed import shown
from gpcjax.describe import TeacherSpec
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.making import Maker, told_apart
from gpcjax.own_settings import settings_from
from gpcjax.teachers.base import Teacher

_OF_A_SWEEP = {"rate": 0.05, "error": 0.0, "delta": 0.05, "time_step": 1.0}
"""Settings of every sweep that a teacher may take."""


def teacher_of(name: str, found: Callable[..., Any]) -> TeacherSpec:
    """The description of a teacher of a person's own: a class, or a function, that makes it from its settings.

    It is made, to see what it is. Arguments with a number as their default become settings; `rate`, `error`
    and `delta` are those of the sweep, `time_step` the task's (seconds).

    Raises:
        UserError: what it makes is no teacher, or it has a setting of every sweep's name.
        ForeignError: it cannot be made.
    """
    if inspect.isclass(found) and not issubclass(found, Teacher):
        raise UserError(f"teacher {name}: {shown(found)} is no teacher, give a subclass of gpcjax.Teacher")
    source = f"teacher {name}"
    make = Maker(source, found, functools.partial(_accepted, source))
    settings = settings_from(source, found, others=(*_OF_A_SWEEP, "schedule"))
    given = {word: value for word, value in _OF_A_SWEEP.items() if word in make.__signature__.parameters}
    make(**given)
    return TeacherSpec(name=name, make=make, settings=told_apart(make, settings, **given))


def _accepted(source: str, made: Any) -> Teacher:
    if not isinstance(made, Teacher):
        raise UserError(f"{source}: {shown(made)} is no teacher, give a subclass of gpcjax.Teacher")
    return fixed(made)
