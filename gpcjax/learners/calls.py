"""Methods of learners called from Python, once for each step or correction of somebody's own loop.

`equinox.filter_jit` takes learner and state apart at each call, sorts what is no array from what is, hashes that: 2 ms
of a correction that computes for one. Here that is done once for each learner and each structure of a state; a call
flattens the state, and hands its arrays to a compiled function.
"""

import contextlib
import functools
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.recent import recent

Function = Callable[..., Any]

NUMBERS = bool | int | float | complex | np.number | np.bool_
"""Types of numbers that are no arrays."""

KEPT = 64
"""Programs of one function that are kept, those called last: kinds of learners, with rooms of their states. A learner
with a function in a field is of another kind with each new function."""


class Called:
    """A function of a learner, its state and vectors, compiled for each structure of the first two."""

    def __init__(self, function: Function):
        functools.update_wrapper(self, function)
        self.function = function
        """The function itself, part of what jax traces."""
        self._otherwise = eqx.filter_jit(function)
        self._programs: OrderedDict[Any, Function] = OrderedDict()

    def __call__(self, learner: Any, state: Any, *vectors: Any, donate: bool = False) -> Any:
        """What the function gives.

        With `donate` the arrays of `state` may be overwritten: where all are arrays of jax's, and no other's too.

        Raises:
            UserError: `state` was given away before, or is by another thread meanwhile.
        """
        leaves, form, are_arrays = _flat(state)
        learners = _apart(learner)
        if learners is None or not (are_arrays and _are_arrays(vectors)):
            # Part of what jax traces, or something to be refused: where it is traced, as ever.
            check_kept(leaves)
            check_arrays(leaves)
            return self._otherwise(learner, state, *vectors)
        if leaves and _is_gone(leaves[0]):
            raise _given_away()
        numbers, kind = learners
        donate = donate and _can_be_given(leaves, numbers)
        key = kind, form, donate
        program = recent(self._programs, key, lambda: self._program(*key), KEPT)
        try:
            return program(numbers, leaves, *vectors)
        except (RuntimeError, ValueError, TypeError):  # jax's own
            if any(map(_is_gone, leaves)):  # where another thread came before
                raise _given_away() from None
            check_arrays(leaves)
            raise

    def _program(self, kind: Any, form: Any, donate: bool) -> Function:
        @functools.wraps(self.function)
        def run(numbers: list[Any], leaves: list[Any], *vectors: Any) -> Any:
            learner, state = jax.tree.unflatten(kind, numbers), jax.tree.unflatten(form, leaves)
            return self.function(_without_static(learner), state, *vectors)

        del run.__wrapped__  # whose signature has other names: jax looks it up
        return jax.jit(run, donate_argnums=(1,) if donate else ())


def check_kept(state: Any) -> None:
    """Raises UserError: the state was given away, so that there is nothing in its arrays."""
    if any(map(_is_gone, jax.tree.leaves(state))):
        raise _given_away()


def check_arrays(state: Any) -> None:
    """Raises UserError: an array of numpy's has no numbers that jax knows, such as texts, or masks some."""
    for leaf in jax.tree.leaves(state):
        if isinstance(leaf, np.ndarray):
            try:
                jax.eval_shape(lambda leaf: leaf, leaf)
            except (TypeError, ValueError):
                raise UserError(
                    f"state: it holds {type(leaf).__name__} of {leaf.dtype}, give an array of plain numbers"
                ) from None


@contextlib.contextmanager
def unless_given_away(values: Any) -> Iterator[None]:
    """Raises UserError in place of jax's errors: among these values are those of a state that was given away."""
    try:
        yield
    except (RuntimeError, ValueError):
        if not any(map(_is_gone, jax.tree.leaves(values))):
            raise
        raise _given_away() from None


def _is_gone(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and not isinstance(leaf, Tracer) and leaf.is_deleted()


def _given_away() -> UserError:
    return UserError("state: it was given away (donate), use the one that came of it")


_known: "weakref.WeakKeyDictionary[Any, tuple[list[Any], Any] | None]" = weakref.WeakKeyDictionary()


def _apart(learner: Any) -> tuple[list[Any], Any] | None:
    """The numbers of a learner, which never change, as arrays, and what else it is; None where jax traces one."""
    try:
        return _known[learner]
    except KeyError:
        pass
    leaves, kind = jax.tree.flatten(jax.tree.map(_number_or_static, fixed(learner)))
    found = (leaves, kind) if _are_arrays(leaves) else None
    _known[learner] = found
    return found


class _Static:
    """A leaf that is no number to trace, as part of a structure."""

    def __init__(self, value: Any):
        self.value = value


jax.tree_util.register_pytree_node(
    _Static, lambda static: ((), static.value), lambda value, _: _Static(value)
)


def _number_or_static(leaf: Any) -> Any:
    # A number of Python's is an array as it is in a lane: as a part of what is compiled each would be a program.
    if isinstance(leaf, float | complex | np.inexact):
        return np.asarray(leaf)
    return leaf if isinstance(leaf, np.ndarray | jax.Array) else _Static(leaf)


def _without_static(learner: Any) -> Any:
    is_static = lambda part: isinstance(part, _Static)  # noqa: E731
    return jax.tree.map(lambda part: part.value if is_static(part) else part, learner, is_leaf=is_static)


_last: tuple[Callable[[], Any], list[Any], Any, bool] = (lambda: None, [], None, True)
"""The last state that was taken apart (a weak reference) and what came of it: a policy acts many times with one."""


def _flat(state: Any) -> tuple[list[Any], Any, bool]:
    """The leaves of a state, its structure, and whether all are arrays that hold numbers."""
    global _last
    known, leaves, form, are_arrays = _last
    if known() is state is not None:
        return leaves, form, are_arrays
    leaves, form = jax.tree.flatten(state)
    are_arrays = _are_arrays(leaves)
    if not are_arrays:  # as `init` may give them
        leaves = [np.asarray(leaf) if isinstance(leaf, NUMBERS) else leaf for leaf in leaves]
        are_arrays = _are_arrays(leaves)
    # Of our own classes, which never change. What is kept of a state goes with it.
    if are_arrays and isinstance(state, eqx.Module) and type(state).__module__.startswith("gpcjax."):
        _last = weakref.ref(state, _forget), leaves, form, are_arrays
    return leaves, form, are_arrays


def _forget(gone: Any) -> None:
    global _last
    if _last[0] is gone:
        _last = lambda: None, [], None, True


_concrete: set[type] = {np.ndarray}
"""Types of arrays that hold numbers, as they are met: to ask jax of each array takes longer than the call."""


def _are_arrays(leaves: Sequence[Any]) -> bool:
    """Whether each is an array that holds numbers, of numpy's or of jax's."""
    for new in set(map(type, leaves)) - _concrete:
        if issubclass(new, Tracer) or not all(
            isinstance(leaf, jax.Array) for leaf in leaves if type(leaf) is new
        ):
            return False
        _concrete.add(new)
    # Bytes in the other order jax reads as if they were in its own, once it has compiled a program.
    return all(leaf.dtype.isnative for leaf in leaves if type(leaf) is np.ndarray)


def _can_be_given(leaves: Sequence[Any], others: Sequence[Any]) -> bool:
    """Whether each of these arrays is jax's, and is there once."""
    known = set(map(id, leaves))
    return (
        len(known) == len(leaves)
        and known.isdisjoint(map(id, others))
        and not any(isinstance(leaf, np.ndarray) for leaf in leaves)
    )
