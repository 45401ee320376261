"""What a module that is not ours is, told by its source and by that of what it imports. Loads no jax, imports nothing.

The digest is that of the syntax: comments, layout and docstrings are no part of it. Followed are the imports that its
source names, wherever they stand, and texts as "module:attribute", by which descriptions name what makes a thing. What
is installed is followed only where the module that was asked for is of the same package. Files of data that a module
reads are not known.
"""

import ast
import hashlib
import importlib.machinery
import os
import re
import site
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path

_OURS = __name__.partition(".")[0]

_TARGET = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*):[A-Za-z_][\w.]*")

_IMPORTING = ("import_module", "__import__")
"""Functions that import what a text names."""


def digests_of_modules(names: Iterable[str]) -> dict[str, str]:
    """Twelve hex digits for each of these modules, and for each that they import, by its name.

    Of a name that is no module that Python finds there is none.
    """
    names = list(names)
    tops = {name.partition(".")[0] for name in names}
    found: dict[str, str] = {}
    seen, left = set[str](), names
    while left:
        name = left.pop()
        if name in seen:
            continue
        seen.add(name)
        top, _, below = name.rpartition(".")
        left += [top] if below and top else []  # a package is imported before what is in it
        spec = _spec_of(name)
        file = _file_of(spec)
        if file is None or (_is_installed(file) and name.partition(".")[0] not in tops):
            continue
        content = _content(file)
        if content is None:
            continue
        told, tree = content
        found[name] = told
        package = name if spec is not None and spec.submodule_search_locations is not None else top
        left += [] if tree is None else _imported(tree, package)
    return dict(sorted(found.items()))


def _content(file: Path) -> tuple[str, ast.Module | None] | None:
    """The digest of a file, and its syntax, if it is one of Python's; None if it cannot be read."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    tree = None
    if file.suffix == ".py":
        try:
            tree = ast.parse(data)
            keeps = b"__doc__" in data  # somebody computes with its docstrings
            data = ast.dump(tree if keeps else _without_docstrings(ast.parse(data))).encode()
        except (SyntaxError, ValueError, RecursionError):
            tree = None
    return hashlib.sha256(data).hexdigest()[:12], tree


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            match node.body:
                case [ast.Expr(ast.Constant(str())), *rest]:
                    node.body = rest
    return tree


def _imported(tree: ast.Module, package: str) -> Iterator[str]:
    """Full names of what a module of a package imports; some are no modules, but names within one."""
    for node in ast.walk(tree):
        match node:
            case ast.Import():
                yield from (alias.name for alias in node.names)
            case ast.ImportFrom():
                parents = package.split(".")[: -(node.level - 1) or None] if node.level else []
                base = ".".join([*filter(None, parents), *([node.module] if node.module else [])])
                if base:
                    yield base
                    yield from (f"{base}.{alias.name}" for alias in node.names if alias.name != "*")
            case ast.Call(func=function, args=[ast.Constant(str() as text), *_]) if (
                getattr(function, "attr", getattr(function, "id", "")) in _IMPORTING
            ):
                yield text.lstrip(".")
            case ast.Constant(str() as text) if target := _TARGET.fullmatch(text):
                yield target[1]


def _spec_of(name: str) -> ModuleSpec | None:
    """Where a module is, found without importing it, or anything."""
    parts = name.split(".")
    if not all(part.isidentifier() for part in parts) or parts[0] == _OURS:
        return None
    spec, folders = None, [*(each or os.getcwd() for each in sys.path), os.getcwd()]
    for place in range(len(parts)):
        full = ".".join(parts[: place + 1])
        spec = importlib.machinery.PathFinder.find_spec(full, folders)
        if spec is None:  # by another finder, as an installation leaves that follows its source
            spec = getattr(sys.modules.get(full), "__spec__", None)
        if spec is None:
            return None
        folders = list(spec.submodule_search_locations or ())
    return spec


def _file_of(spec: ModuleSpec | None) -> Path | None:
    origin = None if spec is None or not spec.has_location else spec.origin
    return None if origin is None else Path(origin)


def _is_installed(file: Path) -> bool:
    """Whether it lies where installations put what they copy."""
    places = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    places.add(site.getusersitepackages())
    return any(file.is_relative_to(place) for place in places if place)
