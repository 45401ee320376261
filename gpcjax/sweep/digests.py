"""What names stand for that are not built in: a digest of the code or the files behind each. Loads no jax.

A specification names a learner, a task, a teacher and an expert of a person's own by module or folder. What these hold
may change under the name: the manifest keeps what it was, and a folder takes no rows of something else.
"""

import importlib.metadata
import json
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gpcjax.elsewhere import path_here
from gpcjax.errors import UserError
from gpcjax.recording import RECORD
from gpcjax.registry import Kind, built_in, find, module_of
from gpcjax.sweep.code import digests_of_modules
from gpcjax.sweep.layout import sha256
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.versions import LIBRARIES

ENTRY = "digests"
"""Of a manifest, by "env NAME", "algo NAME" and so on: the digests of the parts of each. Those of 0.2 have none."""

Digests = Mapping[str, Mapping[str, str]]

_LIBRARIES = {"gym": ("gymnasium",), "brax": ("brax", "mujoco")}
"""What computes the tasks of these prefixes."""

_SIMULATORS = {"gymnasium.envs.mujoco": ("mujoco",), "gymnasium.envs.box2d": ("box2d", "box2d-py")}
"""What is installed beside gymnasium for its tasks in these packages, under one of these names."""

_FILE = "its files"


def digests_of(spec: SweepSpec) -> dict[str, dict[str, str]]:
    """What the names of a specification stand for now, of those that are not built in."""
    return _digests(spec.env, spec.teacher, spec.algo, spec.oracle)


def names_of(env: str, teacher: str, algo: str, oracle: str) -> tuple[str, ...]:
    """The names of a cell, as the digests have them."""
    return f"env {env}", f"teacher {teacher}", f"algo {algo}", f"oracle {oracle}"


class Loaded:
    """The code of a person's own that a process computes with: as it was when it was first looked at there.

    What is edited later is not loaded again.
    """

    def __init__(self) -> None:
        self._seen: dict[str, str] = {}

    def refuse_other(self, cell: Cell, held: Digests) -> None:
        """Refuses to compute with something else than a sweep was begun with: asked when all that is imported.

        What is installed on one machine may be followed on another: what both follow must be the same.

        Raises:
            UserError: it was edited since, or is another one on this machine.
        """
        now = _digests(cell.env, cell.teacher, (cell.algo,), (cell.oracle,)) if held else {}
        for name, parts in now.items():
            known = held.get(name, {})
            mine = {part: self._first(part, told) for part, told in parts.items()}
            if odd := [part for part in mine if part in known and known[part] != mine[part]]:
                raise UserError(
                    f"{name} is not what it was when this sweep was begun{which(name, odd)}: it was edited meanwhile "
                    "(give the command again), or another one is on this machine"
                )

    def _first(self, part: str, told: str) -> str:
        return told if part == _FILE else self._seen.setdefault(part, told)  # files are read each time


def conflicts(held: Digests, now: Digests) -> dict[str, list[str]]:
    """The names that stood for something else, each with the parts of it that differ."""
    return {
        name: [part for part in {**held[name], **parts} if held[name].get(part) != parts.get(part)]
        for name, parts in now.items()
        if name in held and held[name] != parts
    }


def which(name: str, parts: Sequence[str]) -> str:
    """Those parts of a name, in parentheses, that differ; nothing where it has no others."""
    return "" if [*parts] == [name.partition(" ")[2]] else f" ({', '.join(parts[:3])})"


def _digests(
    env: str, teacher: str, algos: Iterable[str], oracles: Iterable[str]
) -> dict[str, dict[str, str]]:
    experts = find("task", env).experts  # by now gymnasium is imported, which knows where its tasks come from
    asked: list[tuple[str, Kind, str]] = [("env", "task", env), ("teacher", "teacher", teacher)]
    for name in algos:
        asked.append(("algo", "learner", name))
    found = {
        f"{setting} {name}": _parts_of(kind, name)
        for setting, kind, name in asked
        if name not in built_in(kind)
    }
    for name in oracles:
        is_ours = env in built_in("task") and name in experts
        found |= {} if is_ours else {f"oracle {name}": _parts_of_expert(experts.get(name, name))}
    return {name: parts for name, parts in found.items() if parts}


def _parts_of(kind: Kind, name: str) -> dict[str, str]:
    """What a task, a learner or a teacher is made of."""
    prefix, colon, rest = name.partition(":")
    if kind == "teacher" and (prefix == "replay" or os.path.isdir(path_here(name))):
        return _file(path_here(rest if prefix == "replay" else name))
    if colon and kind == "task" and prefix in _LIBRARIES:
        modules = _of_gymnasium(rest) if prefix == "gym" else []
        libraries = [*_LIBRARIES[prefix], *_simulators(modules)]
        return {library: _version(library) for library in libraries} | _modules(modules, libraries)
    spec = find(kind, name)
    return _modules([module_of(kind, name), *_modules_in([getattr(spec, "make", None)])])


def _parts_of_expert(entry: Any) -> dict[str, str]:
    """What an expert is made of: a folder, a function, or what makes one and its arguments."""
    entries = entry if isinstance(entry, tuple) else (entry,)
    found = _modules(_modules_in(entries))
    for each in entries:
        if isinstance(each, str) and os.path.isdir(path_here(each)):
            from gpcjax.policies.folder import CARD, sum_of_folder  # which loads numpy

            folder = Path(path_here(each))
            found |= {_FILE: sum_of_folder(folder)} | _modules(_named_in(folder / CARD))
    return found


def _modules(names: Iterable[str], versioned: Collection[str] = ()) -> dict[str, str]:
    return digests_of_modules(dict.fromkeys(filter(None, names)), (*versioned, *LIBRARIES))


def _modules_in(things: Iterable[Any]) -> Iterator[str]:
    """The modules of texts "module:attribute", and of functions and classes."""
    for thing in things:
        if isinstance(thing, str):
            yield thing.partition(":")[0] if ":" in thing else ""
        elif isinstance(thing, Callable):
            yield getattr(thing, "module", None) or getattr(thing, "__module__", None) or ""


def _named_in(card: Path) -> list[str]:
    """Modules that the card of a policy may name, as that of a person's own learner does."""

    def texts(value: Any) -> Iterator[str]:
        match value:
            case str():
                yield value
            case dict():
                for inner in value.values():
                    yield from texts(inner)
            case list():
                for inner in value:
                    yield from texts(inner)

    try:
        return list(_modules_in(texts(json.loads(card.read_bytes()))))
    except (OSError, ValueError, RecursionError):
        return []  # told where it is read


def _of_gymnasium(task: str) -> list[str]:
    """The modules that a task of gymnasium comes from, as far as it says so itself."""
    module, colon, name = task.rpartition(":")
    registry = getattr(sys.modules.get("gymnasium"), "registry", {})
    point = getattr(registry.get(name), "entry_point", None)
    return [module if colon else "", *_modules_in([point])]


def _simulators(modules: Iterable[str]) -> list[str]:
    """The libraries that simulate gymnasium's own tasks in these modules."""
    packages = [module.rpartition(".")[0] for module in modules]
    asked = (name for package in packages for name in _SIMULATORS.get(package, ()))
    return [name for name in asked if _version(name) != _UNKNOWN]


def _file(path: str) -> dict[str, str]:
    file = os.path.join(path, RECORD) if os.path.isdir(path) else path
    try:
        return {_FILE: sha256(Path(file).read_bytes())[:12]}
    except OSError:
        return {}  # told where it is read


_UNKNOWN = "unknown"


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return _UNKNOWN
