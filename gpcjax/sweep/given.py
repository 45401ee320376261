"""Values as they were given, with where they stood: on a command line, in a file, in Python. Loads no jax."""

from typing import Any, NamedTuple

from gpcjax.errors import UserError
from gpcjax.sweep.options import Option, accept, parse


class Given(NamedTuple):
    """A checked value and where it stood, for messages: "--error", or "a.toml: error"."""

    value: Any
    source: str


class Unchecked(NamedTuple):
    """A value of a setting that only a learner or a teacher of the sweep can know: `make_spec` asks them."""

    value: Any
    source: str
    key: str
    """As it was written."""
    counts: bool = True
    """Whether it is a setting of this sweep, and not one of a table that is not used."""
    is_word: bool = False
    """Whether it is a text of a command line, which stands for numbers."""


class Said(Given):
    """What is checked as that of the built-in learners and teachers, whose name another one's setting may have, too."""

    unchecked: Unchecked | None = None
    """The same as it came: others have bounds of their own."""


def said(setting: Unchecked, option: Option) -> Given | Unchecked:
    """A setting of a name that built-in learners or teachers have; not checked where theirs would be refused."""
    try:
        given = Said(checked_as(option, setting), setting.source)
    except UserError:
        return setting
    given.unchecked = setting
    return given


def checked_as(option: Option, setting: Unchecked) -> Any:
    """Its value, by the bounds of an option."""
    return (parse if setting.is_word else accept)(option, setting.value, setting.source)
