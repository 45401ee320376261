"""Vectors of real numbers as a person gives them, checked; without jax, as long as none of them is jax's."""

import sys
from typing import Any

import numpy as np

from gpcjax.allowed import is_no_data, shown
from gpcjax.errors import UserError

Vector = Any
"""Real numbers as a person gives them: a list, a numpy or a jax array of one axis, traced or not. See `vector`."""


FARTHEST = 1e60
"""Numbers of an observation beyond it, up or down, are taken for it (`near`): their squares would be infinite, and an
action made of them no number. A run of a sweep stops there (`Status.NON_FINITE`): no task leads that far.

It is no bound within which numbers can be told apart: that is one of scaled numbers, and follows from their digits.
Those of a task may be large, where they are divided by as much (`scaling`, GPC-NS)."""


def near(obs: Any) -> Any:
    """An observation, an array of numpy's or of jax's, as policies take it, and what learns them from Python."""
    return obs.clip(-FARTHEST, FARTHEST)


def is_jax(value: object) -> bool:
    """Whether it is an array of jax's, traced or not. Nothing is, where nobody has imported jax."""
    kind = getattr(sys.modules.get("jax"), "Array", None)
    return kind is not None and isinstance(value, kind)


def is_traced(value: object) -> bool:
    """Whether it is an array that jax traces, whose numbers are not known."""
    kind = getattr(sys.modules.get("jax.core"), "Tracer", None)
    return kind is not None and isinstance(value, kind)


def vector(name: str, value: Vector, size: int, taker: str) -> Any:
    """`value` as float64 of shape (size,), on the host unless it is jax's already: what is compiled takes either.

    Args:
        name, taker: of the message: what it is, and who takes it.
        value: a list, a numpy or a jax array of real numbers, also one that jax traces, or a list of those.
        size: how long it must be.

    Raises:
        ValueError: another shape, or anything but real numbers (no truth values, no complex numbers, no text, no spans
            of time, no masked entries).
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.shape == (size,):
        return value  # what a control loop gives, a thousand times a second
    array = value if is_jax(value) else _host(value)
    if array is None or not _real(array.dtype):
        raise UserError(f"{name} {shown(value)}: {taker} takes {size} real numbers")
    if array.shape != (size,):
        raise UserError(f"{name} has shape {array.shape}, {taker} takes ({size},)")
    return array if array.dtype == np.float64 else array.astype(np.float64)


def beyond(action: Any) -> Any:
    """Whether each entry of an action, traced or not, is a number beyond [-1, 1]: no such action is ever executed.

    What is no number is another matter, and of what follows from it.
    """
    size = abs(action)
    return (size > 1.0) & (size < np.inf)


def check_executed(action: Any) -> None:
    """Refuse an executed action, a checked vector, that is beyond [-1, 1]. One that jax traces passes.

    Raises:
        UserError: it is.
    """
    if not is_traced(action) and beyond(np.asarray(action)).any():
        raise UserError(
            f"action {shown(np.asarray(action).tolist())}: each entry must be from -1 to 1, "
            "as it was executed: clip it"
        )


def _real(dtype: Any) -> bool:
    if dtype.kind in "fiu":
        return True
    if dtype.kind != "V" or dtype.names is not None:
        return False
    import jax.numpy as jnp  # of what is no type of numpy's own, such as bfloat16, only jax knows

    return jnp.issubdtype(dtype, np.floating) or jnp.issubdtype(dtype, np.integer)


def _host(value: Vector) -> Any:
    """An array of what is none yet, or None where there is no such array of data."""
    several = isinstance(value, list | tuple)
    if any(map(is_no_data, value if several else (value,))):
        return None
    if several and any(map(is_traced, value)):
        import jax.numpy as jnp

        try:
            return jnp.stack(value)
        except (TypeError, ValueError):
            return None
    try:
        return np.asarray(value)
    except (TypeError, ValueError):  # of several lengths, or an object that refuses
        return None
