"""What of a run is kept beside its rows, and when: its policy, or all that it learned. Loads no jax."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

from gpcjax.allowed import COUNT, OneOf, converted, shown
from gpcjax.errors import UserError
from gpcjax.registry import built_in

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


def check_learners(keeping: Keeping | None, learners: Iterable[str], source: str = "keep") -> None:
    """Refuses to keep what somebody's own learner learns: there is no form for it.

    Raises:
        UserError: one of these is not built in.
    """
    known = built_in("learner")
    others = [name for name in learners if name not in known]
    if keeping is not None and others:
        raise UserError(
            f"{source}: what {others[0]} learns has no form in which it could be kept, "
            f"give it with {', '.join(known)} alone"
        )


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
