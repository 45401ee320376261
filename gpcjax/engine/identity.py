"""What a program is, told without tracing it: a digest of everything that it depends on.

Tracing and lowering a program takes as long as running it for a million steps, and tells no more than its inputs do:
the source of this package, the versions of what it is built on, the objects that are compiled in by value, and the
shapes of those that are its arguments. Only what is known all through is told. An object of somebody else's class, or
a function of theirs, may change without a trace: `digest` refuses it, and the program is traced as ever.
"""

import enum
import functools
import hashlib
import importlib.metadata
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from gpcjax.policies.policy import Policy

OURS = "gpcjax"
KNOWN = frozenset(
    {OURS, "builtins", "collections", "functools", "types", "numpy", "jax", "jaxlib", "equinox"}
)
"""Packages whose classes and functions are what their version says."""

CHECKING = frozenset({"jaxtyping", "beartype"})
"""What wraps a function in checks of its types, and computes nothing else."""

BUILT_ON = ("jax", "jaxlib", "equinox", "numpy", "jaxtyping")


@runtime_checkable
class Keeper(Protocol):
    """Where compiled programs are kept from one process to the next, by their digests."""

    def find(self, key: str) -> Callable[..., Any] | None:
        """The program of this digest, ready to be called; None if there is none."""
        ...

    def compiled(self, key: str, lowered: Any, leaves: int, given: int, others: int) -> Callable[..., Any]:
        """Compiles and keeps a program of lists of so many leaves and arguments; it gives lists of leaves and others.

        Another source may have lowered to the same text: then that program is found once more.
        """
        ...


class Unknown(Exception):
    """Something that a digest cannot vouch for."""


def digest(compiled_in: Any, arguments: Any) -> str:
    """The same for the same program, of this source and these versions: hexadecimal digits.

    Args:
        compiled_in: objects whose values are part of the program.
        arguments: objects of which the program depends on all but the values of their arrays.

    Raises:
        Unknown: an object whose code is not known.
    """
    told = hashlib.sha256(_ground().encode())
    for line in (*_lines(compiled_in, values=True), "|", *_lines(arguments, values=False)):
        told.update(line.encode() + b"\n")
    return told.hexdigest()[:32]


@functools.cache
def _ground() -> str:
    """What every program depends on: this package's source, word by word, versions, and what XLA is told.

    The last decides how some are written (`gpcjax.gp.tiled.is_fast`), too.
    """
    source = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        source.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    versions = [importlib.metadata.version(name) for name in BUILT_ON]
    return " ".join([source.hexdigest(), sys.version, *versions, os.environ.get("XLA_FLAGS", "")])


def _lines(thing: Any, values: bool, inside: tuple[int, ...] = ()) -> Iterator[str]:
    """Tells all of an object, depth first."""
    if id(thing) in inside:
        raise Unknown("an object within itself")
    inside = (*inside, id(thing))
    match thing:
        case None | bool() | str() | bytes():
            yield repr(thing)
        case enum.Enum():
            yield f"{_name_of(type(thing))}.{thing.name}"
        case int() | float() | complex():
            yield f"{type(thing).__name__} {thing!r}"
        case Policy():
            yield "policy"
            yield from _lines(thing.controller, values, inside)
        case np.dtype():
            yield f"dtype {thing.str}"
        case np.ndarray() | np.generic() | jax.Array() | jax.ShapeDtypeStruct():
            yield from _array(thing, values)
        case type():
            yield _name_of(thing)
        case MethodType():
            yield "method"
            yield from _all([thing.__func__, thing.__self__], values, inside)
        case functools.partial():
            yield "partial"
            yield from _all([thing.func, thing.args, thing.keywords], values, inside)
        case FunctionType():
            yield from _function(thing, inside)
        case tuple() | list():
            yield f"{_name_of(type(thing))} {len(thing)}"
            yield from _all(thing, values, inside)
        case Mapping():
            yield f"{_name_of(type(thing))} {len(thing)}"
            yield from _all(thing.items(), values, inside)
        case _ if callable(getattr(thing, "__wrapped__", None)):  # compiled, and so on
            yield f"wrapped {_name_of(type(thing))}"
            yield from _lines(thing.__wrapped__, values, inside)
        case _:
            name = _name_of(type(thing))
            if not hasattr(thing, "__dict__"):
                raise Unknown(f"{name}, which keeps to itself what it holds")
            yield f"{name} {len(vars(thing))}"
            for field, value in sorted(vars(thing).items()):
                yield field
                # What a module declares static is compiled in, whatever the rest of it is.
                yield from _lines(value, values or _is_static(type(thing), field), inside)


def _all(things: Iterable[Any], values: bool, inside: tuple[int, ...]) -> Iterator[str]:
    for thing in things:
        yield from _lines(thing, values, inside)


def _array(array: Any, values: bool) -> Iterator[str]:
    if array.dtype == object:
        raise Unknown("an array of objects")
    yield f"array {array.dtype} {array.shape} {getattr(array, 'weak_type', False)}"
    if values:
        if isinstance(array, jax.ShapeDtypeStruct | Tracer):
            raise Unknown("an array without values")
        if isinstance(array, jax.Array) and jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
            array = jax.random.key_data(array)
        yield hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()


def _function(function: FunctionType, inside: tuple[int, ...]) -> Iterator[str]:
    """Where it is written, and what it has taken from there."""
    # A wrapper bears the name of what it wraps; whose code it is, its globals tell.
    package = str(function.__globals__.get("__name__")).partition(".")[0]
    wrapped = getattr(function, "__wrapped__", None)
    if package in CHECKING and wrapped is not None:
        yield from _lines(wrapped, True, inside)
        return
    if package not in KNOWN:
        raise Unknown(f"{function.__qualname__} of {package}, which is not of {OURS}")
    code = function.__code__
    yield f"function {_name_of(function)} {code.co_firstlineno} {code.co_code.hex()}"
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    yield from _all([cells, function.__defaults__, function.__kwdefaults__], True, inside)


def _name_of(written: Any) -> str:
    module = written.__module__
    if module.partition(".")[0] not in KNOWN:
        raise Unknown(f"{module}.{written.__qualname__}, which is not of {OURS}")
    return f"{module}.{written.__qualname__}"


@functools.cache
def _is_static(kind: type, field: str) -> bool:
    declared = getattr(kind, "__dataclass_fields__", {}).get(field)
    return declared is not None and bool(declared.metadata.get("static", False))
