"""What a function's code uses and can change, as its instructions say: which names, and what these refer to."""

import dis
import functools
import types
from collections.abc import Iterator
from typing import Any, NamedTuple

_NAMES = frozenset(
    f"{how}_{what}" for how in ("STORE", "DELETE") for what in ("GLOBAL", "DEREF", "ATTR", "NAME")
)
_ANY_NAME = frozenset(
    "setattr delattr globals locals vars exec eval __dict__ __setattr__ __delattr__ __setstate__".split()
)
"""Names in code that can change any name, whatever its instructions say."""
_CONTENT = frozenset(
    "add append appendleft clear copyto discard extend extendleft fill heappop heappush heapreplace insert insort "
    "move_to_end partition pop popitem popleft put put_along_axis remove resize reverse rotate setdefault shuffle sort "
    "update".split()
)
"""Names of functions and methods that change what a list, a table or an array holds; so does an argument `out`, whose
name is among the constants of the code that gives it."""


class Writes(NamedTuple):
    """What some code may change."""

    names: frozenset[str] = frozenset()
    """Variables of modules and of functions around it, and attributes of whatever object."""
    content: bool = False
    """Entries of lists, tables and arrays."""
    imports: frozenset[str] = frozenset()
    """Modules that it imports itself."""

    def also(self, other: "Writes") -> "Writes":
        """What either may change."""
        return Writes(self.names | other.names, self.content or other.content, self.imports | other.imports)

    def reaches(self, name: str) -> bool:
        """Whether it may give this name another value."""
        return name in self.names or not _ANY_NAME.isdisjoint(self.names)


@functools.lru_cache(maxsize=4096)
def writes(code: types.CodeType) -> Writes:
    """Of a function, and of those that are written in it."""
    names: set[str] = set(_ANY_NAME.intersection(code.co_names))
    imports: set[str] = set()
    content = not _CONTENT.isdisjoint(code.co_names)
    for each in dis.get_instructions(code):
        if each.opname in _NAMES:
            names.add(str(each.argval))
        if each.opname == "IMPORT_NAME":
            imports.add(str(each.argval))
        in_place = each.opname == "BINARY_OP" and each.argrepr.endswith("=")
        content |= in_place or each.opname in ("STORE_SUBSCR", "DELETE_SUBSCR", "STORE_SLICE")
    content |= any("out" in constant for constant in code.co_consts if isinstance(constant, tuple))
    found = Writes(frozenset(names), content, frozenset(imports))
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            found = found.also(writes(constant))
    return found


def names_in(code: types.CodeType) -> Iterator[str]:
    """The global names that a function uses, and those of the functions in it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from names_in(constant)


def functions(value: Any) -> Iterator[types.FunctionType]:
    """Those that an attribute of a class is: a method, or what makes one of it."""
    if isinstance(value, types.FunctionType):
        yield value
    elif hasattr(type(value), "__get__"):
        for name in ("__func__", "fget", "fset", "func", "method"):
            yield from functions(getattr(value, name, None))
