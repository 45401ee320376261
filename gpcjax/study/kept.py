"""What is kept of a participant, and the states in which one can be. Standard library only."""

from dataclasses import dataclass, field
from typing import Any

ACTIVE, COMPLETE = "active", "complete"
ENDED = {
    COMPLETE: "all steps are done",
    "declined": "left the study",
    "failed": "did not pass the check or the trial",
    "stopped": "was stopped by the experimenter",
    "expired": "did not come back in time",
}
"""The states in which a participant does nothing any more. Only a complete one keeps the slot."""


@dataclass
class Kept:
    """What participant.json says, beside what follows from the study."""

    number: int
    code: str
    slot: int
    state: str = ACTIVE
    why: str = ""
    """Of the end, in words."""
    step: int = 0
    """Index of the present step."""
    begun: str = ""
    seen: str = ""
    """When he or she last did anything."""
    ended: str = ""
    times: list[dict[str, str]] = field(default_factory=list)
    """Of each step so far its `step`, `began`, `ended`."""
    checks: list[dict[str, Any]] = field(default_factory=list)
    """What was measured of screen and connection, each time."""
    trials: list[bool] = field(default_factory=list)
    """Whether each attempt at the trial was passed."""
    answers: list[dict[str, Any]] = field(default_factory=list)
    """Each with `question`, `run` (or null), `letter`, `task`, `value`, `at`."""
