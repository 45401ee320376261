"""Where a module is, found without importing it; and whether it was installed there. Loads no jax."""

import functools
import os
import pkgutil
import site
import sys
import sysconfig
from collections.abc import Iterable
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

_OF_INSTALLATIONS = frozenset(("site-packages", "dist-packages"))
"""Folders that nobody but an installation writes to, wherever they lie."""


class Finder:
    """Finds modules as an import would, and in the present folder: each of them once."""

    def __init__(self) -> None:
        self._known: dict[str, ModuleSpec | None] = {}
        here = os.getcwd()
        self._folders = [*(each or here for each in sys.path if isinstance(each, str)), here]

    def find(self, name: str) -> ModuleSpec | None:
        """Where a module is; None of what is none."""
        if name not in self._known:
            self._known[name] = self._found(name)
        return self._known[name]

    def _found(self, name: str) -> ModuleSpec | None:
        above, _, last = name.rpartition(".")
        if not last.isidentifier():
            return None
        folders = None
        if above:
            package = self.find(above)
            if package is None or package.submodule_search_locations is None:
                return None
            folders = list(package.submodule_search_locations)
        for finder in sys.meta_path:
            try:
                # The usual one asks for packages without __init__.py that those above them be imported.
                if finder is PathFinder:
                    spec = _in_folders(name, self._folders if folders is None else folders)
                else:  # built in, or as an installation leaves one that follows its source
                    spec = finder.find_spec(name, folders)
                if spec is not None and spec.submodule_search_locations is not None:
                    spec.submodule_search_locations = list(spec.submodule_search_locations)
            except Exception:  # somebody else's finder
                continue
            if spec is not None:
                return spec
        return None


def _in_folders(name: str, folders: Iterable[str]) -> ModuleSpec | None:
    """A module in one of these folders, or a package without `__init__.py` in some of them."""
    portions: list[str] = []
    for folder in folders:
        importer = pkgutil.get_importer(folder)
        spec = None if importer is None else importer.find_spec(name)
        if spec is not None and spec.loader is not None:
            return spec
        portions += (spec and spec.submodule_search_locations) or ()
    if not portions:
        return None
    spec = ModuleSpec(name, None, is_package=True)
    spec.submodule_search_locations = portions
    return spec


def file_of(spec: ModuleSpec | None) -> Path | None:
    """The file of a module; None where it has none."""
    origin = None if spec is None or not spec.has_location else spec.origin
    return None if origin is None else Path(origin)


def is_installed(name: str, file: Path, is_package: bool) -> bool:
    """Whether a module lies where installations put what they copy, or beside what tells of its distribution."""
    if any(file.is_relative_to(place) for place in _places()):
        return True
    if not _OF_INSTALLATIONS.isdisjoint(file.parts):
        return True
    above = name.count(".") + is_package
    if above >= len(file.parents):
        return False
    folder = file.parents[above]
    try:
        return name.partition(".")[0] in _belonging(folder, folder.stat().st_mtime_ns)
    except OSError:
        return False


@functools.cache
def _places() -> frozenset[str]:
    """Of this Python."""
    places = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    return frozenset(place for place in (*places, site.getusersitepackages()) if place)


@functools.lru_cache(maxsize=256)
def _belonging(folder: Path, changed: int) -> frozenset[str]:
    """Modules and packages in a folder, when it was last changed, that distributions there say to be theirs.

    An installation that follows its source leaves something beside that, too: `NAME.egg-info`, without a version.
    """
    found: set[str] = set()
    for told in (*folder.glob("*.dist-info"), *folder.glob("*-*.egg-info")):
        found.add(told.name.partition("-")[0])  # Debian leaves no list
        for file in ("RECORD", "top_level.txt"):
            try:
                lines = (told / file).read_text(encoding="utf-8", errors="replace").splitlines()
            except OSError:
                continue
            found |= {line.partition(",")[0].partition("/")[0].partition(".")[0].strip() for line in lines}
    return frozenset(found)
