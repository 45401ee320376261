"""Every setting of a sweep in one table, from which flags, TOML keys, help and messages come. Loads no jax.

`parse` reads the text of a flag, `accept` a value from TOML or Python. Both return checked values of one form (a
tuple without repeats where a list is possible), or raise a `UserError` that begins with where the value stood.
"""

import math
import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

from gpcjax.allowed import (
    COUNT,
    NON_NEGATIVE,
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
from gpcjax.envs.registry import default_episodes, default_max_capacity, env_names, expert_names
from gpcjax.errors import UserError
from gpcjax.learners.hyperparameters import ALGORITHMS, CAPACITY, HYPERPARAMETERS, ON_FULL

LARGEST = int(COUNT.high)
"""Bound on seeds, episodes and the cells of one sweep."""

_INTEGER = re.compile(r"[+-]?[0-9]+")
_DECIMAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
"""How a flag writes numbers: Python's `int` and `float` also take other alphabets' digits, and 1_0 for ten."""


class Written(float):
    """A number as a flag or a file has it, which messages repeat: 1e-400 would read 0.0 in them."""

    text: str

    def __new__(cls, text: str) -> "Written":
        """Of a text that `float` takes."""
        number = super().__new__(cls, text)
        number.text = text
        return number

    def __repr__(self) -> str:
        return self.text

    @property
    def lost(self) -> bool:
        """Whether float64 has zero in its place, or a subnormal number, which processors may flush to zero."""
        mantissa = re.split("[eE]", self.text)[0]
        return abs(self) < sys.float_info.min and any(digit in mantissa for digit in "123456789")


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
    algorithms: tuple[str, ...] = ALGORITHMS
    otherwise: str = ""
    """What holds if nobody gives a value, where that is not one `default`."""

    @property
    def flag(self) -> str:
        """The option on the command line."""
        return "--" + self.name.replace("_", "-")


_GP = tuple(name for name in ALGORITHMS if name != "coach")
_ORACLES = tuple(dict.fromkeys(expert for env in env_names() for expert in expert_names(env)))


def _by_env(default: Callable[[str], object]) -> str:
    return ", ".join(f"{default(env)} for {env}" for env in env_names())


EXPERIMENT = (
    Option("env", str, OneOf(env_names()), "the task"),
    Option("algo", str, OneOf(ALGORITHMS), "who learns", ALGORITHMS, many=True),
    Option("error", float, PROBABILITY, "chance that an advice has the wrong sign", (0.0,), many=True),
    Option("seeds", int, COUNT, "how many: seeds 0 to n-1 of everything", 100),
    Option("episodes", int, COUNT, "episodes of each run", otherwise=_by_env(default_episodes)),
    Option(
        "oracle",
        str,
        OneOf(_ORACLES),
        "whose actions the teacher aims at",
        many=True,
        otherwise=_by_env(lambda env: expert_names(env)[0]),
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
)
VARIANTS = (
    Option("sparsify", bool, SWITCH, "SPARS (Alg. 3)", True, algorithms=_GP),
    Option("on_full", str, OneOf(ON_FULL), "what a full dictionary does", "error", algorithms=_GP),
    Option(
        "max_capacity",
        int,
        CAPACITY,
        "points in a dictionary at most",
        algorithms=_GP,
        otherwise=_by_env(default_max_capacity),
    ),
)
TUNING = tuple(
    Option(row.name, float, row.allowed, f"{row.symbol}, {row.text}", many=True, algorithms=row.algorithms)
    for row in HYPERPARAMETERS.values()
)
RUNNING = (
    Option("out", str, Anything("the path of a folder"), "run folder", otherwise="runs/ENV-HASH"),
    Option("jobs", int, Numbers(1, 1024, whole=True), "processes at once", otherwise="one for each core"),
    Option(
        "rate_from",
        str,
        Anything("the path of a run folder"),
        "takes rate_schedule from the chances that another sweep's teacher offered",
    ),
)
OPTIONS: dict[str, Option] = {option.name: option for option in EXPERIMENT + VARIANTS + TUNING + RUNNING}


def parse(option: Option, text: str, where: str) -> Any:
    """The checked value of a flag's `text`, a comma list where the option takes many."""
    words = [word.strip() for word in text.split(",")] if option.many or option.series else [text]
    if "" in words:
        raise UserError(f"{where} {shown(text)}: an empty value, give {option.allowed}")
    return _checked(option, [_from_word(option, word, where) for word in words], where)


def accept(option: Option, value: Any, where: str) -> Any:
    """The checked form of a `value` from TOML or Python."""
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    value = plain(value)
    if option.kind is str and isinstance(value, str):
        return parse(option, value, where)
    values = entries(where, value, LARGEST + 1) if option.many or option.series else None
    if values is None:
        return _checked(option, [value], where)
    if not values:
        raise UserError(f"{where} []: the list is empty, give {option.allowed}")
    if len(values) > LARGEST:
        raise UserError(f"{where}: more than {LARGEST:,} values, give fewer")
    return _checked(option, values, where)


def _from_word(option: Option, word: str, where: str) -> Any:
    """A word as `option.kind` has it; not a number is refused here, a number that is not allowed later."""
    if option.kind is str:
        return word
    try:
        number = option.kind(word) if option.kind is int else Written(word.strip())
    except ValueError:
        _refuse(option, word, where)
    grammar = _INTEGER if option.kind is int else _DECIMAL
    if grammar.fullmatch(word.strip()) or (option.kind is float and not math.isfinite(number)):
        return number
    _refuse(option, word, where)


def _checked(option: Option, values: list[Any], where: str) -> Any:
    checked = []
    for value in values:
        one = None if isinstance(value, Written) and value.lost else converted(option.kind, value)
        if one is None or not option.allowed.admits(one):
            _refuse(option, value, where)
        checked.append(one)
    if option.series:
        return tuple(checked)
    return tuple(dict.fromkeys(checked)) if option.many else checked[0]


def _refuse(option: Option, value: Any, where: str) -> NoReturn:
    if isinstance(value, Written) and value.lost:
        raise UserError(f"{where} {shown(value)}: too small for a number in float64, give {option.allowed}")
    choices = option.allowed.choices if isinstance(option.allowed, OneOf) and option.kind is str else ()
    near = suggestion(value, choices) if choices else ""
    raise UserError(f"{where} {shown(value)}: give {option.allowed}{near}")
