"""Teaching in a program of one's own: a person at a keyboard, a robot's control loop, another simulator.

The steps are those of the engine's own loops, on a block of one lane: `propose` is what acts there, and what follows
advice is `gpcjax.engine.correcting.correct`, with the same reckoning for advice that comes late.
"""

import dataclasses
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gpcjax._x64 import set_public_methods_under_own_settings
from gpcjax.allowed import NON_NEGATIVE, POSITIVE, Numbers, checked, shown
from gpcjax.engine.correcting import correct, idle_is_due
from gpcjax.engine.history import Credit
from gpcjax.engine.lanes import Lane, empty_tally, fresh, map_lanes
from gpcjax.engine.stepping import moment_of, propose, remember
from gpcjax.envs.base import begin
from gpcjax.errors import UserError
from gpcjax.learners.base import Info, Learner, State
from gpcjax.learners.saved import load_learner, save_learner
from gpcjax.policies.base import Policy, Vector, check_executed, vector
from gpcjax.policies.folder import read_card
from gpcjax.recording import Recording
from gpcjax.teachers.base import Teacher

SEED = Numbers(0, 2**63 - 1, whole=True)
UNDOS = Numbers(0, 1_000, whole=True)


class Elsewhere(Teacher):
    """A teacher who is not asked: advice comes when it comes."""

    def may_advise(self, coins, largest_sigma, step):
        return jnp.ones_like(coins, bool)

    def advise(self, coins, moment):
        return jnp.zeros_like(coins)


class Session:
    """One learner, taught while it acts.

        session = gpcjax.Session(gpcjax.make_learner("gpc", "cartpole"))
        action = session.propose(obs)    # what to execute, (action_size,) in [-1, 1]
        session.advise([1])              # "more": learned at once, about the step just proposed

    All methods may be called from several threads: a control loop proposes while a person's key advises.

    Args:
        learner: from `make_learner`, or of one's own.
        state: to go on from; without one, an untaught one.
        credit, credit_longest, credit_shape: seconds between a step and the advice about it, as the settings of a sweep
            of these names have it; without them, all advice is about the latest step.
        time_step: seconds of a step, for these.
        seed: of what the learner draws.
        undos: how many of the latest corrections can be undone.
        record: a file to which every event is appended at once; `Session.replay` makes the session of it again, to the
            bit. It must not exist.

    Raises:
        ValueError: an argument of another kind; the message names it.
    """

    def __init__(
        self,
        learner: Learner,
        state: State | None = None,
        *,
        credit: Any = None,
        credit_longest: Any = None,
        credit_shape: Any = None,
        time_step: Any = 1.0,
        seed: Any = 0,
        undos: Any = 20,
        record: Any = None,
    ):
        if not isinstance(learner, Learner):
            raise UserError(f"learner {shown(learner)}: give a learner, from make_learner")
        self.learner = learner
        late = {"credit": NON_NEGATIVE, "credit_longest": NON_NEGATIVE, "credit_shape": POSITIVE}
        given = zip(late.items(), (credit, credit_longest, credit_shape), strict=True)
        self._settings: dict[str, Any] = {
            name: None if value is None else checked(name, value, float, allowed)
            for (name, allowed), value in given
        }
        self._settings["time_step"] = checked("time_step", time_step, float, POSITIVE)
        self._settings["seed"] = checked("seed", seed, int, SEED)
        self._lock = threading.RLock()
        self._undos: deque[tuple[State, Any]] = deque(maxlen=checked("undos", undos, int, UNDOS))
        self._begun = self._begins = False
        self.corrections = 0
        """Advice that was learned, and not undone, counted for each action dimension."""
        self._block = self._fresh(state)
        self._recording = None if record is None else Recording.new(record, self._settings)

    @property
    def episode(self) -> int:
        """Of the latest step, from 0."""
        return int(self._block.episode[0])

    @property
    def step(self) -> int:
        """The latest step of the episode, from 0; -1 before the first."""
        return int(self._block.env.time[0]) if self._begun else -1

    @property
    def state(self) -> State:
        """The learner's state."""
        with self._lock:
            return jax.tree.map(lambda leaf: leaf[0], self._block.state)

    def propose(self, obs: Vector) -> Float[np.ndarray, " action"]:
        """The action to execute at `obs` (obs_size,): (action_size,), in [-1, 1]. It begins a step.

        The step before is over then, and was executed as proposed, unless `executed` told otherwise.

        Raises:
            ValueError: another shape, or what is no number, in `obs` or as the policy's action.
        """
        obs = np.asarray(vector("obs", obs, self.learner.obs_size, "this learner"))
        if not np.isfinite(obs).all():
            raise UserError(f"obs {shown(obs.tolist())}: each entry must be finite")
        with self._lock:
            begins = self._begins or not self._begun
            another = self._begun and self._begins
            block, finite = _proposed(self._block, obs, jnp.asarray(begins), jnp.asarray(another))
            if not finite[0]:
                raise UserError(f"the policy's action at {shown(obs.tolist())} is no number")
            self._block, self._begun, self._begins = block, True, False
            self._note("propose", obs=obs.tolist())
            if self.learner.idle_every and bool(idle_is_due(self.learner, block.env.time)[0]):
                self._block = _corrected(self._block, jnp.zeros((self.learner.action_size, 1)))
            return np.asarray(self._block.action[:, 0])

    def executed(self, action: Vector) -> None:
        """Says what was executed at the latest step, where that is not what was proposed: advice is about this.

        Raises:
            ValueError: another shape, an entry beyond [-1, 1] or no number, or no step has begun.
        """
        action = np.asarray(vector("action", action, self.learner.action_size, "this learner"))
        check_executed(action)
        if not np.isfinite(action).all():
            raise UserError(f"action {shown(action.tolist())}: each entry must be finite")
        with self._lock:
            self._check_begun()
            self._block = dataclasses.replace(self._block, action=jnp.asarray(action)[:, None])
            self._note("executed", action=action.tolist())

    def advise(self, advice: Vector | float) -> Info:
        """Learns from advice: -1 for less, 1 for more, 0 for none, for each action dimension; or one number for one.

        Returns what was done, each field (action_size,). A dictionary that is full is given twice the room first.

        Raises:
            ValueError: another shape or value, or no step has begun.
        """
        entries: Any = [advice] if np.ndim(advice) == 0 else advice
        given = np.asarray(vector("advice", entries, self.learner.action_size, "this learner"))
        if not np.isin(given, (-1.0, 0.0, 1.0)).all():
            raise UserError(f"advice {shown(given.tolist())}: each entry must be -1, 0 or 1")
        with self._lock:
            self._check_begun()
            self._make_room()
            before = self._block.state, self.corrections
            block = dataclasses.replace(self._block, waiting=jnp.zeros(1, bool))  # idling has its own time
            block = _corrected(block, jnp.asarray(given)[:, None])
            self._undos.append(before)
            info = _info(block, self.learner.action_size)
            self.corrections += int(block.tally.corrections[0])
            self._block = _cleared(block)
            self._note("advise", advice=given.astype(int).tolist())
            return info

    def undo(self) -> bool:
        """Takes the latest advice back, with all that was learned since; False if there is none to take back."""
        with self._lock:
            if not self._undos:
                return False
            state, self.corrections = self._undos.pop()
            self._block = self._with_state(state)
            self._note("undo")
            return True

    def end_episode(self) -> None:
        """The next step begins a new episode: advice that comes then is never about this one."""
        with self._lock:
            self._begins = self._begun
            self._note("end")

    def policy(self) -> Policy:
        """What has been taught so far, as a function of an observation; it stays as it is."""
        return self.learner.policy_of(self.state)

    def save(self, path: Any, **provenance: Any) -> None:
        """Writes learner, state and the steps that late advice may be about into a new folder, for `Session.load`.

        Raises: as `gpcjax.save_learner`.
        """
        with self._lock:
            history = self._block.history
            kept = (
                None if history is None else [history.obs[..., 0].tolist(), history.action[..., 0].tolist()]
            )
            session = {
                "settings": self._settings,
                "episode": self.episode,
                "begun": self._begun,
                "begins": self._begins,
                "step": self.step,
                "obs": self._block.env.obs[:, 0].tolist(),
                "action": self._block.action[:, 0].tolist(),
                "history": kept,
                "corrections": self.corrections,
            }
            save_learner(path, self.learner, self.state, session=session, **provenance)

    @classmethod
    def load(cls, path: Any, record: Any = None) -> "Session":
        """The session that `save` wrote, at the same step: what follows is the same to the bit.

        Raises:
            ValueError: there is no session at `path`, or it is damaged.
        """
        learner, state = load_learner(path)
        kept = read_card(path, "learner").get("provenance", {}).get("session")
        if not isinstance(kept, Mapping):
            raise UserError(f"{path}: this is a learner without a session: give it to gpcjax.Session")
        session = cls(learner, state, **kept["settings"], record=record)
        block = session._block
        history = block.history
        if history is not None:
            obs, action = (jnp.asarray(values, float)[..., None] for values in kept["history"])
            history = dataclasses.replace(history, obs=obs, action=action)
        env = dataclasses.replace(
            block.env,
            obs=jnp.asarray(kept["obs"], float)[:, None],
            time=jnp.full(1, max(kept["step"], 0), jnp.int32),
        )
        session._block = dataclasses.replace(
            block,
            env=env,
            history=history,
            action=jnp.asarray(kept["action"], float)[:, None],
            episode=jnp.full(1, kept["episode"], jnp.int32),
        )
        session._begun, session._begins = kept["begun"], kept["begins"]
        session.corrections = kept["corrections"]
        return session

    @classmethod
    def replay(
        cls, record: Any, learner: Learner, state: State | None = None, *, go_on: bool = False
    ) -> "Session":
        """The session whose events are in the file `record`, made again: the same to the bit, on the same machine.

        Args:
            record: what a session with `record=` has written, also one whose program has died.
            learner, state: those that it was begun with.
            go_on: append what follows to the same file.

        Raises:
            ValueError: the file cannot be read, or is no recording.
        """
        settings, events = Recording.read(record)
        session = cls(learner, state, **settings)
        for event in events:
            match event:
                case {"event": "propose", "obs": obs}:
                    session.propose(obs)
                case {"event": "executed", "action": action}:
                    session.executed(action)
                case {"event": "advise", "advice": advice}:
                    session.advise(advice)
                case {"event": "undo"}:
                    session.undo()
                case {"event": "end"}:
                    session.end_episode()
        if go_on:
            session._recording = Recording.again(record)
        return session

    def _fresh(self, state: State | None) -> Lane:
        """A block of one lane, before its first step."""
        names = ("credit", "credit_longest", "credit_shape", "time_step")
        credit = Credit.of(*(self._settings[name] for name in names))
        start = begin((), jnp.zeros(self.learner.obs_size))
        lane = fresh(start, self.learner, Elsewhere(), jnp.asarray(self._settings["seed"]), 1, credit)
        if state is not None:
            self.learner.policy_of(state)  # refuses what is no state of this learner
            lane = dataclasses.replace(lane, state=state, controller=self.learner.controller(state))
        return map_lanes(lambda leaf, axis: jnp.expand_dims(leaf, axis), lane)

    def _with_state(self, state: State) -> Lane:
        """The block with another state, which has a lanes axis."""
        controller = self.learner.controller(jax.tree.map(lambda leaf: leaf[0], state))
        controller = jax.tree.map(lambda leaf: jnp.expand_dims(leaf, -1), controller)
        return dataclasses.replace(self._block, state=state, controller=controller)

    def _make_room(self) -> None:
        credit = self._block.credit
        corrections = 1 if credit is None else credit.moments
        while self.learner.wants_room and not bool(self.learner.has_room(self.state, corrections)):
            grown = self.learner.grow(self.state)
            self._block = self._with_state(jax.tree.map(lambda leaf: leaf[None], grown))

    def _check_begun(self) -> None:
        if not self._begun or self._begins:
            raise UserError("no step of this episode has begun: call propose first")

    def _note(self, event: str, **values: Any) -> None:
        if self._recording is not None:
            self._recording.append({"event": event, "episode": self.episode, "step": self.step, **values})


set_public_methods_under_own_settings(Session)


@eqx.filter_jit
def _proposed(
    block: Lane, obs: Float[Array, " obs"], begins: Bool[Array, ""], another: Bool[Array, ""]
) -> tuple[Lane, Bool[Array, " 1"]]:
    """The block at its next step, and whether its action is a number; `another` episode than before begins with it."""
    history = remember(block.history, moment_of(block), ~begins[None])
    env = dataclasses.replace(
        block.env, obs=obs[:, None], time=jnp.where(begins, 0, block.env.time + 1).astype(jnp.int32)
    )
    proposed, finite = propose(block.controller, env.obs, block.tally.returns)
    block = dataclasses.replace(
        block,
        env=env,
        episode=block.episode + another,
        action=jnp.clip(proposed, -1.0, 1.0),
        waiting=jnp.ones(1, bool),
        history=history,
    )
    return block, finite


@eqx.filter_jit
def _corrected(block: Lane, advice: Float[Array, "action 1"]) -> Lane:
    return correct(block, advice)


def _info(block: Lane, action_size: int) -> Info:
    """What the correction of a block that was `_cleared` before has done."""
    log = jax.tree.map(lambda leaf: np.asarray(leaf[0]), block.log)
    count = int(log.count)
    dimensions = log.where[:count, 2]
    values, outcome = np.full((action_size, 3), np.nan), np.zeros((action_size, 3), bool)
    values[:, 0] = 0.0
    values[dimensions], outcome[dimensions] = log.values[:count], log.outcome[:count]
    rate, sigma_policy, sigma_human = jnp.asarray(values.T)
    appended, replaced, full = jnp.asarray(outcome.T)
    return Info(rate, sigma_policy, sigma_human, appended, replaced, full, block.status[0])


def _cleared(block: Lane) -> Lane:
    """Without what was counted: it has been told."""
    tally = jax.tree.map(lambda leaf: leaf[None], empty_tally())
    log = dataclasses.replace(block.log, count=jnp.zeros(1, jnp.int32))
    return dataclasses.replace(block, tally=tally, log=log, status=jnp.zeros_like(block.status))
