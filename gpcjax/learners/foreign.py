"""Learners from elsewhere: the description of a class or a function in a person's own module."""

import functools
import inspect
from collections.abc import Callable
from typing import Any

from gpcjax.allowed import shown
from gpcjax.describe import LearnerSpec, settings_from
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.learners.base import Learner
from gpcjax.making import Maker, told_apart

_SIZES = {"obs_size": 1, "action_size": 1}


def learner_of(name: str, found: Callable[..., Any]) -> LearnerSpec:
    """The description of a learner of a person's own: a class, or a function, that makes it from its sizes.

    It is made, for one observation and one action, to see what it is. Arguments with a number as their default become
    settings.

    Raises:
        UserError: what it makes is no learner, or it has a setting of every sweep's name.
        ForeignError: it cannot be made.
    """
    if inspect.isclass(found) and not issubclass(found, Learner):
        raise UserError(f"algo {name}: {shown(found)} is no learner, give a subclass of gpcjax.Learner")
    source = f"algo {name}"
    make = Maker(source, found, functools.partial(_accepted, source))
    settings = settings_from(source, found, others=tuple(_SIZES))
    make(**_SIZES)
    return LearnerSpec(name=name, make=make, settings=told_apart(make, settings, **_SIZES))


def _accepted(source: str, made: Any) -> Learner:
    if not isinstance(made, Learner):
        raise UserError(f"{source}: {shown(made)} is no learner, give a subclass of gpcjax.Learner")
    return fixed(made)
