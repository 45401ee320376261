"""What a command prints reaches every terminal, file and pipe, whatever they can take. Standard library only."""

import codecs
import os
import sys

ASCII = {
    letter: plain
    for letters, plain in (
        ("\u00b1", "+/-"),
        ("\u2013\u2014\u2212", "-"),  # dashes and the minus sign
        ("\u2026", "..."),
        ("\u00d7", "x"),
        ("\u00b7\u2022\u2605", "*"),  # dots and a star
        ("\u2264", "<="),
        ("\u2265", ">="),
        ("\u2500\u2501\u2550\u254c\u254d\u2574\u2576\u2578\u257a", "-"),  # lines of tables and bars
        ("\u2502\u2503\u2551", "|"),
    )
    for letter in letters
}
"""What stands for a character where an encoding lacks it; all else becomes an escape."""


def make_printable() -> None:
    """Have stdout and stderr take every text, for a process that is this program alone.

    A stream that was closed by the caller of the process becomes one that leads nowhere: its descriptor must not be
    given to the next file that is opened. Characters that an encoding lacks are replaced.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest one that is free, which is this one
    codecs.register_error("gpcjax", _replaced)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  (for as long as the process lives)
        else:
            stream.reconfigure(errors="gpcjax")


def leave(stream_name: str) -> None:
    """Let a stream that can take no more lead nowhere, so that the end of the process does not fail on it."""
    stream = getattr(sys, stream_name)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    """The handler of `codecs`: what stands in the place of characters that cannot be written."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(ASCII.get(letter) or _escaped(letter) for letter in lacking), error.end


def _escaped(letter: str) -> str:
    return letter.encode("ascii", "backslashreplace").decode()
