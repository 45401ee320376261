"""How many steps late advice is: a distribution, for teachers that are late and for learners that reckon with it."""

import itertools
import math
from collections.abc import Mapping, Sequence

from gpcjax.errors import UserError

MOST = 1024
"""Steps back that advice may be about: as many observations are kept of every lane."""

_COVERED = 0.999
"""Of a gamma distribution; its tail is left out."""


def lateness(
    where: str, seconds: float | None, longest: float | None, shape: float | None, time_step: float
) -> tuple[float, ...]:
    """The chance of each number of steps between a step and the advice about it: 0, 1, ..., the last one above 0.

    Args:
        where: begins messages; the names of `longest` and `shape` begin with it.
        seconds: the delay itself; the shortest one if there is a `longest`; the mean one if there is a `shape`. None is
            no delay.
        longest: all delays from `seconds` to this are as likely.
        shape: of a gamma distribution.
        time_step: seconds of a step.

    Raises:
        UserError: `longest` is below `seconds`, two of them do not fit together, or it is more than 1,024 steps.
    """
    given = [name for name, value in (("longest", longest), ("shape", shape)) if value is not None]
    if len(given) == 2:
        raise UserError(f"{where}_longest: beside {where}_shape it changes nothing, give one of the two")
    if given and not seconds and (given[0] == "shape" or seconds is None):
        raise UserError(f"{where}_{given[0]}: without {where} it changes nothing, give both")
    if seconds is None:
        return (1.0,)
    if longest is not None and longest < seconds:
        raise UserError(f"{where}_longest {longest:g}: give at least {where}, {seconds:g}")
    if shape is not None:
        return _gamma(where, seconds, shape, time_step)
    first, last = _steps(seconds, time_step), _steps(seconds if longest is None else longest, time_step)
    _check(where if longest is None else f"{where}_longest", last, time_step)
    return (0.0,) * first + (1.0 / (last - first + 1),) * (last - first + 1)


def check(where: str, values: Mapping[str, Sequence[float]], time_step: float) -> None:
    """Refuses settings that `lateness` would, of all that a sweep combines. Raises UserError."""
    axes = [values.get(f"{where}{suffix}", (None,)) for suffix in ("", "_longest", "_shape")]
    for seconds, longest, shape in itertools.product(*axes):
        lateness(where, seconds, longest, shape, time_step)


def _gamma(where: str, mean: float, shape: float, time_step: float) -> tuple[float, ...]:
    import numpy as np
    from scipy.special import gammainc, gammaincinv

    scale = mean / shape
    last = _steps(float(gammaincinv(shape, _COVERED)) * scale, time_step)
    _check(where, last, time_step)
    edges = np.maximum(np.arange(last + 2) - 0.5, 0.0) * time_step
    chances = np.diff(gammainc(shape, edges / scale))
    return tuple((chances / chances.sum()).tolist())


def _check(where: str, last: int, time_step: float) -> None:
    if last > MOST:
        raise UserError(
            f"{where}: {last:,} steps of {time_step:g} s, {MOST:,} are kept at most: give fewer seconds"
        )


def _steps(seconds: float, time_step: float) -> int:
    """The nearest whole number of steps; halves are rounded up."""
    return math.floor(min(seconds / time_step, 1e9) + 0.5)
