"""The words of a command line, read by the grammar of its commands. Standard library only.

`argparse` prints the help. It does not read the words: it passes over a flag that is given twice, takes a value that
begins with a dash for a flag, and fails on `--error=--`.
"""

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from gpcjax.allowed import shown, suggestion
from gpcjax.cli.commands import COMMANDS
from gpcjax.cli.flags import Command
from gpcjax.errors import UserError
from gpcjax.sweep.options import OPTIONS, OWNED, parse
from gpcjax.sweep.spec import Given, Unchecked, said

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
        usage = (
            f"gpcjax {name} [{command.word}] [--FLAG VALUE ...]"
            if name in ("sweep", "grid", "tune")
            else None
        )
        parsers[name] = sub = _add(commands, name, command, usage)
        if command.parts:
            parts = sub.add_subparsers(dest="part", metavar="COMMAND")
            for word, part in command.parts.items():
                parsers[f"{name} {word}"] = _add(parts, word, part)
    return parsers


def _add(commands: Any, name: str, command: Command, usage: str | None = None) -> argparse.ArgumentParser:
    """Adds a command to those of a parser."""
    text = command.text
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".", usage=usage)
    if command.word:
        nargs = "+" if command.several else None if command.needed else "?"
        parser.add_argument(command.word.lower(), nargs=nargs, metavar=command.word, help=command.word_text)
    for title, flags in command.groups:
        group = parser.add_argument_group(title) if title else parser
        for flag in flags:
            if flag.metavar:
                action = "append" if flag.repeated else "store"
                told = argparse.SUPPRESS if flag.hidden else flag.text
                group.add_argument(flag.name, action=action, metavar=flag.metavar, help=told)
            else:
                action = argparse.BooleanOptionalAction if flag.negative else "store_true"
                group.add_argument(flag.name, action=action, help=flag.text)
    return parser


def _help_and_end(name: str) -> NoReturn:
    print(_parsers()[name].format_help(), end="", flush=True)
    raise SystemExit(0)


def parse_words(words: Sequence[str]) -> argparse.Namespace:
    """Read the words after `gpcjax`: `command`, the command's word, and a value for each of its flags.

    A command that has commands of its own has the name of the one that was given as `part`.

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
        part = f"{first} {rest[0]}"
        _help_and_end(part if rest[0] in COMMANDS[first].parts else first)
    command = COMMANDS[first]
    if command.parts:
        return _part(first, command, rest)
    return argparse.Namespace(command=first, **_read(first, command, rest))


def _part(name: str, command: Command, words: Sequence[str]) -> argparse.Namespace:
    """The same of a command that has commands of its own."""
    first, *rest = words or [""]
    if not first or first.startswith("-"):
        raise UserError(f"COMMAND is missing: give {', '.join(command.parts)}, see gpcjax {name} --help")
    if first not in command.parts:
        near = suggestion(first, command.parts)
        raise UserError(
            f"{shown(first)} is no command of gpcjax {name}{near}: give {', '.join(command.parts)}"
        )
    return argparse.Namespace(
        command=name, part=first, **_read(f"{name} {first}", command.parts[first], rest)
    )


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
        if value is not None and option.name in OWNED:
            given[option.name] = said(Unchecked(value, option.flag, option.flag, is_word=True), option)
        elif value is not None:
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
            given[name] = Unchecked(text, source, key.strip(), is_word=True)
        elif name in OWNED:
            given[name] = said(Unchecked(text, source, key.strip(), is_word=True), option)
        elif option.kind is bool:
            raise UserError(
                f"{source}: a switch takes no value, give {option.flag} or --no-{option.flag[2:]}"
            )
        else:
            given[name] = Given(parse(option, text, source), source)
    return given
