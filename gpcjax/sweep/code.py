"""What a module that is not ours is, told by its source and by that of what it imports. Loads no jax, imports nothing.

The digest is that of the syntax: comments, layout and docstrings are no part of it. Followed are the imports that its
source names, wherever they stand, and texts as "module:attribute", by which descriptions name what makes a thing. What
is installed is followed only where the module that was asked for is of the same package. Files of data that a module
reads are not known.
"""

import ast
import hashlib
import re
import warnings
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from gpcjax.sweep.located import Finder, file_of, is_installed

_OURS = __name__.partition(".")[0]

_TARGET = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*):[A-Za-z_][\w.]*")

_IMPORTING = ("import_module", "__import__")
"""Functions that import what a text names."""

_KNOWN: dict[tuple[bytes, str], tuple[str, tuple[str, ...]]] = {}
"""By the SHA-256 of a source and the package that it is in: its digest, and what it imports. Each is parsed once."""


def digests_of_modules(names: Iterable[str], versioned: Collection[str] = ()) -> dict[str, str]:
    """Twelve hex digits for each of these modules, and for each that they import, by its name.

    Of a name that is no module that Python finds there is none. Nor of what is installed of the packages `versioned`,
    which are told by their versions elsewhere.
    """
    names = list(names)
    tops = {name.partition(".")[0] for name in names}.difference(versioned)
    found: dict[str, str] = {}
    finder, seen, left = Finder(), {""}, names
    while left:
        name = left.pop()
        if name in seen or name.partition(".")[0] == _OURS:
            continue
        seen.add(name)
        above = name.rpartition(".")[0]
        left.append(above)  # a package is imported before what is in it
        spec = finder.find(name)
        file = file_of(spec)
        if spec is None or file is None:
            continue
        is_package = spec.submodule_search_locations is not None
        if name.partition(".")[0] not in tops and is_installed(name, file, is_package):
            continue
        told = _told_of(file, name if is_package else above)
        if told is not None:
            found[name], imported = told
            left += imported
    return dict(sorted(found.items()))


def _told_of(file: Path, package: str) -> tuple[str, tuple[str, ...]] | None:
    """The digest of a file in a package, and what it imports; None if it cannot be read."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    whole = hashlib.sha256(data)
    if file.suffix != ".py":
        return whole.hexdigest()[:12], ()
    key = whole.digest(), package
    if key not in _KNOWN:
        _KNOWN[key] = _parsed(data, package) or (whole.hexdigest()[:12], ())
    return _KNOWN[key]


def _parsed(data: bytes, package: str) -> tuple[str, tuple[str, ...]] | None:
    """The digest of a source, and what it imports; None if it is none of Python's."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # as those of "\d", which are whoever's that imports it
            tree = ast.parse(data)
        imported = tuple(dict.fromkeys(_imported(tree, package)))
        # Where somebody computes with docstrings they count.
        kept = tree if b"__doc__" in data else _without_docstrings(tree)
        text = "\n".join(_flat(kept))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:12], imported


def _flat(tree: ast.AST) -> Iterator[str]:
    """The syntax in the order of its text, a line for each of its entries, however deep it is.

    `ast.dump` goes no deeper than what is left of Python's stack, which depends on who calls.
    """
    left: list[object] = [tree]
    while left:
        match left.pop():
            case ast.AST() as node:
                yield type(node).__name__
                left += [getattr(node, name, None) for name in reversed(node._fields)]
            case list() as nodes:
                yield f"{len(nodes)}:"
                left += reversed(nodes)
            case constant:
                yield repr(constant)


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
