"""Functions that can be compiled before they are called."""

import threading
from collections.abc import Callable
from typing import Any

import jax


class Ahead:
    """A function of lists of arrays, compiled for the shapes that it is given: when it is called, or before.

    With `donate`, its first argument is given away.
    """

    def __init__(self, function: Callable[..., Any], donate: bool = False):
        self._jitted = jax.jit(function, donate_argnums=0 if donate else ())
        self._compiled: dict[Any, Callable[..., Any]] = {}
        self._lock = threading.Lock()

    def compile(self, *arguments: Any) -> Callable[..., Any]:
        """For the shapes of these; what was compiled already is not again."""
        key = tuple(leaf.shape for leaf in jax.tree.leaves(arguments))
        with self._lock:
            if key not in self._compiled:
                self._compiled[key] = self._jitted.lower(*arguments).compile()
            return self._compiled[key]

    def __call__(self, *arguments: Any) -> Any:
        key = tuple(leaf.shape for leaf in jax.tree.leaves(arguments))
        return (self._compiled.get(key) or self.compile(*arguments))(*arguments)
