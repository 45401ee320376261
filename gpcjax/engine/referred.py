"""What a person's function refers to: found from one thing to the next, with how each is read and written.

`gpcjax.engine.remembered` compares it with what a call has left.
"""

import collections
import contextlib
import contextvars
import functools
import inspect
import io
import itertools
import random
import sys
import types
import weakref
from collections.abc import Callable, Iterable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from gpcjax.engine.held import (
    MISSING,
    RANDOM,
    Content,
    Names,
    cell_content,
    of_a_context,
    of_a_dict,
    of_cells,
    of_content,
)
from gpcjax.engine.whose import BARE, is_a_persons, is_library, is_own, modules_of, top_of
from gpcjax.engine.writes import Writes, functions, names_in, writes

MOST, LARGEST = 10_000, 2**26
"""Things that are looked at, beside numbers and texts, and bytes of arrays, lists and tables that are copied: what lies
beyond may change unseen."""

_PLAIN = frozenset((str, bytes, bool, int, float, complex, type(None)))
"""Types of what refers to nothing: a long list of it costs no look at each."""
_BOUND = (types.BuiltinMethodType, types.MethodWrapperType)
_MADE_WITH = frozenset(("__new__", "__init__", "__post_init__", "__init_subclass__", "__setstate__"))
"""Methods that write into what is being made."""


class Referred:
    """All that a function refers to, as it is when this is made.

    Looked at are variables of the functions around it, global names that it uses, those of a person's modules and
    classes too, attributes of objects, entries of tables, lists and arrays, variables of the context, and generators of
    random numbers, with that of a module `random` or `numpy` that it names; in these, what they refer to in turn, also
    weakly. Clocks and queues are not.
    """

    def __init__(self, function: Any):
        self.names: list[Names] = []
        self.contents: list[Content] = []
        self.writes = Writes()
        """What the code of all functions among it may change."""
        self._bytes = 0
        self._classes: set[int] = set()
        self._used: set[str] = set()
        self._methods: dict[str, list[types.FunctionType]] = collections.defaultdict(list)
        """By their names, those that no code seen so far uses."""
        self.uses_up = False
        """An iterator or a file is among it: what was read from these once cannot be put back."""
        self.tracers: dict[int, Any] = {}
        """What jax traces with among it, by identity."""
        seen: set[int] = set()
        waiting = collections.deque([function])
        while waiting and len(seen) < MOST:
            thing = waiting.popleft()
            if id(thing) in seen:
                continue
            # Errors are of what refuses to be looked at, as a proxy of what is gone.
            with contextlib.suppress(Exception):
                if isinstance(thing, jax.Array):
                    self.tracers |= {id(thing): thing} if isinstance(thing, Tracer) else {}
                    continue
                seen.add(id(thing))
                further = (part for part in self._look_at(thing) if type(part) not in _PLAIN)
                waiting.extend(itertools.islice(further, MOST))

    def _look_at(self, thing: Any) -> Iterable[Any]:
        """Keeps what a thing holds, and gives what that refers to."""
        self.uses_up |= _is_used_up(thing)
        if isinstance(thing, types.FunctionType):
            return self._of_a_function(thing)
        if isinstance(thing, types.MethodType):
            return thing.__self__, thing.__func__
        if isinstance(thing, _BOUND):  # such as random.random
            return () if isinstance(thing.__self__, types.ModuleType) else (thing.__self__,)
        if isinstance(thing, types.ModuleType):
            return ()
        if isinstance(thing, functools.partial):
            return thing.func, *thing.args, *thing.keywords.values()
        if isinstance(thing, tuple | frozenset):
            return _parts(thing)
        if isinstance(thing, weakref.ref):
            return (thing(),)
        if type(thing) in weakref.ProxyTypes:
            return (thing.__repr__.__self__,)  # what it stands for: of all else it has that one's
        if isinstance(thing, contextvars.ContextVar):
            self._keep(thing, *of_a_context(thing), freely=True)
            return (thing.get(None),)
        if isinstance(thing, np.ndarray) and thing.dtype != object:
            return self._of_an_array(thing)
        if isinstance(thing, type):
            return [
                part for each in thing.__mro__ if is_own(each.__module__) for part in self._of_a_class(each)
            ]
        how = of_content(thing)
        if how is not None:
            if not self._has_place(sys.getsizeof(thing)):
                return ()
            content = how[0]()
            self.contents.append(Content(thing, *how, content, content))
            return () if isinstance(thing, RANDOM) else _parts(content)
        if is_library(type(thing).__module__):
            return (getattr(thing, "__wrapped__", None),)
        return self._of_an_object(thing)

    def _of_a_function(self, function: types.FunctionType) -> Iterable[Any]:
        if is_library(function.__module__):
            return ()
        self.writes = self.writes.also(writes(function.__code__))
        names, around = tuple(dict.fromkeys(names_in(function.__code__))), function.__globals__
        cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        self._used.update(names)
        self._keep(function, *of_a_dict(around, names))
        self._keep(function, *of_cells(cells))
        own = [*(around.get(name) for name in names), *(cell_content(cell) for cell in cells.values())]
        # And modules that the function itself imports.
        own += [sys.modules[name] for name in writes(function.__code__).imports if name in sys.modules]
        return (
            *own,
            *(each for module in own for each in _generators(module, names)),
            *self._of_methods(*names),
            *(part for module in own if is_a_persons(module) for part in self._of_a_module(module, names)),
            *(function.__defaults__ or ()),
            *(function.__kwdefaults__ or {}).values(),
            *self._attributes(function),
        )

    def _of_a_module(self, module: types.ModuleType, names: tuple[str, ...]) -> Iterable[Any]:
        """What code with these names may use of a person's module."""
        self._keep(module, *of_a_dict(vars(module), names))
        used = [vars(module).get(name) for name in names]
        # Of a package, too, one of whose modules it is.
        below = (
            each for each in used if is_a_persons(each) and each.__name__.startswith(module.__name__ + ".")
        )
        return *used, *(part for each in below for part in self._of_a_module(each, names))

    def _of_a_class(self, kind: type) -> Iterable[Any]:
        """What all objects of a class have in common, and its methods."""
        if id(kind) in self._classes:
            return ()
        self._classes.add(id(kind))
        read = lambda: {name: value for name, value in dict(vars(kind)).items() if _is_data(name, value)}  # noqa: E731

        def write(name: str, value: Any) -> None:
            type.__delattr__(kind, name) if value is MISSING else type.__setattr__(kind, name, value)

        self._keep(kind, read, write, freely=not is_own(kind.__module__))
        if not is_own(kind.__module__):
            return ()
        methods = [(name, each) for name, value in dict(vars(kind)).items() for each in functions(value)]
        for name, method in methods:
            if name not in _MADE_WITH:
                self._methods[name].append(method)
        # What is installed may call whatever method of a class that is made from its own.
        inherits = any(not is_own(each) and each not in BARE for each in modules_of(kind))
        special = [name for name, _ in methods if inherits or name.startswith("__")]
        return *read().values(), *self._of_methods(*special, *self._used)

    def _of_methods(self, *names: str) -> list[types.FunctionType]:
        """Methods of classes seen so far that are used by one of these names."""
        if "getattr" in self._used:
            names = tuple(self._methods)
        return [method for name in names for method in self._methods.pop(name, ())]

    def _of_an_array(self, array: Any) -> Iterable[Any]:
        if array.flags.writeable and self._has_place(array.nbytes):
            copied = array.copy()
            self.contents.append(
                Content(array, array.copy, functools.partial(np.copyto, array), copied, copied)
            )
        return ()

    def _has_place(self, size: int) -> bool:
        """Whether so many bytes are copied, too: they are counted then."""
        fits = self._bytes + size <= LARGEST
        self._bytes += size if fits else 0
        return fits

    def _of_an_object(self, thing: Any) -> Iterable[Any]:
        """An object of somebody's class: what it holds, and what all of its class have in common."""
        kind, parts = type(thing), []
        # Of what code that is installed writes into its objects nothing is known.
        others = [each for each in modules_of(kind) if not (is_own(each) or is_library(each) or each in BARE)]
        if not all(top_of(each) in sys.stdlib_module_names for each in others):
            self.writes = self.writes.also(Writes(content=True))
        for each in kind.__mro__:
            if not is_library(each.__module__):
                parts += self._of_a_class(each)
                # By their names as they are kept: one that begins with __ has its class's before it.
                slots = {
                    name: value for name, value in vars(each).items() if inspect.ismemberdescriptor(value)
                }
                parts += self._slots(thing, slots, freely=bool(others))
        return *parts, *self._attributes(thing, freely=bool(others))

    def _slots(self, thing: Any, slots: dict[str, Any], freely: bool) -> Iterable[Any]:
        def read() -> dict[str, Any]:
            found = {}
            for name, slot in slots.items():
                with contextlib.suppress(AttributeError):  # nothing there yet
                    found[name] = slot.__get__(thing)
            return found

        def write(name: str, value: Any) -> None:
            object.__delattr__(thing, name) if value is MISSING else object.__setattr__(thing, name, value)

        if slots:
            self._keep(thing, read, write, freely)
        return read().values()

    def _attributes(self, thing: Any, freely: bool = False) -> Iterable[Any]:
        own = getattr(thing, "__dict__", None)
        if not isinstance(own, dict):
            return ()
        self._keep(thing, *of_a_dict(own), freely=freely)
        return list(own.values())

    def _keep(
        self,
        thing: Any,
        read: Callable[[], dict[str, Any]],
        write: Callable[[str, Any], Any],
        freely: bool = False,
    ) -> None:
        now = read()
        self.names.append(Names(thing, read, write, now, now, freely))


def _generators(module: Any, names: tuple[str, ...]) -> tuple[Any, ...]:
    """The generator that a module has for everybody, if code with these names may use it."""
    if module is random:
        return (random._inst,)  # pyright: ignore[reportAttributeAccessIssue]
    drawn = module is np.random or (module is np and "random" in names)
    return (np.random.mtrand._rand,) if drawn else ()


def _parts(content: Any) -> Iterable[Any]:
    """What a table, a list or a tuple refers to; nothing if that refers to nothing further."""
    parts = content.values() if isinstance(content, dict) else content
    return () if _PLAIN.issuperset(map(type, parts)) else parts


def _is_used_up(thing: Any) -> bool:
    """Whether it is an iterator, or a file that can be read."""
    if isinstance(thing, io.IOBase):
        return not thing.closed and thing.readable()
    return hasattr(type(thing), "__next__")


def _is_data(name: str, value: Any) -> bool:
    """Whether an attribute of a class is somebody's data, and no method of it."""
    return not (name.startswith("__") or hasattr(type(value), "__get__"))
