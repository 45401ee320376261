"""What jax is told when it is imported only after a policy was loaded without it.

Whoever loads a policy and imports jax later finds both as if gpcjax had loaded jax at once: float64 is on
(`gpcjax._x64`), and policies are pytrees (`gpcjax.policies.pytree`).
"""

import importlib
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_OURS = "gpcjax.policies.pytree"
"""What tells jax all that it must know of policies."""


def jax_is_coming() -> None:
    """Has jax told of policies: now if it is there, otherwise as soon as anybody imports it."""
    if "jax" in sys.modules:
        if _OURS not in sys.modules:
            importlib.import_module(_OURS)
    elif not any(isinstance(finder, _Waiting) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Waiting())


class _Waiting(MetaPathFinder):
    """Finds jax where the others do, and stays until it is executed: who only asks where it is, imports nothing."""

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> Any:
        if fullname != "jax":
            return None
        others = (finder for finder in tuple(sys.meta_path) if finder is not self)
        found = (finder.find_spec(fullname, path, target) for finder in others)
        spec: ModuleSpec | None = next(filter(None, found), None)
        if spec is not None and spec.loader is not None:
            spec.loader = _Telling(spec.loader)
        return spec


class _Telling(Loader):
    """Loads jax as the loader that was found does, and tells it of policies then."""

    def __init__(self, found: Loader):
        self._found = found

    def __getattr__(self, name: str) -> Any:
        return getattr(self._found, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._found.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        sys.meta_path[:] = [finder for finder in sys.meta_path if not isinstance(finder, _Waiting)]
        module.__loader__ = self._found
        if module.__spec__ is not None:
            module.__spec__.loader = self._found
        self._found.exec_module(module)
        importlib.import_module(_OURS)
