"""Every setting of a sweep in one table, from which flags, TOML keys, help and messages come. Loads no jax.

`parse` reads the text of a flag, `accept` a value from TOML or Python. Both return checked values of one form (a
tuple without repeats where a list is possible), or raise a `UserError` that begins with where the value stood.

Over 300 lines: a third of them is the table.
"""

import math
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NoReturn

from gpcjax.allowed import (
    COUNT,
    NON_NEGATIVE,
    POSITIVE,
    PROBABILITY,
    SWITCH,
    Allowed,
    Anything,
    Numbers,
    OneOf,
    converted,
    entries,
    plain,
    shown,
    suggestion,
)
from gpcjax.describe import LearnerSpec, Setting, TaskSpec, TeacherSpec
from gpcjax.errors import UserError
from gpcjax.learners.descriptions import CAPACITY, CREDIT, ON_FULL
from gpcjax.registry import Kind, built_in, choices, find
from gpcjax.sweep.keeping import WHATS, WHEN
from gpcjax.sweep.scales import SCALES
from gpcjax.sweep.seeds import WORDS as SEEDS
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.written import Written

ENGINES = ("processes", "ray")
"""What runs the workers of a sweep: of this machine, or of a cluster."""

LARGEST = int(COUNT.high)
"""Bound on seeds, episodes and the cells of one sweep."""

_INTEGER = re.compile(r"[+-]?[0-9]+")
_DECIMAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
"""How a flag writes numbers: Python's `int` and `float` also take other alphabets' digits, and 1_0 for ten."""


@dataclass(frozen=True)
class Option:
    """One setting: `kind` is the type of one value.

    `many` says that a list of values makes more cells; `series`, that the list is one value, in its order.
    """

    name: str
    kind: type
    allowed: Allowed
    text: str
    default: Any = None
    many: bool = False
    series: bool = False
    otherwise: str = ""
    """What holds if nobody gives a value, where that is not one `default`."""
    names: Kind | None = None
    """What its values are names of."""

    @property
    def flag(self) -> str:
        """The option on the command line."""
        return "--" + self.name.replace("_", "-")


def _by_task(default: Callable[[TaskSpec], object]) -> str:
    return ", ".join(f"{default(find('task', name))} for {name}" for name in built_in("task"))


def _named(kind: Kind) -> Anything:
    return Anything(choices(kind, built_in(kind)))


def option_of(setting: Setting) -> Option:
    """The option that a learner's or a teacher's setting is in a sweep: numbers, of which a list makes more cells."""
    symbol = f"{setting.symbol}, " if setting.symbol else ""
    return Option(setting.name, setting.kind, setting.allowed, f"{symbol}{setting.text}", many=True)


OF_THE_THESIS = ("gpc", "gpc-ns", "coach")
"""The learners that are compared where nobody names others."""

EXPERIMENT = (
    Option("env", str, _named("task"), "the task", names="task"),
    Option("algo", str, _named("learner"), "who learns", OF_THE_THESIS, many=True, names="learner"),
    Option("teacher", str, _named("teacher"), "who teaches", built_in("teacher")[0], names="teacher"),
    Option("error", float, PROBABILITY, "chance that an advice has the wrong sign", (0.0,), many=True),
    Option("seeds", Seeds, Anything(SEEDS), "how many (0 to n-1), or which", Seeds(((0, 99),))),
    Option("episodes", int, COUNT, "episodes of each run", otherwise=_by_task(lambda task: task.episodes)),
    Option(
        "oracle",
        str,
        Anything("an expert of the task, the folder of a saved policy, or module:function"),
        "whose actions the teacher aims at",
        many=True,
        otherwise=_by_task(lambda task: next(iter(task.experts))),
    ),
    Option("delta", float, NON_NEGATIVE, "the teacher is silent this near to its target", (0.05,), many=True),
    Option("rate", float, PROBABILITY, "(least) chance of advice at a step", (0.05,), many=True),
    Option(
        "rate_schedule",
        float,
        PROBABILITY,
        "that chance in each episode, in place of rate",
        series=True,
        otherwise="rate",
    ),
    Option(
        "start",
        str,
        Anything("the path of a run folder with kept states, or of a saved learner"),
        "runs begin with what was learned there",
        otherwise="with nothing",
    ),
)
VARIANTS = (
    Option("sparsify", bool, SWITCH, "SPARS (Alg. 3)", True),
    Option("on_full", str, OneOf(ON_FULL), "what a full dictionary does", "error"),
    Option(
        "max_capacity",
        int,
        CAPACITY,
        "points in a dictionary at most",
        otherwise=_by_task(lambda task: task.max_capacity),
    ),
    Option(
        "scaling",
        float,
        POSITIVE,
        "w, what each number of an observation is multiplied by (in GPC-NS, once it is normalised)",
        series=True,
        otherwise="the task's, in GPC-NS none",
    ),
    Option(
        "human_scaling",
        float,
        POSITIVE,
        "the same for the human model, of each number of an observation and of the action",
        series=True,
        otherwise="scaling, and 1 for the action",
    ),
)
"""Of learners with dictionaries, or of those that have such an option."""
CONCERNING_SOME = frozenset(option.name for option in VARIANTS)


def settings_of(
    learners: Iterable[LearnerSpec], teachers: Iterable[TeacherSpec]
) -> dict[str, tuple[Setting, ...]]:
    """The settings of these and of all learners by name, each as those declare it that have it."""
    found: dict[str, tuple[Setting, ...]] = {}
    for setting in (*(each for spec in (*learners, *teachers) for each in spec.settings), *CREDIT):
        found[setting.name] = (*found.get(setting.name, ()), setting)
    return found


def _tuning(settings: Iterable[Setting]) -> tuple[Option, ...]:
    """An option for each name among settings."""
    return tuple({setting.name: option_of(setting) for setting in reversed([*settings])}.values())[::-1]


OF_LEARNERS, OF_TEACHERS = (
    _tuning(setting for name in built_in(kind) for setting in find(kind, name).settings)
    for kind in ("learner", "teacher")
)
"""Of the built-in ones."""
OF_CREDIT = _tuning(CREDIT)
TUNING = OF_LEARNERS + OF_TEACHERS + OF_CREDIT
OWNED = frozenset(option.name for option in OF_LEARNERS + OF_TEACHERS)
"""Names that others may have for settings of their own, with bounds of their own."""

RUNNING = (
    Option("out", str, Anything("the path of a folder"), "run folder", otherwise="runs/ENV-HASH"),
    Option("jobs", int, Numbers(1, 1024, whole=True), "processes at once", otherwise="one for each core"),
    Option("keep", str, OneOf(WHATS), "of each run, beside its rows", otherwise="nothing"),
    Option("keep_at", str, Anything(WHEN), "the episode after which it is kept", "last"),
    Option(
        "checkpoint",
        float,
        NON_NEGATIVE,
        "seconds after which runs that are under way are saved, to go on there after a kill; 0 for never",
        15.0,
    ),
    Option("engine", str, OneOf(ENGINES), "what runs the workers", ENGINES[0]),
    Option(
        "address",
        str,
        Anything("auto, or HOST:PORT"),
        "of the Ray cluster whose machines --engine ray uses",
        otherwise="a Ray that is started here",
    ),
    Option(
        "shard",
        str,
        Anything("i/n, from 1/n to n/n"),
        "runs the i-th of n shares alone, into OUT/shards/i-of-n, for gpcjax merge",
        otherwise="all",
    ),
    Option(
        "rate_from",
        str,
        Anything("the path of a run folder"),
        "takes rate_schedule from the chances that another sweep's teacher offered",
    ),
)
OPTIONS: dict[str, Option] = {option.name: option for option in EXPERIMENT + VARIANTS + TUNING + RUNNING}


def concerns(name: str, learner: LearnerSpec, teacher: TeacherSpec) -> bool:
    """Whether a setting changes anything for a learner with a teacher."""
    if name in SCALES:
        return name in learner.options
    if name in CONCERNING_SOME:
        return learner.dictionary
    mine = {setting.name for setting in (*learner.settings, *CREDIT)}
    theirs = {setting.name for setting in teacher.settings if learner.uncertain or not setting.uncertain}
    return name in mine | theirs or name in {option.name for option in EXPERIMENT + RUNNING}


def own_values(given: Any, *wanted: tuple[str, type, Allowed]) -> dict[str, Any]:
    """The checked values of a command's own flags, by name, kind and what is allowed; of those that were given.

    `given` has the text of each flag, or None, as an attribute. Raises UserError.
    """
    return {
        name: parse(Option(name, kind, allowed, ""), text, f"--{name}")
        for name, kind, allowed in wanted
        if (text := getattr(given, name)) is not None
    }


def conditions(words: Iterable[str]) -> dict[str, str]:
    """Columns of a run folder and a value of each, from `COLUMN=VALUE`. Raises UserError."""
    found = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or not name.strip() or not text.strip():
            raise UserError(f"--where {shown(word)}: give COLUMN=VALUE, such as algo=gpc")
        found[name.strip().replace("-", "_")] = text.strip()
    return found


def parse(option: Option, text: str, source: str) -> Any:
    """The checked value of a flag's `text`, a comma list where the option takes many."""
    words = [word.strip() for word in text.split(",")] if option.many or option.series else [text]
    if "" in words:
        raise UserError(f"{source} {shown(text)}: an empty value, give {option.allowed}")
    return _checked(option, [_from_word(option, word, source) for word in words], source)


def accept(option: Option, value: Any, source: str) -> Any:
    """The checked form of a `value` from TOML or Python."""
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    value = plain(value)
    if option.kind is Seeds and isinstance(value, str) and value.strip().isdigit():
        _refuse(option, value, source)  # a number in quotes is none, here as elsewhere
    if option.kind is str and isinstance(value, str):
        return parse(option, value, source)
    values = entries(source, value, LARGEST + 1) if option.many or option.series else None
    if values is None:
        return _checked(option, [value], source)
    if not values:
        raise UserError(f"{source} []: the list is empty, give {option.allowed}")
    if len(values) > LARGEST:
        raise UserError(f"{source}: more than {LARGEST:,} values, give fewer")
    return _checked(option, values, source)


def _from_word(option: Option, word: str, source: str) -> Any:
    """A word as `option.kind` has it; not a number is refused here, a number that is not allowed later."""
    if option.kind is str or (option.kind is Seeds and not _INTEGER.fullmatch(word.strip())):
        return word
    try:
        number = Written(word.strip()) if option.kind is float else int(word)
    except ValueError:
        _refuse(option, word, source)
    grammar = _DECIMAL if option.kind is float else _INTEGER
    if grammar.fullmatch(word.strip()) or (option.kind is float and not math.isfinite(number)):
        return number
    _refuse(option, word, source)


def _checked(option: Option, values: list[Any], source: str) -> Any:
    checked = []
    for value in values:
        one = None if isinstance(value, Written) and value.lost else _converted(option.kind, value)
        if one is None or not option.allowed.admits(one):
            _refuse(option, value, source)
        if option.names:
            find(option.names, one, source)
        checked.append(one)
    if option.series:
        return tuple(checked)
    return tuple(dict.fromkeys(checked)) if option.many else checked[0]


def _converted(kind: type, value: object) -> Any:
    return Seeds.of(value) if kind is Seeds else converted(kind, value)


def _refuse(option: Option, value: Any, source: str) -> NoReturn:
    if isinstance(value, Written) and value.lost:
        raise UserError(f"{source} {shown(value)}: too small for a number in float64, give {option.allowed}")
    choices = option.allowed.choices if isinstance(option.allowed, OneOf) and option.kind is str else ()
    near = suggestion(value, choices) if choices else ""
    raise UserError(f"{source} {shown(value)}: give {option.allowed}{near}")
