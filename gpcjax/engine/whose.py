"""Whose code something is: a person's own, what was installed, or a library that is known."""

import functools
import sys
import types
from pathlib import Path
from typing import Any, TypeGuard

_LIBRARIES = frozenset(("builtins", "jax", "jaxlib", "numpy", "equinox", "gpcjax", "jaxtyping"))
BARE = frozenset(("builtins", "abc", "argparse", "enum", "types", "typing"))
"""Modules whose classes call and write nothing of those that are made from them."""


def is_library(module: str | None) -> bool:
    """Whether a module is of those that are known: what these hold is not looked at."""
    return top_of(module or "") in _LIBRARIES


def top_of(module: str) -> str:
    """The package that a module is in, or the module itself."""
    return module.partition(".")[0]


@functools.lru_cache(maxsize=1024)
def is_own(module: str) -> bool:
    """Whether a module is a person's own, and was not installed."""
    if is_library(module) or top_of(module) in sys.stdlib_module_names:
        return False
    path = str(getattr(sys.modules.get(module), "__file__", None) or "")
    return not {"site-packages", "dist-packages"}.intersection(Path(path).parts)


def modules_of(kind: type) -> list[str]:
    """Those of a class and of all that it is made from."""
    return [each.__module__ for each in kind.__mro__]


def is_a_persons(thing: Any) -> TypeGuard[types.ModuleType]:
    """Whether something is a module of a person's own."""
    return isinstance(thing, types.ModuleType) and is_own(thing.__name__)
