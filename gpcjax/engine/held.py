"""What things hold that somebody may change: read before and after a call, and put back where the call changed it."""

import collections
import contextvars
import functools
import operator
import random
import types
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from gpcjax.engine.writes import Writes

RANDOM = (np.random.Generator, np.random.RandomState, random.Random)
MISSING = object()
"""In place of the value that a name has not."""


@dataclass
class Names:
    """Names that have values: of a module, of the functions around one, of an object."""

    thing: Any
    """Whose they are; kept, so that nothing else has its identity."""
    read: Callable[[], dict[str, Any]]
    write: Callable[[str, Any], Any]
    """With `MISSING` it takes the name away."""
    before: dict[str, Any]
    after: dict[str, Any]
    freely: bool
    """Code that was not looked at may give them values."""

    def changed(self, own: Writes) -> dict[str, bool]:
        """Those with another value than before, and whether the function itself has given it."""
        changed = [name for name in {**self.before, **self.after} if not same(*self._values(name))]
        return {
            name: self.freely or own.reaches(name) or is_traced(self._values(name)[1]) for name in changed
        }

    def put_back(self, own: Writes) -> None:
        """To what they were, where the function has changed them, and nobody since."""
        now = self.read()
        for name, is_own in self.changed(own).items():
            before, after = self._values(name)
            if is_own and same(now.get(name, MISSING), after):
                self.write(name, before)

    def _values(self, name: str) -> tuple[Any, Any]:
        return self.before.get(name, MISSING), self.after.get(name, MISSING)


@dataclass
class Content:
    """What a table, a list, an array or a generator of random numbers holds."""

    thing: Any
    read: Callable[[], Any]
    write: Callable[[Any], Any]
    before: Any
    after: Any

    def put_back(self, own: Writes) -> None:
        """To what it was; if somebody has changed it since, without what jax traces with."""
        now = self.read()
        if same(self.before, self.after):
            return
        if same(now, self.after) and (own.content or isinstance(self.thing, RANDOM) or is_traced(now)):
            self.write(self.before)
        elif isinstance(now, dict) and is_traced(now):
            kept = {
                name: self.before.get(name, MISSING) if is_traced(each) else each
                for name, each in now.items()
            }
            self.write({name: each for name, each in kept.items() if each is not MISSING})
        elif isinstance(now, list) and is_traced(now):
            self.write([each for each in now if not is_traced(each)])


def of_a_dict(
    values: dict[str, Any], names: tuple[str, ...] | None = None
) -> tuple[Callable[[], dict[str, Any]], Callable[[str, Any], Any]]:
    """How these names of a table of names are read and written; all of them without `names`."""

    def read() -> dict[str, Any]:
        if names is None:
            return dict(values)
        found = {name: values.get(name, MISSING) for name in names}
        return {name: value for name, value in found.items() if value is not MISSING}

    def write(name: str, value: Any) -> None:
        if value is MISSING:
            values.pop(name, None)
        else:
            values[name] = value

    return read, write


def of_cells(
    cells: dict[str, types.CellType],
) -> tuple[Callable[[], dict[str, Any]], Callable[[str, Any], Any]]:
    """The same of the variables of functions around one, by their names."""
    return (
        lambda: {name: cell_content(cell) for name, cell in cells.items()},
        lambda name, value: setattr(cells[name], "cell_contents", value),
    )


def of_content(thing: Any) -> tuple[Callable[[], Any], Callable[[Any], Any]] | None:
    """How what a table, a list, an array of objects or a generator holds is read and written; None of anything else."""
    if isinstance(thing, dict):
        return lambda: dict(thing), lambda content: (thing.clear(), thing.update(content))
    if isinstance(thing, list):
        return lambda: list(thing), lambda content: thing.__setitem__(slice(None), content)
    if isinstance(thing, collections.deque):
        return lambda: list(thing), lambda content: (thing.clear(), thing.extend(content))
    if isinstance(thing, set):
        return lambda: list(thing), lambda content: (thing.clear(), thing.update(content))
    if isinstance(thing, np.ndarray) and thing.dtype == object:
        return lambda: list(thing.flat), functools.partial(_put_into, thing)
    if isinstance(thing, np.random.Generator):
        return lambda: thing.bit_generator.state, lambda content: setattr(
            thing.bit_generator, "state", content
        )
    if isinstance(thing, np.random.RandomState):
        return lambda: thing.get_state(legacy=False), thing.set_state
    if isinstance(thing, random.Random) and not isinstance(thing, random.SystemRandom):
        return thing.getstate, thing.setstate
    return None


def of_a_context(
    variable: contextvars.ContextVar[Any],
) -> tuple[Callable[[], dict[str, Any]], Callable[[str, Any], Any]]:
    """The same of a variable of a context. It is not written: a function is traced in a context of its own."""

    def read() -> dict[str, Any]:
        value = variable.get(MISSING)
        return {} if value is MISSING else {"value": value}

    return read, lambda name, value: None


def _put_into(array: Any, content: list[Any]) -> None:
    for place, each in zip(np.ndindex(array.shape), content, strict=True):
        array[place] = each  # one by one: else an array among them would be spread over several


def cell_content(cell: types.CellType) -> Any:
    """What a variable of a function around one is now, None if nothing yet."""
    try:
        return cell.cell_contents
    except ValueError:
        return None


def same(one: Any, other: Any) -> bool:
    """Whether two contents refer to the same things, or to equal numbers, texts and arrays that were copied."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and _all_same(one.values(), other.values())
    if isinstance(one, list | tuple):
        return len(one) == len(other) and _all_same(one, other)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.tobytes() == other.tobytes()
    return isinstance(one, str | bytes | int | float | complex) and (one == other or one != one != other)


def _all_same(some: Iterable[Any], others: Iterable[Any]) -> bool:
    # Mostly they are the very same ones, which costs a hundredth of a look at each.
    return all(map(operator.is_, some, others)) or all(map(same, some, others))


def is_traced(value: Any) -> bool:
    """Whether jax traces with it, or with what it consists of."""
    try:
        return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))
    except Exception:  # jax cannot order the names of every table
        return False
