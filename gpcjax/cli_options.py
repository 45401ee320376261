"""The command line's grammar, built from the table of options. Loads no jax.

`argparse` prints the help. It does not read the words: it passes over a flag that is given twice, takes a value that
begins with a dash for a flag, and fails on `--error=--`.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

from gpcjax.allowed import Anything, shown, suggestion
from gpcjax.errors import UserError
from gpcjax.reproduce.parts import PARTS, folder
from gpcjax.sweep.options import (
    EXPERIMENT,
    OF_CREDIT,
    OF_LEARNERS,
    OF_TEACHERS,
    OPTIONS,
    RUNNING,
    VARIANTS,
    Option,
    parse,
)
from gpcjax.sweep.spec import Given, Unchecked
from gpcjax.teach.command import PORT, REPEAT, SEED, SPEED
from gpcjax.tune.flags import FLAGS

_ENVS, _PARTS, _FOLDER = str(OPTIONS["env"].allowed), ", ".join(PARTS), str(OPTIONS["out"].allowed)

_GROUPS = (
    ("experiment", EXPERIMENT),
    ("variants of GPC and GPC-NS", VARIANTS),
    ("hyperparameters of the learners (without them, the tables of the thesis)", OF_LEARNERS),
    ("the teacher, beside Alg. 4 of the thesis", OF_TEACHERS),
    ("how a learner reckons with late advice", OF_CREDIT),
    ("running", RUNNING),
)


@dataclass(frozen=True)
class Flag:
    """A flag of a command. Without a `metavar` it is a switch and takes no value."""

    name: str
    """With its dashes."""
    text: str
    metavar: str = ""
    value: str = "one"
    """What a missing value should be, for messages."""
    default: str | None = None
    negative: bool = False
    """Whether there is a --no-NAME as well; the switch is then true, false or None."""
    repeated: bool = False
    """Whether it may be given several times; its value is then the list of all."""

    @property
    def key(self) -> str:
        """The attribute that has its value."""
        return self.name[2:].replace("-", "_")


@dataclass(frozen=True)
class Command:
    """What may stand behind a command: flags in groups with titles, and one word that is no flag."""

    text: str
    groups: tuple[tuple[str, tuple[Flag, ...]], ...] = ()
    word: str = ""
    """Name of that word, if it takes one."""
    word_text: str = ""
    needed: bool = False
    """Whether the word must be given."""
    several: bool = False
    """Whether it may be given several times; its value is then the list of all."""

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Of all groups."""
        return tuple(flag for _, flags in self.groups for flag in flags)

    @property
    def names(self) -> list[str]:
        """All flags as they are written, for messages."""
        names = [flag.name for flag in self.flags]
        return [*names, *(f"--no-{flag.name[2:]}" for flag in self.flags if flag.negative), "--help"]


def _flag(option: Option, command: str) -> Flag:
    return Flag(
        option.flag,
        _help(option, command),
        metavar="" if option.kind is bool else _metavar(option),
        value=str(option.allowed),
        negative=option.kind is bool,
    )


def _help(option: Option, command: str) -> str:
    default = option.otherwise
    if option.default is not None:
        values = option.default if isinstance(option.default, tuple) else (option.default,)
        values = DEFAULTS.get(command, {}).get(option.name, values)
        default = ",".join(str(value).removesuffix(".0") for value in values)
    unlisted = isinstance(option.allowed, Anything) and option.names is None
    notes = [] if unlisted else [str(option.allowed)]
    if default:
        notes.append(f"default {default}")
    return f"{option.text} ({'; '.join(notes)})" if notes else option.text


def _metavar(option: Option) -> str:
    if option.many or option.series:
        return "A,B,..."
    return "N" if option.kind is int else option.name.upper()


DEFAULTS = {"grid": {"algo": ("gpc",)}, "tune": {"algo": ("gpc",), "seeds": (16,)}}
"""Where a command has other defaults than the table of options."""


_JSON = Flag("--json", "in lines of JSON, for programs")
_WHERE = Flag(
    "--where",
    "which run of a run folder, by a column of its rows; may be given several times",
    "COLUMN=VALUE",
    "COLUMN=VALUE",
    repeated=True,
)


def _sweep(name: str) -> Command:
    switches = (
        Flag("--dry-run", "check all, say how many cells, run nothing"),
        Flag("--live", "keep report.html and its figures fresh while it runs"),
        Flag("--quick", "with the settings of the file's table [quick]"),
        _JSON,
    )
    own = Flag(
        "--set",
        "a setting of a learner or teacher of one's own, by its name; may be given several times",
        "NAME=A,B,...",
        value="NAME=VALUE",
        repeated=True,
    )
    groups = tuple((title, tuple(_flag(option, name) for option in options)) for title, options in _GROUPS)
    text = "a file with these names as keys; flags win"
    return Command(_TEXTS[name], (*groups, ("", (own, *switches))), word="TOML", word_text=text)


def _tune() -> Command:
    """A sweep's settings, and where to look for which of them."""
    sweep = _sweep("tune")
    *groups, (_, (setting, *_)) = sweep.groups
    look = Flag(
        "--search",
        "where to look for a setting, by factors where its range is above zero; may be given several times",
        "NAME=LOW:HIGH",
        value="NAME=LOW:HIGH or NAME=A,B,C",
        repeated=True,
    )
    flags = tuple(
        Flag(f"--{name.replace('_', '-')}", own.help, own.metavar, str(own.allowed))
        for name, own in FLAGS.items()
    )
    switches = tuple(
        flag
        for _, flags in sweep.groups[-1:]
        for flag in flags
        if flag.name in ("--dry-run", "--quick", "--json")
    )
    text = "a file of a sweep's settings, with a table [tune] of these flags and [tune.search]; flags win"
    return replace(
        sweep,
        groups=(("search", (look, *flags, _WHERE)), *groups, ("", (setting, *switches))),
        word_text=text,
    )


def _teach() -> Command:
    """What a person teaches has one learner, with one value of each setting."""

    def alone(option: Option) -> Flag:
        return replace(_flag(option, "teach"), metavar=option.name.upper())

    names = {
        "env": OPTIONS["env"],
        "algo": OPTIONS["algo"],
        "oracle": OPTIONS["oracle"],
        "out": OPTIONS["out"],
    }
    flags = {name: alone(option) for name, option in names.items()}
    algo = f"{names['algo'].text} ({names['algo'].allowed}; default gpc, or gpc-ns on a task without values for it)"
    whose = f"whose mean return is drawn as a line ({names['oracle'].allowed})"
    lesson = (
        flags["env"],
        replace(flags["algo"], text=algo),
        Flag("--seed", "of the starts, as in a sweep (default 0)", "SEED", str(SEED)),
        Flag("--repeat", "advices a second while a key is held (default 8)", "REPEAT", str(REPEAT)),
        Flag("--speed", "times real time (default 1)", "SPEED", str(SPEED)),
        replace(flags["oracle"], text=whose),
        Flag(
            "--from",
            "what to begin with: OUT/saves/NAME of another folder, or a run folder with kept states",
            "FOLDER",
            _FOLDER,
        ),
        _WHERE,
        replace(
            flags["out"],
            text="folder that keeps it, or has kept it and goes on (default runs/taught-ENV-NUMBER)",
        ),
        Flag(
            "--host",
            "listens on this address; beyond 127.0.0.1 with a token (default 127.0.0.1)",
            "HOST",
            "an address",
        ),
        Flag("--port", "on this port (default the first from 8765 on that is free)", "PORT", str(PORT)),
    )
    settings = tuple(map(alone, OF_LEARNERS))
    return Command(
        _TEXTS["teach"],
        (
            ("lesson", lesson),
            ("hyperparameters of the learners", settings),
            ("how a learner reckons with late advice", tuple(map(alone, OF_CREDIT))),
            (
                "",
                (
                    Flag(
                        "--set",
                        "a setting of a learner of one's own",
                        "NAME=VALUE",
                        "NAME=VALUE",
                        repeated=True,
                    ),
                ),
            ),
        ),
    )


def _compare() -> Command:
    flags = (
        Flag(
            "--by",
            "settings in which runs may differ that have no partner of the same settings (default: the one in which "
            "the folders differ, if it is one and has one value in each)",
            "A,B,...",
            "names of settings",
        ),
        Flag("--out", f"folder of the comparison ({_FOLDER}; default runs/compare-NAMES)", "OUT", _FOLDER),
    )
    return Command(
        _TEXTS["compare"],
        (("", flags),),
        word="FOLDER",
        word_text="run folders of one task, two or more",
        needed=True,
        several=True,
    )


def _merge() -> Command:
    out = f"the run folder of the whole ({_FOLDER}; default the one FOLDER that holds all shards)"
    return Command(
        _TEXTS["merge"],
        (("", (Flag("--out", out, "OUT", _FOLDER), _JSON)),),
        word="FOLDER",
        word_text="run folders of shards, or folders with a folder of them (OUT of the sweep)",
        needed=True,
        several=True,
    )


def _play() -> Command:
    flags = (
        Flag(
            "--seed",
            "of the run, and of the starts (default: of the run that returned most; 0)",
            "SEED",
            str(SEED),
        ),
        _WHERE,
        Flag("--env", "the task, in place of the one that the folder names", "ENV", _ENVS),
        Flag("--episodes", "how many (default 1)", "N", "a number"),
        Flag("--speed", "times real time (default 1)", "SPEED", "a number"),
        Flag(
            "--seconds",
            "of each episode that are shown (default all of it; 20 in a GIF)",
            "SECONDS",
            "a number",
        ),
        Flag(
            "--gif",
            "the GIF that is written (default: where a window can be opened, none; elsewhere runs/play-NAME.gif)",
            "FILE",
            "a path that ends in .gif",
        ),
    )
    text = "run folder with kept policies or states, folder of a saved policy or learner, or ENV:EXPERT"
    return Command(_TEXTS["play"], (("", flags),), word="OUT", word_text=text, needed=True)


_TEXTS = {
    "sweep": "teach every combination of learner, error rate and seed, then report",
    "grid": "the same over lists of hyperparameters, with a heatmap",
    "tune": "search for hyperparameters, and judge the best on other seeds",
    "report": "draw a run folder's table and figures again",
    "compare": "compare run folders, run by run of the same seed",
    "merge": "put the shards of a sweep together, when all are there, then report",
    "oracles": "learn the shipped oracles again",
    "reproduce": "run the experiments of the thesis, and say what becomes of its claims",
    "teach": "teach a policy by hand, in the browser",
    "play": "show a policy in a window, or as an animated GIF",
    "replay": "make what was taught by hand again, and see whether it comes to the same",
    "runs": "list run folders, and how far they are",
    "show": "say what a run folder holds, and check all of it",
    "version": "print the version",
}
COMMANDS = {
    "sweep": _sweep("sweep"),
    "grid": _sweep("grid"),
    "tune": _tune(),
    "report": Command(
        _TEXTS["report"], (("", (_JSON,)),), word="OUT", word_text="the run folder", needed=True
    ),
    "compare": _compare(),
    "merge": _merge(),
    "oracles": Command(
        _TEXTS["oracles"],
        (("", (Flag("--env", f"{_ENVS}, comma list (default: each)", "ENV", _ENVS),)),),
    ),
    "reproduce": Command(
        _TEXTS["reproduce"],
        (
            (
                "",
                (
                    Flag("--only", f"parts ({_PARTS}; default all)", "A,B,...", _PARTS),
                    Flag("--quick", "few short runs of each experiment"),
                    Flag(
                        "--out",
                        f"folder of all runs and the report (default {folder(quick=False)})",
                        "OUT",
                        _FOLDER,
                    ),
                    Flag(
                        "--sweeps",
                        "folder of the TOML files (default: those of the package)",
                        "SWEEPS",
                        _FOLDER,
                    ),
                    Flag("--jobs", _help(OPTIONS["jobs"], "reproduce"), "N", str(OPTIONS["jobs"].allowed)),
                    Flag("--dry-run", "check all, run nothing"),
                ),
            ),
        ),
    ),
    "teach": _teach(),
    "play": _play(),
    "replay": Command(_TEXTS["replay"], word="OUT", word_text="a folder of gpcjax teach", needed=True),
    "runs": Command(
        _TEXTS["runs"],
        (("", (_JSON,)),),
        word="FOLDER",
        word_text="the folder that holds them (default runs)",
    ),
    "show": Command(_TEXTS["show"], (("", (_JSON,)),), word="OUT", word_text="the run folder", needed=True),
    "version": Command(_TEXTS["version"]),
}

STATUSES = """exit status:
  0    done
  1    the run failed: a full disk, too little memory, a process that was killed; what is finished is kept
  2    a mistake in the command, a file of settings or a folder; nothing was run
  130, 143, 129
       stopped by Ctrl-C, SIGTERM, SIGHUP; what is finished is kept, the same command goes on from there
  141  nobody reads the output any more
"""


def build() -> argparse.ArgumentParser:
    """The parser of all commands, for its help."""
    return _parsers()[""]


def _parsers() -> dict[str, argparse.ArgumentParser]:
    """That of each command by its name, and under no name that of all."""
    parser = argparse.ArgumentParser(
        prog="gpcjax",
        description="Teach controllers by corrective advice, many at once.",
        epilog=STATUSES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    parsers = {"": parser}
    for name, command in COMMANDS.items():
        text = command.text
        usage = (
            f"gpcjax {name} [{command.word}] [--FLAG VALUE ...]"
            if name in ("sweep", "grid", "tune")
            else None
        )
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".", usage=usage)
        if command.word:
            nargs = "+" if command.several else None if command.needed else "?"
            sub.add_argument(command.word.lower(), nargs=nargs, metavar=command.word, help=command.word_text)
        for title, flags in command.groups:
            group = sub.add_argument_group(title) if title else sub
            for flag in flags:
                if flag.metavar:
                    action = "append" if flag.repeated else "store"
                    group.add_argument(flag.name, action=action, metavar=flag.metavar, help=flag.text)
                else:
                    action = argparse.BooleanOptionalAction if flag.negative else "store_true"
                    group.add_argument(flag.name, action=action, help=flag.text)
        parsers[name] = sub
    return parsers


def _help_and_end(name: str) -> NoReturn:
    print(_parsers()[name].format_help(), end="", flush=True)
    raise SystemExit(0)


def parse_words(words: Sequence[str]) -> argparse.Namespace:
    """Read the words after `gpcjax`: `command`, the command's word, and a value for each of its flags.

    Values stay texts; a switch is true or false, and one with a negative None where neither was given. `--help` and
    `--version` print and end the process.

    Raises:
        UserError: a command or flag that is not known (with the nearest one), a flag given twice, or a value too few
            or too many.
    """
    first, *rest = words
    if first in ("-h", "--help"):
        _help_and_end("")
    if first == "--version":
        return argparse.Namespace(command="version")
    if first.startswith("-"):
        raise UserError("COMMAND is missing: see gpcjax --help")
    if first not in COMMANDS:
        near = suggestion(first, COMMANDS)
        raise UserError(f"{shown(first)} is no command{near}: give {', '.join(COMMANDS)}")
    before_dashes = rest[: rest.index("--")] if "--" in rest else rest
    if "--help" in before_dashes or "-h" in before_dashes:
        _help_and_end(first)
    command = COMMANDS[first]
    values = _read(first, command, rest)
    return argparse.Namespace(command=first, **values)


def _read(name: str, command: Command, words: Sequence[str]) -> dict[str, str | bool | list[str] | None]:
    """The command's values by key, from the words behind its name."""
    values: dict[str, str | bool | list[str] | None] = {
        flag.key: flag.default if flag.metavar or flag.negative else False for flag in command.flags
    }
    several: dict[str, list[str]] = {flag.key: [] for flag in command.flags if flag.repeated}
    values |= several
    if command.word:
        values[command.word.lower()] = None
    meaning = {flag.name: (flag, True) for flag in command.flags}
    meaning |= {f"--no-{flag.name[2:]}": (flag, False) for flag in command.flags if flag.negative}
    given: set[str] = set()

    def keep(key: str, said: str, value: str | bool) -> None:
        if key in given:
            raise UserError(f"{said} is given twice: give it once")
        given.add(key)
        values[key] = value

    left, only_words = list(reversed(words)), False
    while left:
        word = left.pop()
        if word == "--" and not only_words:
            only_words = True
        elif only_words or not word.startswith("-") or word == "-":
            if not command.word or (command.word.lower() in given and not command.several):
                raise UserError(f"{shown(word)} is one value too many: see gpcjax {name} --help")
            if not word.strip():
                raise UserError(f"{command.word} {shown(word)}: an empty value, give {command.word_text}")
            if command.several:
                several.setdefault(command.word.lower(), []).append(word)
                given.add(command.word.lower())
            else:
                keep(command.word.lower(), shown(word), word)
        else:
            said, equals, value = word.partition("=")
            if said not in meaning:
                near = suggestion(said, command.names)
                raise UserError(f"{shown(said)} is no flag{near}: give {', '.join(command.names)}")
            flag, on = meaning[said]
            if not flag.metavar:
                if equals:
                    raise UserError(f"{said} {shown(value)}: a switch takes no value, give {said} alone")
                keep(flag.key, said, on)
                continue
            if not equals:
                if not left or _is_flag(left[-1]):
                    raise UserError(f"{said} has no value: give {flag.value}")
                value = left.pop()
            if not value.strip():
                raise UserError(f"{said} {shown(value)}: an empty value, give {flag.value}")
            if flag.repeated:
                several[flag.key].append(value)
            else:
                keep(flag.key, said, value)
    values |= several
    if command.needed and command.word.lower() not in given:
        raise UserError(f"{command.word} is missing: see gpcjax {name} --help")
    return values


def _is_flag(word: str) -> bool:
    """Whether a word is a flag and no value: `-0.1,0.2` and `-inf` are values."""
    return word.startswith("--") or word == "-h"


def settings(arguments: argparse.Namespace) -> dict[str, Given | Unchecked]:
    """The options given as flags, each checked alone; those of --set that nobody here knows are left to `make_spec`."""
    given: dict[str, Given | Unchecked] = {}
    for option in OPTIONS.values():
        value = getattr(arguments, option.name, None)
        if value is not None:
            checked = value if option.kind is bool else parse(option, value, option.flag)
            given[option.name] = Given(checked, option.flag)
    for word in arguments.set:
        key, equals, text = word.partition("=")
        name, source = key.strip().replace("-", "_"), f"--set {key.strip()}"
        if not equals or not name.isidentifier():
            raise UserError(f"--set {shown(word)}: give NAME=VALUE, or NAME=A,B for several values")
        if name in given:
            raise UserError(f"{source} is given twice: give it once")
        option = OPTIONS.get(name)
        if option is None:
            given[name] = Unchecked(text, source, key.strip())
        elif option.kind is bool:
            raise UserError(
                f"{source}: a switch takes no value, give {option.flag} or --no-{option.flag[2:]}"
            )
        else:
            given[name] = Given(parse(option, text, source), source)
    return given
