"""What somebody's own method gives, held against what it should give: structures, shapes and types of arrays."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax.errors import ForeignError
from gpcjax.learners.info import Info


def check_learned(source: str, given: Any, state: Any, action: Any) -> None:
    """Raises ForeignError: it is not the new state and an Info, of the forms of `state` and of `action`."""
    if not isinstance(given, tuple) or len(given) != 2 or not isinstance(given[1], Info):
        raise does_not_fit(
            source, f"it gives {worded(given)}, it should give the new state and a gpcjax.Info"
        )
    check(source, "the new state", *(jax.tree.map(_as_array, each) for each in (given[0], state)))
    info = given[1]
    flag = jax.ShapeDtypeStruct(action.shape, jnp.bool_)
    for name in ("rate", "sigma_policy", "sigma_human"):
        check(source, f"Info.{name}", getattr(info, name), action)
    for name in ("appended", "replaced", "full"):
        check(source, f"Info.{name}", getattr(info, name), flag)
    status = _as_array(info.status)
    known = form(status)
    if known is None or known[0] != () or not jnp.issubdtype(known[1], jnp.integer):
        raise does_not_fit(
            source, f"Info.status is {worded(status)}, it should be one whole number, a Status"
        )


def check(source: str, what: str, given: Any, expected: Any, exactly: bool = False) -> None:
    """Raises ForeignError: it has another structure or shape, or another type that is not the same with more digits."""
    same = jax.tree.structure(given) == jax.tree.structure(expected)
    if not same or not all(
        form(one) == form(other) or (not exactly and _becomes(one, other))
        for one, other in zip(jax.tree.leaves(given), jax.tree.leaves(expected), strict=True)
    ):
        raise does_not_fit(source, f"{what} is {worded(given)}, it should be {worded(expected)}")


def does_not_fit(source: str, why: str) -> ForeignError:
    """The error that says so of a method."""
    return ForeignError(f"{source} does not fit", why)


def form(value: Any) -> tuple[Any, Any] | None:
    """Shape and type of an array; None of anything else."""
    shape, kind = getattr(value, "shape", None), getattr(value, "dtype", None)
    return None if shape is None or kind is None else (shape, kind)


def worded(given: Any) -> str:
    """What was given, in a message."""
    if (known := form(given)) is not None:
        return f"{known[1]} of shape {known[0]}"
    if isinstance(given, tuple | list):
        return f"({', '.join(map(worded, given[:4]))}{', ...' if len(given) > 4 else ''})"
    if isinstance(given, Mapping):
        return f"{{{', '.join(f'{name!r}: {worded(given[name])}' for name in [*given][:4])}}}"
    return "None" if given is None else f"a {type(given).__name__}"


def _as_array(leaf: Any) -> Any:
    """A number of Python's, which is an array in what comes of it; anything else as it is."""
    return np.asarray(leaf) if isinstance(leaf, bool | int | float | complex) else leaf


def _becomes(one: Any, other: Any) -> bool:
    """Whether an array is one of the other's type by what jax does with two types."""
    alike = form(one) is not None and form(other) is not None and one.shape == other.shape
    plain = alike and all(jnp.issubdtype(each.dtype, jnp.number) for each in (one, other))
    return plain and jnp.promote_types(one.dtype, other.dtype) == other.dtype
