"""What of a run is kept beside its rows, and when: its policy, or all that it learned. Loads no jax."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
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

    @property
    def flags(self) -> list[str]:
        """As the words of a command line."""
        return ["--keep", self.what, *([] if self.when == "last" else ["--keep-at", str(self.when)])]


ENTRY = "keeping"
"""Of a manifest: what of its runs is kept, null for nothing. Those of 0.2 and before have none."""


def as_json(keeping: Keeping | None) -> dict[str, Any] | None:
    """For a manifest."""
    return None if keeping is None else asdict(keeping)


def held_keeping(manifest: Mapping[str, Any]) -> Keeping | None:
    """What of the runs of a folder is kept, by a manifest that has an `ENTRY`.

    Raises:
        ValueError: the entry is damaged.
    """
    match manifest[ENTRY]:
        case None:
            return None
        case {"what": "policies" | "states" as what, "every": int(every), "best": bool(best)} if every >= 0:
            return Keeping(what, every, best)
    raise ValueError(ENTRY)


def words_of(keeping: Keeping | None) -> str:
    """In a sentence."""
    if keeping is None:
        return "nothing"
    when = "best" if keeping.best else "last"
    every = f"{keeping.every} episodes and the last" if keeping.every > 1 else "episode"
    return f"{keeping.what} after {f'every {every}' if keeping.every else f'the {when} episode'}"


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
