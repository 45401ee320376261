"""What a participant's page is told of a lesson: nothing that tells the learner. Standard library only.

What is told is listed; all else that a message has stays here: the learner's name and settings, its learning rate, the
number of its points, its doubt where there is no cue, folders, and texts of problems.
"""

from collections.abc import Mapping
from typing import Any

TOLD: Mapping[str, tuple[str, ...]] = {
    "task": ("task", "repeat", "corrections"),
    "ready": (),
    "state": ("mode", "paused", "why"),
    "frame": ("n", "episode", "step", "obs", "action", "total"),
    "advised": ("id", "n", "episode", "step", "dim", "h", "before", "after", "corrections"),
    "episode": ("index", "total", "steps", "corrections", "mode", "why"),
}
CUE = ("sigma", "prior")
"""What frames have beside where there is a cue."""

PROBLEM = "There is a technical problem. The experimenter has been told; please wait a moment."


def blinded(message: Mapping[str, Any], cue: bool) -> dict[str, Any] | None:
    """A message of a lesson for a participant's page; None if it is not for one."""
    kind = message["type"]
    if kind == "problem":
        return {"type": "problem", "text": PROBLEM}
    if kind not in TOLD:
        return None
    told = {name: message[name] for name in TOLD[kind] if name in message}
    if kind == "frame":
        told |= {name: message.get(name) if cue else None for name in CUE}
    return {"type": kind, **told}
