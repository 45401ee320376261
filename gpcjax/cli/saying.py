"""What the command line says on stderr: one line, whatever happens to the stream. Standard library only."""

import sys

from gpcjax.streams import leave


def show(traceback: str) -> None:
    """Somebody else's traceback, as it is."""
    try:
        print(traceback, end="", file=sys.stderr, flush=True)
    except OSError:  # as below
        leave("stderr")


def tell(message: str, status: int) -> int:
    """Say it in one line on stderr, whatever characters a person's value held, and give back `status`."""
    line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in message)
    try:
        print(f"gpcjax: {line}", file=sys.stderr, flush=True)
    except OSError:  # nobody can be told; the status says it
        leave("stderr")
    return status
