"""What a person's function refers to and can change: looked at before a call, compared after it, and put back.

A function that jax traces runs once, for all steps of a program. What it changes then, a counter, a filter's last
value, numbers still to be drawn, would be changed once, and hold what jax traces with.
"""

import collections
import functools
import random
import types
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer

MOST, LARGEST = 10_000, 2**26
"""Things that are looked at, and bytes of numpy's arrays that are copied: what lies beyond may change unseen."""

_LIBRARIES = frozenset(("builtins", "jax", "jaxlib", "numpy", "equinox", "gpcjax", "jaxtyping"))
_PLAIN = (str, bytes, int, float, complex, type(None), jax.Array)
_RANDOM = (np.random.Generator, np.random.RandomState, random.Random)
_MISSING = object()


class _Held(NamedTuple):
    """What one thing holds."""

    thing: Any
    """Kept, so that nothing else has its identity."""
    read: Callable[[], Any]
    write: Callable[[Any], Any]
    content: Any


class Remembered:
    """All that a function refers to, as it was when this was made.

    Looked at are variables of the functions around it, global names that it uses, attributes of objects, entries of
    tables, lists and arrays, and generators of random numbers, with that of a module `random` or `numpy` that it
    names; in these, what they refer to in turn. Iterators, files and clocks are not.
    """

    def __init__(self, function: Any):
        self._held: list[_Held] = []
        self._bytes = 0
        self.tracers: dict[int, Any] = {}
        """What jax traces with among it, by identity."""
        seen: set[int] = set()
        waiting = collections.deque([function])
        while waiting and len(seen) < MOST:
            thing = waiting.popleft()
            if isinstance(thing, Tracer):
                self.tracers[id(thing)] = thing
            if id(thing) in seen or isinstance(thing, _PLAIN):
                continue
            seen.add(id(thing))
            waiting.extend(self._look_at(thing))

    @property
    def is_changed(self) -> bool:
        """Whether anything is another thing now than it was."""
        return any(not _same(held.content, held.read()) for held in self._held)

    def put_back(self) -> None:
        """Makes everything what it was."""
        for held in self._held:
            if not _same(held.content, held.read()):
                held.write(held.content)

    def _look_at(self, thing: Any) -> Iterable[Any]:
        """Keeps what a thing holds, and gives what that refers to."""
        if isinstance(thing, types.FunctionType):
            return self._of_a_function(thing)
        if isinstance(thing, types.MethodType):
            return thing.__self__, thing.__func__
        if isinstance(thing, types.BuiltinMethodType):  # such as random.random
            return () if isinstance(thing.__self__, types.ModuleType) else (thing.__self__,)
        if isinstance(thing, types.ModuleType):
            return _generators(thing)
        if isinstance(thing, functools.partial):
            return thing.func, *thing.args, *thing.keywords.values()
        if isinstance(thing, tuple | frozenset):
            return thing
        if isinstance(thing, np.ndarray):
            return self._of_an_array(thing)
        how = _how(thing)
        if how is not None:
            content = how[0]()
            self._held.append(_Held(thing, *how, content))
            return () if isinstance(thing, _RANDOM) else _parts(content)
        if isinstance(thing, type) or _library(type(thing).__module__):
            return ()
        return self._of_an_object(thing)

    def _of_a_function(self, function: types.FunctionType) -> Iterable[Any]:
        if _library(function.__module__):
            return ()
        self._keep_names(function, function.__globals__, tuple(_names(function.__code__)))
        return (
            *(function.__closure__ or ()),
            *(function.__globals__.get(name) for name in _names(function.__code__)),
            *(function.__defaults__ or ()),
            *(function.__kwdefaults__ or {}).values(),
            vars(function),
        )

    def _of_an_array(self, array: Any) -> Iterable[Any]:
        if array.flags.writeable and self._bytes + array.nbytes <= LARGEST and array.dtype != object:
            self._bytes += array.nbytes
            self._held.append(_Held(array, array.copy, functools.partial(np.copyto, array), array.copy()))
        return ()

    def _of_an_object(self, thing: Any) -> Iterable[Any]:
        """An object of somebody's class: what it holds, and what all of its class have in common."""
        kind, parts = type(thing), []
        for each in kind.__mro__:
            if not _library(each.__module__):
                own = [name for name, value in vars(each).items() if _is_data(name, value)]
                self._keep_attributes(each, tuple(own), setattr)
                parts += [vars(each)[name] for name in own]
                slots = vars(each).get("__slots__", ())
                slots = (slots,) if isinstance(slots, str) else tuple(slots)
                self._keep_attributes(thing, slots, object.__setattr__)
                parts += [getattr(thing, name, None) for name in slots]
        return *parts, getattr(thing, "__dict__", None)

    def _keep_names(self, owner: Any, names: dict[str, Any], which: tuple[str, ...]) -> None:
        read = lambda: {name: names.get(name, _MISSING) for name in which}  # noqa: E731

        def write(content: dict[str, Any]) -> None:
            for name, value in content.items():
                if value is _MISSING:
                    names.pop(name, None)
                else:
                    names[name] = value

        self._held.append(_Held(owner, read, write, read()))

    def _keep_attributes(self, thing: Any, names: tuple[str, ...], set_: Callable[..., Any]) -> None:
        read = lambda: {name: getattr(thing, name, _MISSING) for name in names}  # noqa: E731

        def write(content: dict[str, Any]) -> None:
            for name, value in content.items():
                if value is not _MISSING:
                    set_(thing, name, value)

        if names:
            self._held.append(_Held(thing, read, write, read()))


def _how(thing: Any) -> tuple[Callable[[], Any], Callable[[Any], Any]] | None:
    """How what it holds is read and written; None where that is its attributes."""
    if isinstance(thing, types.CellType):
        return lambda: [_cell(thing)], lambda content: setattr(thing, "cell_contents", content[0])
    if isinstance(thing, dict):
        return lambda: dict(thing), lambda content: (thing.clear(), thing.update(content))
    if isinstance(thing, list):
        return lambda: list(thing), lambda content: thing.__setitem__(slice(None), content)
    if isinstance(thing, collections.deque):
        return lambda: list(thing), lambda content: (thing.clear(), thing.extend(content))
    if isinstance(thing, set):
        return lambda: list(thing), lambda content: (thing.clear(), thing.update(content))
    if isinstance(thing, np.random.Generator):
        return lambda: thing.bit_generator.state, lambda content: setattr(
            thing.bit_generator, "state", content
        )
    if isinstance(thing, np.random.RandomState):
        return lambda: thing.get_state(legacy=False), thing.set_state
    if isinstance(thing, random.Random) and not isinstance(thing, random.SystemRandom):
        return thing.getstate, thing.setstate
    return None


def _generators(module: types.ModuleType) -> tuple[Any, ...]:
    """The generator that a module of random numbers has for everybody."""
    if module is random:
        return (random._inst,)  # pyright: ignore[reportAttributeAccessIssue]
    return (np.random.mtrand._rand,) if module in (np, np.random) else ()


def _cell(cell: types.CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # a variable that has no value yet
        return None


def _parts(content: Any) -> Iterator[Any]:
    return iter(content.values() if isinstance(content, dict) else content)


def _same(one: Any, other: Any) -> bool:
    """Whether two contents refer to the same things, or to equal numbers, texts and arrays that were copied."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(_same(one[name], other[name]) for name in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.tobytes() == other.tobytes()
    return isinstance(one, str | bytes | int | float | complex) and (one == other or one != one != other)


def _names(code: types.CodeType) -> Iterator[str]:
    """The global names that a function uses, and those of the functions in it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _library(module: str | None) -> bool:
    return (module or "").partition(".")[0] in _LIBRARIES


def _is_data(name: str, value: Any) -> bool:
    """Whether an attribute of a class is somebody's data, and no method of it."""
    return not (name.startswith("__") or callable(value) or hasattr(value, "__get__"))
