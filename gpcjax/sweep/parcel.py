"""What a sweep names that other machines do not have: code of a person's own, policies, recordings. Loads no jax.

A parcel is one archive: `code/` with modules, `files/NUMBER` with folders and files. It is made where the sweep was
asked for, and opened in a folder of each worker elsewhere. No shared file system and no network are needed.
"""

import ast
import importlib.machinery
import io
import os
import sys
import sysconfig
import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gpcjax.describe import TaskSpec
from gpcjax.errors import UserError
from gpcjax.registry import Kind, found
from gpcjax.sweep.layout import CHECKPOINTS, DAMAGED
from gpcjax.sweep.lock import LOCK
from gpcjax.sweep.plan import Cell

CODE, FILES = "code", "files"

LARGEST = 1 << 30
"""Bytes of a parcel: more than that is no code, and no policy."""

_LEFT_OUT = {CHECKPOINTS, DAMAGED, LOCK, "__pycache__", ".git"}
"""Names within a folder that nobody needs elsewhere."""

_PREFIXES = ("gym", "brax")
"""Of names whose rest is no module of a person's own."""


@dataclass(frozen=True)
class Parcel:
    """An archive, and which of its files each path is that the sweep names."""

    archive: bytes
    paths: dict[str, str]
    """Path as the sweep names it -> the same below the folder in which the parcel is opened."""

    def open(self, folder: Path) -> dict[str, str]:
        """Unpacks it there; gives where each path lies, for `gpcjax.elsewhere`."""
        unpack(self.archive, folder)
        (folder / CODE).mkdir(exist_ok=True)
        return {named: str(folder / below) for named, below in self.paths.items()}


def parcel_of(cells: Iterable[Cell]) -> Parcel:
    """What these cells name that lies on this machine.

    Raises:
        UserError: it is too large, or cannot be read.
    """
    cells = list(cells)
    names = dict.fromkeys(name for cell in cells for name in (cell.env, cell.algo, cell.teacher, cell.oracle))
    names |= dict.fromkeys(name for cell in cells for name in _told_by(cell))
    paths = [path for name in names if (path := _path_in(name)) is not None]
    paths += dict.fromkeys(cell.start.folder for cell in cells if cell.start is not None)
    below = {path: f"{FILES}/{number}" for number, path in enumerate(dict.fromkeys(paths))}
    contents = [(Path(os.path.expanduser(path)), name) for path, name in below.items()]
    contents += [(path, f"{CODE}/{path.name}") for path in _modules(names)]
    return Parcel(pack(contents), below)


def _told_by(cell: Cell) -> Iterator[str]:
    """What the descriptions of a person's own name in their turn: what makes each thing, and the expert."""
    asked: tuple[tuple[Kind, str], ...] = (
        ("task", cell.env),
        ("learner", cell.algo),
        ("teacher", cell.teacher),
    )
    for kind, name in asked:
        spec = found(kind, name)
        if module := getattr(getattr(spec, "make", None), "module", ""):
            yield f"{module}:"
        if isinstance(spec, TaskSpec):
            match spec.experts.get(cell.oracle):
                case str() as text:
                    yield text
                case entry if callable(entry):
                    yield f"{entry.__module__}:"


def pack(contents: Iterable[tuple[Path, str]]) -> bytes:
    """An archive of files and folders, each under a name of its own.

    Raises:
        UserError: it is too large, or one of them cannot be read.
    """
    sink = io.BytesIO()

    def chosen(entry: tarfile.TarInfo) -> tarfile.TarInfo | None:
        if sink.tell() + entry.size > LARGEST:
            raise UserError(f"{entry.name}: too large to be sent to other machines, {LARGEST:,} bytes are")
        return None if _LEFT_OUT & set(Path(entry.name).parts) else entry

    with tarfile.open(fileobj=sink, mode="w") as archive:
        for path, name in contents:
            try:
                archive.add(os.path.realpath(path), name, filter=chosen)
            except OSError as error:
                raise UserError(f"{path}: cannot be read ({error.strerror})") from None
    return sink.getvalue()


def unpack(archive: bytes, folder: Path) -> None:
    """Writes the files of an archive into a folder, and nowhere else."""
    with tarfile.open(fileobj=io.BytesIO(archive)) as opened:
        opened.extractall(folder, filter="data")


def _path_in(name: str) -> str | None:
    """The path that the name of an expert or a teacher is or holds, if there is something."""
    path = name.partition(":")[2] if name.startswith("replay:") else name
    alone = path == name and os.path.isdir(os.path.expanduser(path))
    return path if alone or (path != name and os.path.exists(os.path.expanduser(path))) else None


def _modules(names: Iterable[str]) -> list[Path]:
    """Files and folders of the modules that `module:NAME` names, and of those beside them that they import."""
    found: dict[Path, None] = {}
    tops = [name.partition(":")[0].partition(".")[0] for name in names if ":" in name]
    left = [path for top in tops if top not in (*_PREFIXES, "replay") and (path := _origin(top)) is not None]
    while left:
        path = left.pop()
        if path in found:
            continue
        found[path] = None
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        imported = {name for file in files for name in _imported(file)}
        beside = [_origin(name, [str(path.parent)]) for name in sorted(imported)]
        left += [each for each in beside if each is not None]
    return list(found)


def _origin(top: str, path: list[str] | None = None) -> Path | None:
    """File or folder of a module, found without importing it; None for what is installed, or nowhere."""
    folders = [*sys.path, os.getcwd()] if path is None else path
    spec = importlib.machinery.PathFinder.find_spec(top, folders)
    if spec is None or spec.origin in (None, "built-in", "frozen"):
        return None
    origin = Path(spec.origin)
    found = origin.parent if spec.submodule_search_locations else origin
    installed = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    inside = any(found.is_relative_to(each) for each in installed)
    return None if inside or top == __name__.partition(".")[0] else found


def _imported(file: Path) -> Iterator[str]:
    """First words of the modules that a file imports by their full names."""
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, SyntaxError, ValueError):
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]
