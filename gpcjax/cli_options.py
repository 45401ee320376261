"""The command line's grammar, built from the table of options. Loads no jax."""

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

import gpcjax
from gpcjax.allowed import Anything, suggestion
from gpcjax.errors import UserError
from gpcjax.reproduce.parts import PARTS, folder
from gpcjax.sweep.options import EXPERIMENT, OPTIONS, RUNNING, TUNING, VARIANTS, Option, parse, shown
from gpcjax.sweep.spec import Given

COMMANDS = {
    "sweep": "teach every combination of learner, error rate and seed, then report",
    "grid": "the same over lists of hyperparameters, with a heatmap",
    "report": "draw a run folder's table and figures again",
    "oracles": "learn the shipped oracles again",
    "reproduce": "run the experiments of the thesis, and say what becomes of its claims",
    "version": "print the version",
}

_GROUPS = (
    ("experiment", EXPERIMENT),
    ("variants of GPC and GPC-NS", VARIANTS),
    ("hyperparameters (without them, the tables of the thesis)", TUNING),
    ("running", RUNNING),
)


class Parser(argparse.ArgumentParser):
    """A parser whose complaints are `UserError`s, and which knows its flags by their full names only."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Raise, where argparse would print its usage and exit."""
        if empty := re.fullmatch(r"argument --(\S+): expected one argument", message):
            option = OPTIONS.get(empty[1].replace("-", "_"))
            message = f"--{empty[1]} has no value: give {option.allowed if option else 'one'}"
        elif missing := re.fullmatch(r"the following arguments are required: (\S+)", message):
            message = f"{missing[1]} is missing: see {self.prog} --help"
        raise UserError(message)


def build() -> Parser:
    """The parser of all commands. Values of flags stay texts; switches become true or false."""
    version = f"gpcjax {gpcjax.__version__}"
    parser = Parser(prog="gpcjax", description="Teach controllers by corrective advice, many at once.")
    parser.add_argument("--version", action="version", version=version, help="print the version")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser, required=True)
    for name, text in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if name in ("sweep", "grid"):
            command.usage = f"gpcjax {name} [TOML] [--FLAG VALUE ...]"
            _add_sweep(command)
        elif name == "report":
            command.add_argument("out", metavar="OUT", help="the run folder")
        elif name == "reproduce":
            _add_reproduce(command)
        elif name == "oracles":
            command.add_argument("--env", help=f"{OPTIONS['env'].allowed}, comma list (default: each)")
    return parser


def parse_words(words: Sequence[str]) -> argparse.Namespace:
    """Read the words after `gpcjax`.

    Raises:
        UserError: a command or flag that is not known (with the nearest one), or a value too few or too many.
    """
    parser = build()
    if words and not words[0].startswith("-") and words[0] not in COMMANDS:
        near = suggestion(words[0], COMMANDS)
        raise UserError(f"{shown(words[0])} is no command{near}: give {', '.join(COMMANDS)}")
    arguments, rest = parser.parse_known_args(_joined(words))
    if rest:
        if not rest[0].startswith("-"):
            raise UserError(f"{shown(rest[0])} is one value too many: see gpcjax {arguments.command} --help")
        name, flags = rest[0].partition("=")[0], _flags(arguments.command)
        raise UserError(f"{shown(name)} is no flag{suggestion(name, flags)}: give {', '.join(flags)}")
    return arguments


def settings(arguments: argparse.Namespace) -> dict[str, Given]:
    """The options given as flags, each checked alone."""
    given = {}
    for option in OPTIONS.values():
        value = getattr(arguments, option.name)
        if value is not None:
            checked = value if option.kind is bool else parse(option, value, option.flag)
            given[option.name] = Given(checked, option.flag)
    return given


def _add_sweep(command: Parser) -> None:
    command.add_argument("toml", nargs="?", metavar="TOML", help="a file with these names as keys; flags win")
    command.add_argument("--dry-run", action="store_true", help="check all, say how many cells, run nothing")
    command.add_argument("--quick", action="store_true", help="with the settings of the file's table [quick]")
    for title, options in _GROUPS:
        group = command.add_argument_group(title)
        for option in options:
            if option.kind is bool:
                group.add_argument(option.flag, action=argparse.BooleanOptionalAction, help=_help(option))
            else:
                group.add_argument(option.flag, metavar=_metavar(option), help=_help(option))


def _add_reproduce(command: Parser) -> None:
    command.add_argument("--only", metavar="A,B,...", help=f"parts ({', '.join(PARTS)}; default all)")
    command.add_argument("--quick", action="store_true", help="few short runs of each experiment")
    command.add_argument("--out", help=f"folder of all runs and the report (default {folder(quick=False)})")
    command.add_argument("--sweeps", default="sweeps", help="folder of the TOML files (default sweeps)")
    command.add_argument("--jobs", metavar="N", help=_help(OPTIONS["jobs"]))
    command.add_argument("--dry-run", action="store_true", help="check all, run nothing")


def _help(option: Option) -> str:
    default = option.otherwise
    if option.default is not None:
        values = option.default if isinstance(option.default, tuple) else (option.default,)
        default = ",".join(str(value).removesuffix(".0") for value in values)
    notes = [] if isinstance(option.allowed, Anything) else [str(option.allowed)]
    if default:
        notes.append(f"default {default}")
    return f"{option.text} ({'; '.join(notes)})"


def _metavar(option: Option) -> str:
    if option.many:
        return "A,B,..."
    return "N" if option.kind is int else option.name.upper()


def _flags(command: str) -> list[str]:
    if command in ("sweep", "grid"):
        return [
            *(option.flag for option in OPTIONS.values()),
            "--no-sparsify",
            "--quick",
            "--dry-run",
            "--help",
        ]
    if command == "reproduce":
        return ["--only", "--quick", "--out", "--sweeps", "--jobs", "--dry-run", "--help"]
    return ["--env", "--help"] if command == "oracles" else ["--help"]


def _joined(words: Sequence[str]) -> list[str]:
    """`--error -0.1,0.2` as `--error=-0.1,0.2`: argparse takes a value that begins with a dash for a flag."""
    takes_value = {option.flag for option in OPTIONS.values() if option.kind is not bool}
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in takes_value and re.match(r"-[^-h]", word):
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined
