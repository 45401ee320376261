"""How many steps late advice is: a distribution, for teachers that are late and for learners that reckon with it."""

import itertools
import math
from collections.abc import Mapping, Sequence

from gpcjax.errors import UserError

MOST = 1024
"""Steps back that advice may be about: as many observations are kept of every lane."""

Names = tuple[str, str, str]
"""What messages call the delay, the longest one and the shape."""

DELAY: Names = ("delay", "delay_longest", "delay_shape")
CREDIT: Names = ("credit", "credit_longest", "credit_shape")

_COVERED = 0.999
"""Of a gamma distribution; its tail is left out."""


def lateness(
    names: Names, seconds: float | None, longest: float | None, shape: float | None, time_step: float
) -> tuple[float, ...]:
    """The chance of each number of steps between a step and the advice about it: 0, 1, ..., the last one above 0.

    Args:
        names: begin messages.
        seconds: the delay itself; the shortest one if there is a `longest`; the mean one if there is a `shape`. None is
            no delay.
        longest: all delays from `seconds` to this are as likely.
        shape: of a gamma distribution.
        time_step: seconds of a step.

    Raises:
        UserError: `longest` is below `seconds`, two of them do not fit together, or it is more than 1,024 steps.
    """
    given = [name for name, value in zip(names[1:], (longest, shape), strict=True) if value is not None]
    if len(given) == 2:
        raise UserError(f"{given[0]}: beside {given[1]} it changes nothing, give one of the two")
    if given and not seconds and (shape is not None or seconds is None):
        raise UserError(f"{given[0]}: without {names[0]} it changes nothing, give both")
    if seconds is None:
        return (1.0,)
    if longest is not None and longest < seconds:
        raise UserError(f"{names[1]} {longest:g}: give at least {names[0]}, {seconds:g}")
    if shape is not None:
        return _gamma(names, seconds, shape, time_step)
    first, last = _steps(seconds, time_step), _steps(seconds if longest is None else longest, time_step)
    _check(names[0] if longest is None else names[1], last, time_step)
    return (0.0,) * first + (1.0 / (last - first + 1),) * (last - first + 1)


def check(
    names: Names, values: Mapping[str, Sequence[float]], places: Mapping[str, str], time_step: float
) -> None:
    """Refuses settings that `lateness` would, of all that a sweep combines; `places` is where they were given.

    Raises:
        UserError: the message begins with the place.
    """
    told = places.get(names[0], names[0]), places.get(names[1], names[1]), places.get(names[2], names[2])
    for combined in itertools.product(*(values.get(name, (None,)) for name in names)):
        seconds, longest, shape = combined
        lateness(told, seconds, longest, shape, time_step)


def _gamma(names: Names, mean: float, shape: float, time_step: float) -> tuple[float, ...]:
    import numpy as np
    from scipy.special import gammainc, gammaincinv

    scale = mean / shape
    longest = float(gammaincinv(shape, _COVERED)) * scale
    if not 0.0 < scale < math.inf or math.isnan(longest):
        raise UserError(
            f"{names[2]} {shape:g}: with {names[0]} {mean:g} there are no such delays, give a number nearer to 1"
        )
    last = _steps(longest, time_step)
    _check(names[0], last, time_step)
    edges = np.maximum(np.arange(last + 2) - 0.5, 0.0) * time_step
    chances = np.diff(gammainc(shape, edges / scale))
    return tuple((chances / chances.sum()).tolist())


def _check(source: str, last: int, time_step: float) -> None:
    if last > MOST:
        raise UserError(
            f"{source}: {last:,} steps of {time_step:g} s, {MOST:,} are kept at most: give fewer seconds"
        )


def _steps(seconds: float, time_step: float) -> int:
    """The nearest whole number of steps; halves are rounded up."""
    return math.floor(min(seconds / time_step, 1e9) + 0.5)
