"""A session's learner in a classroom: the desk that it sits at, and what many of them do in one call."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from gpcjax.engine.bench import Bench
from gpcjax.engine.bench_programs import Known, Standing
from gpcjax.engine.desk import Advised, Desk
from gpcjax.engine.history import Credit
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State

if TYPE_CHECKING:
    from gpcjax.engine.classroom import Classroom


class Pupil(Desk):
    """One learner in a classroom, and where it stands: a `Desk` that moves itself."""

    def __init__(self, classroom: "Classroom", learner: Learner, seed: int, credit: Credit | None):
        self.learner, self.seed, self.credit = learner, seed, credit
        self._classroom, self.lock = classroom, classroom.lock
        self.bench: Bench
        self.lane: int
        self.known: Known
        self._episode = self._time = 0
        self._obs, self._action = np.zeros(learner.obs_size), np.zeros(learner.action_size)
        self._depth = 0 if credit is None else credit.reach
        self._past_obs = np.zeros((self._depth, learner.obs_size))
        self._past_action = np.zeros((self._depth, learner.action_size))

    @property
    def episode(self) -> int:
        return self._episode

    @property
    def time(self) -> int:
        return self._time

    @property
    def obs(self) -> Float[np.ndarray, " obs"]:
        return self._obs.copy()

    @property
    def action(self) -> Float[np.ndarray, " action"]:
        return self._action.copy()

    @property
    def idle_is_due(self) -> bool:
        every = self.learner.idle_every
        return bool(every) and (self._time + 1) % every == 0

    def idled(self) -> "Pupil":
        idle([self])
        return self

    def stepped(
        self, obs: Float[np.ndarray, " obs"], begins: bool, another: bool
    ) -> "tuple[Pupil, Float[np.ndarray, ' action'], bool]":
        ((proposed,), (finite,)) = propose([self], obs[None])
        if finite:
            self.move(obs, proposed.clip(-1.0, 1.0), begins, another)
        return self, proposed, bool(finite)

    def move(
        self,
        obs: Float[np.ndarray, " obs"],
        action: Float[np.ndarray, " action"],
        begins: bool,
        another: bool,
    ) -> None:
        """To the next step, at which this is executed."""
        if self._depth and not begins:
            place = self._time % self._depth
            self._past_obs[place], self._past_action[place] = self._obs, self._action
        self._obs, self._action = obs, action
        self._time = 0 if begins else self._time + 1
        self._episode += another

    def executed(self, action: Float[np.ndarray, " action"]) -> "Pupil":
        self._action = np.array(action)
        return self

    def advised(
        self, advice: Float[np.ndarray, " action"], about: Float[np.ndarray, " obs"] | None = None
    ) -> "tuple[Pupil, Advised]":
        with self.lock:
            while not self.known.room and self._classroom.promote(self):
                pass
            at = self._obs if about is None else about
            counts = np.array([self.lane, self.seed, self._episode, self._time])
            now = np.concatenate([self._obs, self._action, advice, at])
            learned = self.bench.correct(Standing(counts, now, self._past_obs, self._past_action))
            self.known = learned.known
        return self, Advised(learned.info, learned.corrections, learned.before, learned.after)

    def taken_back(self, before: Any) -> "Pupil":
        raise UserError("in a classroom nothing that was learned is taken back")

    def acts(self, obs: Float[np.ndarray, " obs"]) -> Float[np.ndarray, " action"]:
        return np.array(self.bench.acts_at(self.lane, obs[:, None])[:, 0])

    def acts_at(self, obs: Float[np.ndarray, "obs points"]) -> Float[np.ndarray, "action points"]:
        return np.array(self.bench.acts_at(self.lane, obs))

    def uncertain(self) -> Float[np.ndarray, " action"]:
        with self.lock:
            return self.bench.uncertain(self.lane, self._obs, self._action)

    @property
    def state(self) -> State:
        with self.lock:
            return self.bench.state(self.lane)

    @property
    def points(self) -> tuple[int, int]:
        return self.known.points

    def measured(self) -> dict[str, float]:
        return dict(self.known.measured)

    def place(self) -> dict[str, Any]:
        history = None
        if self._depth:
            history = {"obs": self._past_obs.tolist(), "action": self._past_action.tolist()}
        return {
            "episode": self._episode,
            "time": self._time,
            "obs": self._obs.tolist(),
            "action": self._action.tolist(),
            "history": history,
        }

    def placed(self, place: Mapping[str, Any]) -> "Pupil":
        def like(values: Any, array: np.ndarray) -> np.ndarray:
            numbers = np.array(values, array.dtype)
            if numbers.shape != array.shape or not np.isfinite(numbers).all():
                raise ValueError("another shape, or what is no number")
            return numbers

        if self._depth:
            self._past_obs = like(place["history"]["obs"], self._past_obs)
            self._past_action = like(place["history"]["action"], self._past_action)
        self._obs, self._action = like(place["obs"], self._obs), like(place["action"], self._action)
        self._episode, self._time = int(place["episode"]), int(place["time"])
        return self

    def warm_up(self, ahead: bool) -> None:
        self._classroom.compile(None if ahead else 1)

    def leave(self) -> None:
        """Gives its place back."""
        self._classroom.leave(self)


def propose(
    pupils: Sequence[Pupil], observations: Float[np.ndarray, "pupils obs"]
) -> tuple[Float[np.ndarray, "pupils action"], Bool[np.ndarray, " pupils"]]:
    """What the policies of pupils of one classroom propose at their observations, before it is clipped.

    Gives with each whether it is a number. Nobody moves.
    """
    actions = np.zeros((len(pupils), pupils[0].learner.action_size if pupils else 0))
    finite = np.zeros(len(pupils), bool)
    for bench, members in _by_bench(pupils).items():
        lanes = [pupils[index].lane for index in members]
        obs = np.zeros((observations.shape[1], bench.tier.lanes))
        obs[:, lanes] = observations[members].T
        proposed, sound = bench.propose(obs)
        actions[members], finite[members] = proposed[:, lanes].T, sound[lanes]
    return actions, finite


def idle(pupils: Sequence[Pupil]) -> None:
    """Lets the learners of these pupils of one classroom go on by themselves, at the end of their steps."""
    for bench, members in _by_bench(pupils).items():
        lanes = bench.tier.lanes
        seeds, episodes, times = (np.zeros(lanes, kind) for kind in (np.int64, np.int32, np.int32))
        waiting = np.zeros(lanes, bool)
        for index in members:
            pupil = pupils[index]
            seeds[pupil.lane], episodes[pupil.lane] = pupil.seed, pupil.episode
            times[pupil.lane], waiting[pupil.lane] = pupil.time, True
        with pupils[members[0]].lock:
            bench.idle(seeds, episodes, times, waiting)
            for index in members:
                pupils[index].known = bench.known(pupils[index].lane)


def _by_bench(pupils: Sequence[Pupil]) -> dict[Bench, list[int]]:
    groups: dict[Bench, list[int]] = {}
    for index, pupil in enumerate(pupils):
        groups.setdefault(pupil.bench, []).append(index)
    return groups
