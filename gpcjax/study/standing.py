"""A run of a participant in words: what is to be done, how it stands, and how a page hears of it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpcjax.teach.course import Course

Say = Callable[[dict[str, Any]], None]
"""Takes a message for the page, from any thread; it must not block."""


@dataclass(frozen=True)
class Run:
    """What a participant is to do."""

    folder: Path
    """A lesson's folder; made, or gone on with if it holds a recording."""
    course: Course
    episodes: int
    """It is over after so many."""
    seconds: float | None = None
    """Time at the task, at most (pauses are not counted); None: no limit."""
    cue: bool = False
    """Whether frames carry sigma_h, the uncertainty cue."""


@dataclass(frozen=True)
class Standing:
    """How a run stands, for who looks after the study."""

    episode: int = 0
    """Index of the present one."""
    step: int = 0
    total: float = 0.0
    """Of the present episode, so far."""
    corrections: int = 0
    """In all."""
    paused: bool = True
    why: str = "preparing"
    """Why it rests: preparing, start, over, left, problem, or what `pause` was told."""
    problem: str | None = None
    """The latest."""
