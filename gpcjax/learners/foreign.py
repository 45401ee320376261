"""Learners from elsewhere: the description of a class or a function in a person's own module."""

import inspect
from collections.abc import Callable
from typing import Any

from gpcjax.allowed import shown
from gpcjax.describe import LearnerSpec, settings_from
from gpcjax.errors import ForeignError, UserError
from gpcjax.learners.base import Learner

_SIZES = {"obs_size": 1, "action_size": 1}


def learner_of(name: str, found: Callable[..., Any]) -> LearnerSpec:
    """The description of a learner of a person's own: a class, or a function, that makes it from its sizes.

    It is made once, for one observation and one action, to see what it is. Arguments with a number as their default
    become settings.

    Raises:
        UserError: what it makes is no learner, or it has a setting of every sweep's name.
        ForeignError: it cannot be made.
    """
    if inspect.isclass(found) and not issubclass(found, Learner):
        raise UserError(f"algo {name}: {shown(found)} is no learner, give a subclass of gpcjax.Learner")
    settings = settings_from(f"algo {name}", found, others=tuple(_SIZES))
    make = _Maker(name, found)
    make(**_SIZES)
    return LearnerSpec(name=name, make=make, settings=settings)


class _Maker:
    """Makes a learner of a person's own."""

    def __init__(self, name: str, found: Callable[..., Any]):
        self._name, self._found = name, found

    def __call__(self, **values: Any) -> Learner:
        source = f"algo {self._name}"
        try:
            made = self._found(**values)
        except UserError:
            raise
        except Exception as error:
            raise ForeignError(f"{source}: it cannot be made", error) from None
        if not isinstance(made, Learner):
            raise UserError(f"{source}: {shown(made)} is no learner, give a subclass of gpcjax.Learner")
        return made
