"""What a person's teaching comes to, episode by episode, as the rows of a sweep have it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gpcjax.engine.lanes import LOGGED_CORRECTIONS
from gpcjax.engine.session import Session
from gpcjax.learners.base import Info, Status
from gpcjax.teach.credit import Credited

NOW = Credited()
"""Advice is about the present step."""


@dataclass
class Episode:
    """One episode, under way or over."""

    total: float = 0.0
    """Sum of its rewards."""
    length: int = 0
    corrections: int = 0
    rate_sum: float = 0.0
    clipped: int = 0
    full: int = 0
    points: tuple[int, int] = (0, 0)
    own: dict[str, float] = field(default_factory=dict)
    why: str = ""
    """Why it ended: "over", "reset", "time" of a study's run, or "problem" of a task that failed."""
    obs: list[list[float]] = field(default_factory=list)
    """At each of its steps."""
    actions: list[list[float]] = field(default_factory=list)


@dataclass
class _Advice:
    """What one advice counted, so that it can be taken back."""

    episode: int
    corrections: int
    rate_sum: float
    full: int
    logged: int
    obs: list[float] | None
    """What it was about, if there was such a step."""


class Tally:
    """Hears every event of a session, live or replayed, and counts.

    Args:
        credited: which steps advice is about.
    """

    def __init__(self, credited: Credited = NOW) -> None:
        self._credited = credited
        self.finished: list[Episode] = []
        self.present = Episode()
        self._advice: list[_Advice] = []
        self._log: list[tuple[tuple[int, int, int], tuple[float, ...], tuple[bool, ...]]] = []

    def hear(self, session: Session, event: Mapping[str, Any], outcome: Any) -> None:
        """Counts one event of a session, and what its method gave."""
        match event:
            case {"event": "propose"}:
                obs, action = session.latest
                self.present.obs.append(obs)
                self.present.actions.append(action)
                self.present.clipped += bool((np.abs(session.proposed) > 1.0).any())
            case {"event": "advise", "advice": advice}:
                self._learned(session, outcome, np.asarray(advice))
            case {"event": "undo"} if outcome and self._advice:
                last = self._advice.pop()
                episode = self._episode(last.episode)
                episode.corrections -= last.corrections
                episode.rate_sum -= last.rate_sum
                episode.full -= last.full
                del self._log[len(self._log) - last.logged :]
            case {
                "event": "note",
                "values": {"ended": str(why), "total": float(total), "length": int(length)},
            }:
                self.present.total, self.present.length, self.present.why = total, length, why
                self.present.points, self.present.own = session.points, session.measure()
                # The step that the episode ended before was proposed and never executed.
                if self.finished:  # of the first alone the steps are shown again
                    self.present.obs, self.present.actions = [], []
                self.finished.append(self.present)
                self.present = Episode()

    @property
    def corrections(self) -> int:
        """In all, of each action dimension, without what was taken back."""
        return sum(episode.corrections for episode in [*self.finished, self.present])

    @property
    def latest_rate(self) -> float | None:
        """The learning rate of the latest advice that was not taken back; None without one."""
        return self._log[-1][1][0] if self._log else None

    def places(self) -> list[list[float]]:
        """The observations about which advice was given that was not taken back."""
        return [advice.obs for advice in self._advice if advice.obs is not None]

    def measurements(self) -> dict[str, np.ndarray]:
        """Of the finished episodes, as `gpcjax.engine.lanes.EpisodeRows` has them; `whole`: the task ended it."""
        done = self.finished
        none = np.zeros(len(done), int)
        return {
            "returns": np.array([each.total for each in done], float),
            "length": np.array([each.length for each in done], int),
            "corrections": np.array([each.corrections for each in done], int),
            "rate_sum": np.array([each.rate_sum for each in done], float),
            "policy_points": np.array([each.points[0] for each in done], int),
            "human_points": np.array([each.points[1] for each in done], int),
            "clipped": np.array([each.clipped for each in done], int),
            "full": np.array([each.full for each in done], int),
            "asked": none,  # nobody knows when a person could have advised
            "chance_sum": none.astype(float),
            "whole": np.array([each.why == "over" for each in done], bool),
        }

    def own(self) -> dict[str, np.ndarray]:
        """What the learner measures of itself, likewise."""
        names = self.finished[0].own if self.finished else ()
        return {name: np.array([each.own[name] for each in self.finished]) for name in names}

    def log(self) -> dict[str, np.ndarray]:
        """The first corrections of the finished episodes, as `CorrectionLog` has them."""
        kept = [entry for entry in self._log if entry[0][0] < len(self.finished)][:LOGGED_CORRECTIONS]
        moments, values, outcome = zip(*kept, strict=True) if kept else ((), (), ())
        return {
            "moments": np.array(moments, int).reshape(-1, 3),
            "values": np.array(values, float).reshape(-1, 3),
            "outcome": np.array(outcome, bool).reshape(-1, 3),
        }

    def about(self) -> list[float]:
        """The observation of the present episode that advice is shown to be about now."""
        return self.present.obs[max(0, len(self.present.obs) - 1 - self._credited.back)]

    def _episode(self, index: int) -> Episode:
        return self.finished[index] if index < len(self.finished) else self.present

    def _learned(self, session: Session, info: Info, advice: np.ndarray) -> None:
        rate, sigma_policy, sigma_human, appended, replaced, full = (
            np.asarray(getattr(info, name))
            for name in ("rate", "sigma_policy", "sigma_human", "appended", "replaced", "full")
        )
        learned = (advice != 0) & (rate > 0) & (int(np.asarray(info.status)) == Status.OK)
        values = np.stack([rate, sigma_policy, sigma_human], axis=-1)
        outcome = np.stack([appended, replaced, full], axis=-1)
        # Before the first step that it may be about nothing is learned, and there is nothing to tell of it.
        about = self.about() if len(self.present.obs) > self._credited.least else None
        entries = [
            ((session.episode, session.step, dim), tuple(values[dim].tolist()), tuple(outcome[dim].tolist()))
            for dim in np.flatnonzero(advice).tolist()
            if about is not None
        ]
        self._log += entries
        counted = _Advice(
            episode=len(self.finished),
            corrections=int(learned.sum()),
            rate_sum=float(rate[learned].sum()),
            full=int(full.sum()),
            logged=len(entries),
            obs=about,
        )
        self._advice.append(counted)
        self.present.corrections += counted.corrections
        self.present.rate_sum += counted.rate_sum
        self.present.full += counted.full
