"""Flags and commands as data, made from the table of options. Standard library only."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gpcjax.allowed import Anything
from gpcjax.sweep.options import Option


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
    hidden: bool = False
    """Whether it is read and not offered: a message says why the command has none."""

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
    parts: "Mapping[str, Command]" = field(default_factory=dict)
    """Commands of its own, by the word that is given first; then it has nothing else."""

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Of all groups."""
        return tuple(flag for _, flags in self.groups for flag in flags)

    @property
    def names(self) -> list[str]:
        """All flags as they are written, for messages."""
        offered = [flag for flag in self.flags if not flag.hidden]
        names = [flag.name for flag in offered]
        return [*names, *(f"--no-{flag.name[2:]}" for flag in offered if flag.negative), "--help"]


def flag_of(option: Option, command: str) -> Flag:
    """The flag that an option is for a command."""
    return Flag(
        option.flag,
        help_of(option, command),
        metavar="" if option.kind is bool else _metavar(option),
        value=str(option.allowed),
        negative=option.kind is bool,
    )


def help_of(option: Option, command: str) -> str:
    """What an option is, what it may be, and what holds without it."""
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


JSON = Flag("--json", "in lines of JSON, for programs")
WHERE = Flag(
    "--where",
    "which run of a run folder, by a column of its rows; may be given several times",
    "COLUMN=VALUE",
    "COLUMN=VALUE",
    repeated=True,
)
