"""From a name to what it stands for: `find("task", "cartpole")`. Loads no jax for what is built in.

| A name                | is                                                                                       |
|-----------------------|------------------------------------------------------------------------------------------|
| `cartpole`, `gpc`, ... | built in                                                                                |
| a word                | what an installed package registers: entry points `gpcjax.tasks`, `.learners`, `.teachers` |
| `module:NAME`         | a class, a function that makes one, or a description, from a module that Python finds     |
| `gym:ID`              | a task of gymnasium, simulated on the host                                               |
| `brax:NAME`           | a task of brax, in compiled lanes                                                        |

A module is looked for where Python looks, and in the present folder. What is imported is somebody else's code: if it
fails, its own traceback is kept for the person (`ForeignError.details`).
"""

import dataclasses
import functools
import importlib
import importlib.metadata
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from types import TracebackType
from typing import Any, Literal

from gpcjax.allowed import shown, suggestion
from gpcjax.describe import LearnerSpec, Spec, TaskSpec, TeacherSpec
from gpcjax.elsewhere import path_here
from gpcjax.errors import ForeignError, UserError
from gpcjax.installed import require_set_up
from gpcjax.making import Maker
from gpcjax.own_settings import check_name, compiled_if_whole

Kind = Literal["task", "learner", "teacher"]

_BUILT_IN: Mapping[str, str] = {
    "task": "gpcjax.envs.tasks:TASKS",
    "learner": "gpcjax.learners.descriptions:LEARNERS",
    "teacher": "gpcjax.teachers.descriptions:TEACHERS",
}
"""Where the descriptions of each kind are: tuples of them, in modules that load no jax."""

_WORD = {"task": "env", "learner": "algo", "teacher": "teacher"}
"""The setting that takes names of a kind."""

_SPECS: Mapping[str, type[Spec]] = {"task": TaskSpec, "learner": LearnerSpec, "teacher": TeacherSpec}

_MOST = {
    "task": "a class with reset and step (gpcjax.Env), a task of gymnasium or brax, or a function that makes one",
    "learner": "a subclass of gpcjax.Learner, or a function that makes a learner",
    "teacher": "a subclass of gpcjax.Teacher, or a function that makes a teacher",
}


_BASES = {"learner": "gpcjax.learners.base:Learner", "teacher": "gpcjax.teachers.base:Teacher"}
"""What those of a person's own are subclasses of."""


def built_in(kind: Kind) -> tuple[str, ...]:
    """The names that are built in."""
    return tuple(_built_in(kind))


def names(kind: Kind) -> tuple[str, ...]:
    """All names that can be listed: what is built in, then what installed packages register."""
    return tuple(dict.fromkeys([*_built_in(kind), *_entry_points(kind)]))


def learner_names() -> tuple[str, ...]:
    """The names of the learners that `make_learner` and sweeps know, beside `module:NAME`."""
    return names("learner")


def teacher_names() -> tuple[str, ...]:
    """The names of the teachers that sweeps know, beside `module:NAME`."""
    return names("teacher")


def find(kind: Kind, name: Any, source: str = "") -> Any:
    """The description that a name stands for. `source` begins the messages, the setting that takes such names if empty.

    Raises:
        UserError: nothing has that name, or what has it is not of this kind.
        ForeignError: the module that it names cannot be imported.
    """
    source = source or _WORD[kind]
    if not isinstance(name, str):
        raise UserError(f"{source} {shown(name)}: give {_choices(kind)}")
    known = _FOUND.get((kind, name))
    if known is None or known[1] is not _present(name):
        spec = _built_in(kind).get(name) or _elsewhere(kind, name, source)
        known = _FOUND[kind, name] = spec, _present(name)
    return known[0]


_FOUND: dict[tuple[Kind, str], tuple[Spec, Any]] = {}
"""What was found, and what a person's module had there: it is imported, and what it makes is looked at, once in a
process, and again where it has another class or function now, as in a notebook, or after `importlib.reload`."""


def _present(name: str) -> Any:
    """What a person's module that was imported has under a name; None of any other name."""
    module, colon, attribute = name.partition(":")
    found = sys.modules.get(module) if colon and module not in ("gym", "brax", "replay") else None
    for part in attribute.split("."):
        found = getattr(found, part, None)
    return found


def module_of(kind: Kind, name: str) -> str:
    """The module that a name which is not built in comes from; "" where it is none, as of `gym:ID`."""
    module, colon, _ = name.partition(":")
    if colon:
        return "" if module in ("gym", "brax", "replay") else module
    point = _entry_points(kind).get(name)
    return "" if point is None else point.module


def found(kind: Kind, name: str) -> Any:
    """The description of a name that was asked for before in this process; None of any other."""
    return _FOUND.get((kind, name), (None,))[0]


def _elsewhere(kind: Kind, name: str, source: str) -> Spec:
    if kind == "teacher" and name == "person":
        return resolve("gpcjax.teachers.descriptions:PERSON")
    if kind == "teacher" and os.path.isdir(path_here(name)):
        return resolve("gpcjax.teachers.replay:described_record")(name, source)
    prefix, colon, rest = name.partition(":")
    if colon and kind == "task" and prefix in ("gym", "brax"):
        return resolve("gpcjax.envs.foreign:described_elsewhere")(prefix, rest)
    if colon and kind == "teacher" and prefix == "replay":
        return resolve("gpcjax.teachers.replay:described_record")(rest, source)
    if colon:
        return described(kind, name, imported(name, f"{source} {name}"))
    if name in _entry_points(kind):
        point = _entry_points(kind)[name]
        with _told(f"{source} {name}", point.module):
            found = point.load()
        return described(kind, name, found)
    raise UserError(f"{source} {shown(name)}: give {_choices(kind)}{suggestion(name, names(kind))}")


def described(kind: Kind, name: str, found: Any) -> Spec:
    """The description of what somebody else's module has under a name: its own, or one made of a class or function.

    Raises:
        UserError: it is nothing of this kind, or has a setting of a name that it cannot have.
    """
    is_told = isinstance(found, _SPECS[kind])
    if is_told and not isinstance(found, TaskSpec):
        return _told_of(kind, name, found)
    if not is_told and (not callable(found) or isinstance(found, Spec)):
        raise UserError(f"{_WORD[kind]} {name}: {shown(found)} is no {kind}, give {_MOST[kind]}")
    makers = {
        "task": "gpcjax.envs.foreign:task_of",
        "learner": "gpcjax.learners.foreign:learner_of",
        "teacher": "gpcjax.teachers.foreign:teacher_of",
    }
    return resolve(makers[kind])(name, found)


def _told_of(kind: Kind, name: str, spec: Any) -> Spec:
    """A person's own description of a learner or a teacher, under the name by which it was asked for.

    Raises:
        UserError: it has a setting of a name that it cannot have.
    """
    source = f"{_WORD[kind]} {name}"
    for setting in spec.settings:
        check_name(f"{source}: its setting {setting.name}", setting.name)
    settings = tuple(map(compiled_if_whole, spec.settings))
    make = imported(spec.make, source) if isinstance(spec.make, str) else spec.make
    base = resolve(_BASES[kind])

    def accepted(made: Any) -> Any:
        if not isinstance(made, base):
            raise UserError(f"{source}: {shown(made)} is no {kind}, give {_MOST[kind]}")
        return made

    return dataclasses.replace(spec, name=name, make=Maker(source, make, accepted), settings=settings)


def resolve(target: str | Callable[..., Any]) -> Any:
    """What "module:attribute" stands for, of a module of ours; what is no text is meant itself."""
    if not isinstance(target, str):
        return target
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)


def imported(name: str, source: str) -> Any:
    """What a person's "module:attribute" stands for. `source` begins the messages.

    Raises:
        UserError: it is no such name, there is no such module, or nothing of that name in it.
        ForeignError: the module fails while it is imported.
        ModuleNotFoundError: gpcjax is not set up, so that nobody can tell.
    """
    module, _, attribute = name.partition(":")
    if not all(part.isidentifier() for part in [*module.split("."), *attribute.split(".")]):
        raise UserError(f"{source}: give module:NAME, as in mytask:Drift")
    require_set_up()
    here = os.getcwd()
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)  # last: nothing in the folder stands before what is installed
    with _told(source, module):
        found = importlib.import_module(module)
    for part in attribute.split("."):
        if not hasattr(found, part):
            known = (
                [each for each in vars(found) if not each.startswith("_")]
                if hasattr(found, "__dict__")
                else []
            )
            raise UserError(f"{source}: {module} has no {attribute}{suggestion(part, known)}")
        found = getattr(found, part)
    return found


class _told:
    """Around an import: what goes wrong there is told as somebody else's."""

    def __init__(self, source: str, module: str):
        self._where, self._module = source, module

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not isinstance(error, Exception | SystemExit) or isinstance(error, UserError):
            return
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing is not None and f"{self._module}.".startswith(f"{missing}."):
            raise UserError(
                f"{self._where}: there is no module {missing}, neither installed nor in {os.getcwd()}"
            ) from None
        raise ForeignError(f"{self._where}: {self._module} cannot be imported", error) from None


def _built_in(kind: Kind) -> Mapping[str, Spec]:
    return _tables(_BUILT_IN[kind])


@functools.cache
def _tables(target: str) -> Mapping[str, Spec]:
    return {spec.name: spec for spec in resolve(target)}


@functools.cache
def _entry_points(kind: Kind) -> Mapping[str, importlib.metadata.EntryPoint]:
    found: Iterable[importlib.metadata.EntryPoint] = importlib.metadata.entry_points(group=f"gpcjax.{kind}s")
    return {point.name: point for point in found}


def choices(kind: Kind, known: Iterable[str]) -> str:
    """What may be given as a name of this kind, in words; `known` are those that can be listed."""
    more = {
        "task": ("gym:ID", "brax:NAME"),
        "teacher": ("replay:FILE", "a folder of gpcjax teach"),
    }.get(kind, ())
    *first, last = [*known, "module:NAME", *more]
    return f"{', '.join(first)} or {last}"


def _choices(kind: Kind) -> str:
    return choices(kind, names(kind))
