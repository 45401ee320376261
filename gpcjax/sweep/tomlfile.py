"""Files of settings in TOML: what they hold, as it is written, within bounds. Loads no jax."""

import re
import tomllib
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.sweep.written import Written

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


def read_file(path: Path) -> dict[str, Any]:
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


def read_table(path: Path, name: str) -> dict[str, Any]:
    """The table of this name of a TOML file, for a command that has one; empty where there is none.

    Raises:
        UserError: the file cannot be read as TOML, or the name is no table's.
    """
    table = read_file(path).get(name, {})
    if not isinstance(table, dict):
        raise UserError(f"{path}: {name} is no table: begin one with a line [{name}]")
    return table
