"""Learners from elsewhere: the description of a class or a function in a person's own module."""

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from gpcjax.allowed import checked, shown
from gpcjax.describe import LearnerSpec
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.learners.base import Learner
from gpcjax.making import Maker, told_apart
from gpcjax.own_settings import settings_from
from gpcjax.registry import resolve

_SIZES: tuple[str, ...] = ("obs_size", "action_size")

_TRIED = ((1, 1), (2, 1), (4, 2), (16, 8))
"""Sizes for which a learner is made to see what it is, until one is taken: some need more than one of a kind."""


class NoLearner(UserError):
    """What was made is something else."""


def learner_of(name: str, found: Callable[..., Any]) -> LearnerSpec:
    """The description of a learner of a person's own: a class, or a function, that makes it from its sizes.

    It is made, for a few small sizes, to see what it is. Where it takes none of these, that is seen when the task is
    known (`check_made`). Arguments with a number as their default become settings.

    Raises:
        UserError: what it makes is no learner, or it has a setting of every sweep's name.
        ForeignError: it cannot be made from sizes.
    """
    if inspect.isclass(found) and not issubclass(found, Learner):
        raise NoLearner(f"algo {name}: {shown(found)} is no learner, give a subclass of gpcjax.Learner")
    source = f"algo {name}"
    make = Maker(source, found, functools.partial(_accepted, source))
    settings = settings_from(source, found, others=_SIZES)
    sizes = _sizes_taken(make)
    return LearnerSpec(name=name, make=make, settings=told_apart(make, settings, **sizes))


@functools.cache
def check_made(spec: LearnerSpec, sizes: tuple[int, int]) -> None:
    """Makes a learner of a person's own for a task of these sizes, as its class or function makes it.

    Raises:
        UserError, ForeignError: it cannot be made for these, or has others.
    """
    if isinstance(spec.make, Maker):
        asked = dict(zip(_SIZES, sizes, strict=True))
        check_sizes(spec.name, spec.make(**asked), asked)


def check_sizes(name: str, learner: Learner, asked: Mapping[str, Any]) -> None:
    """Raises UserError: it is of other sizes than were asked for."""
    for size in _SIZES:
        if (has := getattr(learner, size, None)) != asked[size]:
            raise UserError(
                f"algo {name}: it makes a learner of {size} {shown(has)} where {asked[size]} is needed"
            )


def arguments(spec: LearnerSpec) -> dict[str, Any]:
    """What a person's class or function takes by name, with defaults; texts and such are no settings of a sweep."""
    parameters = inspect.signature(resolve(spec.make)).parameters.values()
    return {
        each.name: each.default
        for each in parameters
        if each.kind in (each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY)
    }


def checked_settings(spec: LearnerSpec, values: dict[str, Any]) -> dict[str, Any]:
    """The values of a learner of a person's own, its settings within the bounds that its description has."""
    settings = {each.name: each for each in spec.settings}
    return {
        name: checked(name, value, settings[name].kind, settings[name].allowed)
        if name in settings and (value is not None or settings[name].default is not None)
        else value
        for name, value in values.items()
    }


def _sizes_taken(make: Maker[Learner]) -> dict[str, int]:
    """The first sizes for which it can be made, the last of all if there are none."""
    sizes: dict[str, int] = {}
    for tried in _TRIED:
        sizes = dict(zip(_SIZES, tried, strict=True))
        try:
            make.__signature__.bind(**sizes)
            make(**sizes)
        except TypeError:
            make(**sizes)  # tells of what else it takes
        except NoLearner:
            raise
        except UserError:
            continue
        return sizes
    return sizes


def _accepted(source: str, made: Any) -> Learner:
    if not isinstance(made, Learner):
        raise NoLearner(f"{source}: {shown(made)} is no learner, give a subclass of gpcjax.Learner")
    return fixed(made)
