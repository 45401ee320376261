"""How many steps late advice is: a distribution, for teachers that are late and for learners that reckon with it."""

import math

import numpy as np
from scipy.special import gammainc, gammaincinv

from gpcjax.errors import UserError

MOST = 1024
"""Steps back that advice may be about: as many observations are kept of every lane."""

_COVERED = 0.999
"""Of a gamma distribution; its tail is left out."""


def lateness(
    where: str, seconds: float, longest: float | None, shape: float | None, time_step: float
) -> tuple[float, ...]:
    """The chance of each number of steps between a step and the advice about it: 0, 1, ..., the last one above 0.

    Args:
        where: begins messages.
        seconds: the delay itself; the shortest one if there is a `longest`; the mean one if there is a `shape`.
        longest: all delays from `seconds` to this are as likely.
        shape: of a gamma distribution.
        time_step: seconds of a step.

    Raises:
        UserError: `longest` is below `seconds`, both it and `shape` are given, or it is more than 1,024 steps.
    """
    if longest is not None and shape is not None:
        raise UserError(f"{where}_longest: beside {where}_shape it changes nothing, give one of the two")
    if longest is not None and longest < seconds:
        raise UserError(f"{where}_longest {longest}: give at least {where}, {seconds}")
    if shape is not None and seconds == 0:
        raise UserError(f"{where}_shape: give {where}, its mean, too")
    scale = seconds / shape if shape is not None else 0.0
    last = longest if longest is not None else seconds
    if shape is not None:
        last = float(gammaincinv(shape, _COVERED)) * scale
    first, last = _steps(seconds, time_step), _steps(last, time_step)
    if last > MOST:
        raise UserError(
            f"{where}: {last:,} steps of {time_step} s, at most {MOST:,} are kept: give fewer seconds"
        )
    steps = np.arange(last + 1)
    if shape is None:
        chances = (steps >= first).astype(float)
    else:
        edges = np.maximum(np.arange(last + 2) - 0.5, 0.0) * time_step
        chances = np.diff(gammainc(shape, edges / scale))
    return tuple((chances / chances.sum()).tolist())


def _steps(seconds: float, time_step: float) -> int:
    """The nearest whole number of steps; halves are rounded up."""
    return math.floor(min(seconds / time_step, 1e9) + 0.5)
