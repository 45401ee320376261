"""What of a run is kept beside its rows, and when: its policy, or all that it learned. Loads no jax."""

from dataclasses import dataclass
from typing import Any, Literal, get_args

from gpcjax.allowed import COUNT, OneOf, converted, shown
from gpcjax.errors import UserError

What = Literal["policies", "states"]
WHATS = get_args(What)
WHEN = f"last, best, or every n-th episode as {COUNT}"
"""When something is kept, for messages."""


@dataclass(frozen=True)
class Keeping:
    """What is kept of each run.

    | Field   | Meaning                                                                                     |
    |---------|---------------------------------------------------------------------------------------------|
    | `what`  | "policies", or "states": all that the learner has, from which teaching goes on               |
    | `every` | after each so many episodes, and after the last one; 0 for the last one alone               |
    | `best`  | after the episode with the highest return alone (while it was taught), of equals the first   |
    """

    what: What
    every: int = 0
    best: bool = False

    @property
    def when(self) -> str | int:
        """As a person gives it."""
        return "best" if self.best else self.every or "last"


def keeping_of(keep: Any, keep_at: Any, sources: tuple[str, str] = ("keep", "keep_at")) -> Keeping | None:
    """What these settings ask for; None where nothing is to be kept.

    Raises:
        UserError: a value that is not allowed, or a time for nothing.
    """
    if keep is None:
        if keep_at not in (None, "last"):
            raise UserError(
                f"{sources[1]} {shown(keep_at)}: nothing is kept, give --keep policies or --keep states"
            )
        return None
    if keep not in WHATS:
        raise UserError(f"{sources[0]} {shown(keep)}: give {OneOf(WHATS)}")
    if keep_at in (None, "last"):
        return Keeping(keep)
    if keep_at == "best":
        return Keeping(keep, best=True)
    text = keep_at if isinstance(keep_at, str) else None
    every = int(text) if text is not None and text.isascii() and text.isdigit() and len(text) < 9 else None
    every = converted(int, keep_at) if text is None else every
    if every is None or not COUNT.admits(every):
        raise UserError(f"{sources[1]} {shown(keep_at)}: give {WHEN}")
    return Keeping(keep, every=every)


@dataclass(frozen=True, eq=False)
class KeptRow:
    """What a run had learned at the end of an episode."""

    episode: int
    """From 1."""
    returns: float
    """Of that episode."""
    kind: str
    """"policy" or "state"."""
    card: str
    """JSON: what the arrays are, with the type and the shape of each as `arrays`."""
    arrays: bytes
    """One behind the other, in that order."""
