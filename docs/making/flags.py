"""Writes the page of the command line, from the tables that make its flags, its help and its messages."""

import re

from gpcjax.cli.commands import COMMANDS
from gpcjax.cli.flags import Command, Flag
from gpcjax.cli.words import STATUSES

INTRODUCTION = """# The command line

`gpcjax COMMAND [WORD] [--FLAG VALUE ...]`; `make` has the same commands with variables in the place of the usual flags
(`make help`). Every flag of a sweep is also a key of a TOML file and an argument of [`gpcjax.run_sweep`](sweeps.md),
with underscores in the place of dashes. `A,B,...` is a comma list: each combination is run. Without a hyperparameter
the values of the thesis hold (Tables 5.1 to 5.3). This page is made from the tables that the program itself reads."""


def page() -> str:
    """The whole page, in Markdown."""
    overview = _table(
        ("command", ""), ((f"[`{name}`](#gpcjax-{name})", command.text) for name, command in COMMANDS.items())
    )
    commands = (
        _command(words, command)
        for name, one in COMMANDS.items()
        for words, command in ((name, one), *((f"{name} {part}", each) for part, each in one.parts.items()))
    )
    return "\n\n".join([INTRODUCTION, overview, *commands, "## Exit status", _statuses()]) + "\n"


def _command(name: str, command: Command) -> str:
    blocks = [f"## gpcjax {name}", f"{command.text[0].upper()}{command.text[1:]}."]
    if command.word:
        word = f"{command.word} ..." if command.several else command.word
        blocks.append(f"`{word if command.needed else f'[{word}]'}`: {_cell(command.word_text)}.")
    for title, flags in command.groups:
        if title:
            blocks.append(f"**{title[0].upper()}{title[1:]}**")
        blocks.append(
            _table(("flag", ""), ((_written(flag), flag.text) for flag in flags if not flag.hidden))
        )
    return "\n\n".join(blocks)


def _written(flag: Flag) -> str:
    if flag.metavar:
        return f"`{flag.name} {flag.metavar}`"
    return f"`{flag.name}`, `--no-{flag.name[2:]}`" if flag.negative else f"`{flag.name}`"


def _statuses() -> str:
    """Those that the help tells."""
    entries = re.findall(r"^  (\d+(?:, \d+)*)\s+(\S.*)$", STATUSES, re.MULTILINE)
    return _table(("status", ""), entries)


def _table(head, rows) -> str:
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return "\n".join([*lines, *(f"| {' | '.join(map(_cell, row))} |" for row in rows)])


def _cell(text: str) -> str:
    """A text within a table: what would end a cell or begin a tag is written out."""
    return text.replace("|", "\\|").replace("<", "&lt;")
