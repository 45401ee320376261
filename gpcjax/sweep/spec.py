"""What a sweep is: one frozen specification made from flags, a TOML file or Python. Loads no jax."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.allowed import shown, suggestion
from gpcjax.envs.registry import default_episodes, default_max_capacity, expert_names
from gpcjax.errors import UserError
from gpcjax.learners.hyperparameters import ALGORITHMS, HYPERPARAMETERS
from gpcjax.sweep.options import EXPERIMENT, OPTIONS, VARIANTS, Written, accept


@dataclass(frozen=True)
class SweepSpec:
    """A sweep: every combination of the tuples, for each seed. `make_spec` and `spec_of` make a checked one."""

    env: str
    algo: tuple[str, ...]
    """Learners, of `ALGORITHMS`."""
    error: tuple[float, ...]
    """Chances that an advice has the wrong sign."""
    seeds: int
    """How many: seeds 0 to seeds - 1."""
    episodes: int
    """Episodes of each run."""
    oracle: tuple[str, ...]
    """Experts of `env` whose actions the teacher aims at."""
    delta: tuple[float, ...]
    """Distances from the target within which the teacher is silent, in units of the action."""
    rate: tuple[float, ...]
    """Chances of advice at a step and action dimension."""
    rate_schedule: tuple[float, ...]
    """That chance in each episode (the last one from then on) in place of `rate`; empty if there is none."""
    sparsify: bool
    """SPARS (Alg. 3) on or off."""
    on_full: str
    """What a dictionary does that is full at `max_capacity`: one of `ON_FULL`."""
    max_capacity: int
    """Points in a dictionary at most."""
    hyperparameters: Mapping[str, tuple[float, ...]] = field(hash=False)
    """Values instead of the thesis' tables, by name; only those that were given."""


class Given(NamedTuple):
    """A checked value and where it stood, for messages: "--error", or "a.toml: error"."""

    value: Any
    where: str


QUICK = "quick"
"""A table of settings in a TOML file that make its sweep a small one, used where that is asked for."""


LARGEST_FILE = 1 << 18
"""Bytes of a file of settings, at most: every setting takes a line, and a schedule of ten thousand chances fits."""

DEEPEST = 16
"""Brackets in brackets, and parts of a dotted key: settings need two of each, and `tomllib` takes time that grows with
the square of the one and a frame of Python's stack for each of the other."""

_TOKENS = re.compile(
    r"""  "{3} (?: [^\\] | \\. )*? (?: "{3,5} | \\?\Z)  |  '{3} .*? (?: '{3,5} | \Z)  # texts over several lines
      | " (?: [^"\\\n] | \\[^\n] )* (?: " | \\?$)  |  ' [^'\n]* (?: ' | $)  # and on one
      | \# [^\n]*
      | (?P<mark> [][{}.,=\n] )""",
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)


def read_toml(path: Path, quick: bool = False) -> dict[str, Given]:
    """The settings of a TOML file, each checked alone; with `quick` those of its table [quick] win.

    Raises:
        UserError: the file is missing, is not TOML, is no file of settings by its size or depth, has a key or value
            that is not allowed, or has no table [quick] though `quick` asks for it.
    """
    table = _read_table(path)
    has_small, small = QUICK in table, table.pop(QUICK, {})
    if not isinstance(small, dict):
        raise UserError(f"{path}: {QUICK} is no table: begin one with a line [{QUICK}]")
    given, fewer = _accepted(table, f"{path}: "), _accepted(small, f"{path}: [{QUICK}] ")
    if quick and not has_small:
        raise UserError(f"{path}: it has no table [{QUICK}]: leave --quick out, or add the table")
    return given | fewer if quick else given


def _read_table(path: Path) -> dict[str, Any]:
    """What a TOML file holds, its fractions as they are written."""
    try:
        with open(path, "rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}): give a TOML file of settings") from None
    except ValueError as error:  # a null byte in the path
        raise UserError(f"{path}: no file can be there ({error}): give a TOML file of settings") from None
    if len(content) > LARGEST_FILE:
        raise UserError(f"{path}: too large for settings: {LARGEST_FILE:,} bytes are allowed")
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: this is not a text file in UTF-8: {error}") from None
    if _depth(text) > DEEPEST:
        raise UserError(f"{path}: too deep for settings: give them as NAME = VALUE, one a line")
    try:
        return tomllib.loads(text, parse_float=Written)
    except (
        ValueError,
        RecursionError,
    ) as error:  # the first: not TOML, or an integer of more digits than are read
        raise UserError(f"{path}: this is not TOML: {error}") from None


def _depth(text: str) -> int:
    """How deep brackets or the dots of a key go in TOML, outside of texts and comments; an estimate from above."""
    open_brackets = dots = deepest = 0
    for token in _TOKENS.finditer(text):
        match token["mark"]:
            case "[" | "{":
                open_brackets += 1
                dots = 0
            case "]" | "}":
                open_brackets = max(open_brackets - 1, 0)
            case ".":
                dots += 1
            case "," | "=" | "\n":
                dots = 0
        deepest = max(deepest, open_brackets, dots)
    return deepest


def spec_of(**settings: Any) -> SweepSpec:
    """The specification with these settings, named as in TOML: `spec_of(env="cartpole", error=[0, 0.1], seeds=20)`.

    Raises:
        UserError: a name or value that is not allowed.
    """
    given = _accepted(settings, "")
    if "rate_from" in given:
        raise UserError("rate_from: give rate_schedule, the chances themselves, here")
    return make_spec(given)


def make_spec(given: Mapping[str, Given]) -> SweepSpec:
    """The specification of settings: defaults filled in, and all that must fit together does.

    `out`, `jobs` and `rate_from` may be among the settings; they are no part of it.

    Raises:
        UserError: no env, an oracle that the env has not, or a setting that would change nothing.
    """
    if "env" not in given:
        raise UserError(f"no env: give {OPTIONS['env'].allowed} (--env, or env = in the TOML file)")
    value = {name: setting.value for name, setting in given.items()}
    env, algo = value["env"], value.get("algo", ALGORITHMS)
    for oracle in value.get("oracle", ()):
        if oracle not in expert_names(env):
            allowed = " or ".join(expert_names(env))
            raise UserError(f"{given['oracle'].where} {shown(oracle)}: give {allowed} for {env}")
    for name, setting in given.items():
        concerned = OPTIONS[name].algorithms
        if not set(concerned) & set(algo):
            alone = f"with {' and '.join(algo)} alone it changes nothing"
            raise UserError(f"{setting.where}: {alone}, give it with {' or '.join(concerned)}")
    if "static_rate" in given and "constant_rate" in given:
        where = given["constant_rate"].where
        raise UserError(f"{where}: beside static_rate it changes nothing, give one of the two")
    if "rate_schedule" in given and "rate" in given:
        raise UserError(
            f"{given['rate'].where}: beside rate_schedule it changes nothing, give one of the two"
        )
    defaults = {option.name: option.default for option in EXPERIMENT + VARIANTS} | {
        "episodes": default_episodes(env),
        "oracle": expert_names(env)[:1],
        "max_capacity": default_max_capacity(env),
        "rate_schedule": (),
    }
    settings = {name: value.get(name, default) for name, default in defaults.items()}
    settings["hyperparameters"] = {name: value[name] for name in HYPERPARAMETERS if name in value}
    return SweepSpec(**settings)


def as_dict(spec: SweepSpec) -> dict[str, Any]:
    """The specification as JSON has it: lists for tuples."""
    return _lists(asdict(spec))


def _accepted(table: Mapping[str, Any], prefix: str) -> dict[str, Given]:
    """The settings of a table, each checked alone; dashes and underscores in a key are one."""
    accepted: dict[str, Given] = {}
    for key, value in table.items():
        name, where = key.replace("-", "_"), f"{prefix}{key}"
        if name not in OPTIONS:
            near = suggestion(name, OPTIONS)
            raise UserError(f"{prefix}{shown(key)} is no setting{near}: give {', '.join(OPTIONS)}")
        if name in accepted:
            raise UserError(f"{where} is given twice, with a dash and with an underscore: give it once")
        accepted[name] = Given(accept(OPTIONS[name], value, where), where)
    return accepted


def _lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _lists(inner) for name, inner in value.items()}
    return list(value) if isinstance(value, tuple) else value
