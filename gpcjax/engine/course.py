"""The course of a session: its settings, where it stands, and what is written down of it as it happens."""

import contextlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gpcjax.allowed import NON_NEGATIVE, POSITIVE, Numbers, checked
from gpcjax.engine.desk import Desk
from gpcjax.engine.history import Credit
from gpcjax.errors import UserError
from gpcjax.recording import Recording

LATE = ("credit", "credit_longest", "credit_shape")
"""The settings that say how a session reckons with late advice; None of all where advice is about the latest step."""

_NUMBERS = {
    **dict.fromkeys(LATE[:2], (float, NON_NEGATIVE)),
    "credit_shape": (float, POSITIVE),
    "time_step": (float, POSITIVE),
    "seed": (int, Numbers(0, 2**63 - 1, whole=True)),
    "undos": (int, Numbers(0, 1_000, whole=True)),
}

SETTINGS = frozenset(_NUMBERS)
"""What a session is begun with, beside its learner."""

ROOMS = "rooms"
"""The setting that a session in a classroom has beside: the room of its dictionaries, as it grows."""


def checked_settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a session, each of its kind. Raises UserError: one is not; the message names it."""
    return {
        name: None if name in LATE and given[name] is None else checked(name, given[name], *kind)
        for name, kind in _NUMBERS.items()
    }


def credit_of(settings: Mapping[str, Any]) -> Credit | None:
    """How a session with these settings reckons with late advice. Raises UserError: they do not fit together."""
    return Credit.of(*(settings[name] for name in (*LATE, "time_step")))


class Course:
    """Where a session stands.

    Args:
        desk: at which its learner sits.
        settings: as `checked_settings` gives them, and `ROOMS` of a session in a classroom.
    """

    def __init__(self, desk: Desk, settings: Mapping[str, Any]):
        self.desk, self.settings = desk, dict(settings)
        self.begun = self.begins = False
        """Whether there was a step, and whether the next one begins an episode."""
        self.proposed = np.zeros_like(desk.action)
        """The action at the latest step before it was clipped, (action_size,)."""
        self.corrections = 0
        self.latest: tuple[list[float], list[float]] = [], []
        """Observation and action as they were when the latest step was proposed."""
        self._recording: Recording | None = None
        self._since = time.monotonic()

    @property
    def episode(self) -> int:
        """Of the latest step, from 0."""
        return self.desk.episode

    @property
    def step(self) -> int:
        """The latest step of the episode, from 0; -1 before the first."""
        return self.desk.time if self.begun else -1

    @property
    def idles(self) -> bool:
        """Whether the learner is to go on by itself before the next step."""
        return self.begun and self.desk.idle_is_due

    @property
    def flags(self) -> tuple[bool, bool]:
        """Whether the next step is the first of an episode, and of another one than before."""
        return self.begins or not self.begun, self.begun and self.begins

    def check_begun(self) -> None:
        """Raises UserError: no step of this episode has begun."""
        if not self.begun or self.begins:
            raise UserError("no step of this episode has begun: call propose first")

    def stepped(self, obs: list[float], proposed: Float[np.ndarray, " action"], action: list[float]) -> None:
        """What was proposed at the step that the desk has come to, before and after it was clipped."""
        self.begun, self.begins = True, False
        self.proposed = proposed
        self.latest = obs, action
        self.keep("propose", obs=obs, action=action)

    def place(self) -> dict[str, Any]:
        """Where it stands, as JSON knows it: all that is neither settings nor the learner's state."""
        own = {"begun": self.begun, "begins": self.begins, "corrections": self.corrections}
        return {**self.desk.place(), **own}

    def move(self, place: Mapping[str, Any]) -> None:
        """To a place that `place` gave. Raises KeyError, TypeError or ValueError for another one."""
        self.desk = self.desk.placed(place)
        self.begun, self.begins = bool(place["begun"]), bool(place["begins"])
        self.corrections = int(place["corrections"])

    def record(self, recording: Recording) -> None:
        """Every event from now on goes into a file, which was begun with these settings and this place."""
        self._recording = recording

    def keep(self, event: str, **values: Any) -> None:
        """Writes an event down, if the session is recorded. Raises UserError: it cannot be written."""
        if self._recording is not None:
            now = round(time.monotonic() - self._since, 4)
            place = {"episode": self.episode, "step": self.step, "time": now}
            self._recording.append({"event": event, **place, **values})

    def flush(self) -> None:
        """Has the recording on the disk. Raises UserError: it cannot be written."""
        if self._recording is not None:
            self._recording.flush()

    @contextlib.contextmanager
    def recorded(self) -> Iterator[None]:
        """What cannot be written down has not happened."""
        before = dict(vars(self))
        try:
            yield
        except UserError:
            vars(self).update(before)
            raise
