"""What the peers share: two tasks and their experts in plain Python, the teacher, and the loop that is timed.

Nothing of gpcjax is imported, so that a peer costs what it would cost by itself. A peer is one process; for
one core set OMP_NUM_THREADS=1 before numpy is loaded (BLAS gains nothing from threads at these sizes).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NotRequired, Protocol, TypedDict, runtime_checkable

import numpy as np
from scipy.linalg import solve_discrete_are

Floats = tuple[float, ...]


class Task(Protocol):
    """An environment with one action in [-1, 1]; states and observations are tuples of floats."""

    max_steps: int

    def reset(self, rng: np.random.Generator) -> Floats:
        """A first state."""
        ...

    def observe(self, state: Floats) -> Floats:
        """What learner and expert see of the state."""
        ...

    def step(self, state: Floats, action: float) -> tuple[Floats, float, bool]:
        """Next state, reward, and whether the episode terminated."""
        ...

    def expert(self, obs: Floats) -> float:
        """The target action of the oracle."""
        ...


class CartPole:
    """gymnasium's cart-pole with a force of 10 N times the action: explicit Euler at 0.02 s, 2500 steps."""

    max_steps = 2500
    GRAVITY, CART, POLE, HALF_LENGTH, FORCE, TAU = 9.8, 1.0, 0.1, 0.5, 10.0, 0.02  # SI units
    MAX_X, MAX_THETA = 2.4, math.radians(12)

    def __init__(self) -> None:
        self.gain = self.lqr_gain()

    def lqr_gain(self) -> Floats:
        """Gain of a = -gain . s for the costs diag(1, 1, 10, 1) of the state and 1 of the action, as gpcjax's `lqr`."""
        total = self.CART + self.POLE
        inertia = self.HALF_LENGTH * (4 / 3 - self.POLE / total)
        shift = self.POLE * self.HALF_LENGTH / total
        theta_s, theta_u = self.GRAVITY / inertia, -self.FORCE / total / inertia
        a = np.eye(4)
        a[0, 1] = a[2, 3] = self.TAU
        a[3, 2], a[1, 2] = self.TAU * theta_s, -self.TAU * shift * theta_s
        b = self.TAU * np.array([[0.0], [self.FORCE / total - shift * theta_u], [0.0], [theta_u]])
        p = solve_discrete_are(a, b, np.diag([1.0, 1.0, 10.0, 1.0]), np.eye(1))
        return tuple(np.linalg.solve(np.eye(1) + b.T @ p @ b, b.T @ p @ a)[0].tolist())

    def reset(self, rng: np.random.Generator) -> Floats:
        """(x, x_dot, theta, theta_dot), each uniform in +-0.05."""
        return tuple(rng.uniform(-0.05, 0.05, 4).tolist())

    def observe(self, state: Floats) -> Floats:
        """The state itself."""
        return state

    def step(self, state: Floats, action: float) -> tuple[Floats, float, bool]:
        """The reward is one for every step, the last one included."""
        x, x_dot, theta, theta_dot = state
        total, pole = self.CART + self.POLE, self.POLE * self.HALF_LENGTH
        sin, cos = math.sin(theta), math.cos(theta)
        push = (self.FORCE * action + pole * theta_dot * theta_dot * sin) / total
        theta_acc = (self.GRAVITY * sin - cos * push) / (
            self.HALF_LENGTH * (4 / 3 - self.POLE * cos * cos / total)
        )
        x_acc = push - pole * theta_acc * cos / total
        x, theta = x + self.TAU * x_dot, theta + self.TAU * theta_dot
        after = x, x_dot + self.TAU * x_acc, theta, theta_dot + self.TAU * theta_acc
        return after, 1.0, abs(x) > self.MAX_X or abs(theta) > self.MAX_THETA

    def expert(self, obs: Floats) -> float:
        """The LQR, clipped."""
        a, b, c, d = self.gain
        x, x_dot, theta, theta_dot = obs
        return min(1.0, max(-1.0, -(a * x + b * x_dot + c * theta + d * theta_dot)))


class Pendulum:
    """gymnasium's Pendulum-v1, torque 2 Nm times the action, 200 steps of 0.05 s; state: theta, theta_dot."""

    max_steps = 200
    GRAVITY, TORQUE, TAU, MAX_SPEED = 10.0, 2.0, 0.05, 8.0  # mass 1 kg, length 1 m

    def reset(self, rng: np.random.Generator) -> Floats:
        """An angle uniform in +-pi (0 is upright), a speed in +-1."""
        return rng.uniform(-math.pi, math.pi), rng.uniform(-1.0, 1.0)

    def observe(self, state: Floats) -> Floats:
        """(cos theta, sin theta, theta_dot)."""
        return math.cos(state[0]), math.sin(state[0]), state[1]

    def step(self, state: Floats, action: float) -> tuple[Floats, float, bool]:
        """The reward is minus the cost of the state before the step."""
        theta, theta_dot = state
        torque = self.TORQUE * action
        angle = (theta + math.pi) % (2 * math.pi) - math.pi
        cost = angle * angle + 0.1 * theta_dot * theta_dot + 0.001 * torque * torque
        theta_dot += (1.5 * self.GRAVITY * math.sin(theta) + 3.0 * torque) * self.TAU
        theta_dot = min(self.MAX_SPEED, max(-self.MAX_SPEED, theta_dot))
        return (theta + theta_dot * self.TAU, theta_dot), -cost, False

    def expert(self, obs: Floats) -> float:
        """Pumps energy until the upright's is reached, then holds the pole with a PD law."""
        cos, sin, theta_dot = obs
        angle = math.atan2(sin, cos)
        missing = self.GRAVITY / 2 * (1 - cos) - theta_dot * theta_dot / 6  # J, inertia 1/3
        if cos > 0.5 and abs(angle + 0.25 * theta_dot) < 0.5:
            action = -(8.0 * angle + 2.0 * theta_dot) / self.TORQUE
        else:
            action = missing * math.copysign(1.0, theta_dot)
        return min(1.0, max(-1.0, action))


TASKS: dict[str, type[CartPole] | type[Pendulum]] = {"cartpole": CartPole, "pendulum": Pendulum}


@dataclass(frozen=True)
class GPValues:
    """One column of Table 5.1 or 5.2; `weights` is empty for GPC-NS."""

    human_variance: float  # c_h
    human_length_scale: float  # l_h
    policy_variance: float  # c_p
    policy_length_scale: float  # l_p
    nu: float  # nu_p
    constant_rate: float  # c_r
    weights: Floats = ()
    noise: float = 1e-7


GP_VALUES = {
    ("gpc", "pendulum"): GPValues(0.7, 0.1, 0.01, 0.7, 0.5, 0.01, (1.0, 1.0, 1 / 6)),
    ("gpc", "cartpole"): GPValues(0.01, 0.2, 0.01, 0.2, 1.5, 0.02, (1.0, 1.0, 1 / 0.13, 1 / 0.4)),
    ("gpc-ns", "pendulum"): GPValues(0.45, 0.1, 0.03, 0.5, 1.5, 0.02),
    ("gpc-ns", "cartpole"): GPValues(0.08, 0.5, 1e-3, 0.7, 1.5, 0.05),
}
OBS_SIZE = {"cartpole": 4, "pendulum": 3}


class Learner(Protocol):
    """A learner of one action."""

    @property
    def policy_points(self) -> int:
        """Size of P; 0 for COACH."""
        ...

    @property
    def human_points(self) -> int:
        """Size of H; 0 for COACH."""
        ...

    def act(self, obs: Floats) -> float:
        """The executed action, in [-1, 1]."""
        ...

    def correct(self, obs: Floats, action: float, h: int) -> Any:
        """Learns from advice h in {-1, 1} on the action just executed."""
        ...


@runtime_checkable
class Uncertain(Protocol):
    """What active learning asks of a learner, beside."""

    largest_sigma: float
    """A bound of `sigma_human`."""

    def sigma_human(self, obs: Floats, action: float) -> float:
        """How uncertain the human model is."""
        ...


@dataclass(frozen=True)
class PeerResult:
    """What a run did; `returns` holds the episodes that ended within the budget of steps."""

    env_steps: int
    seconds: float
    corrections: int
    returns: tuple[float, ...]
    policy_points: int
    human_points: int

    @property
    def steps_per_second(self) -> float:
        """Environment steps per second, everything counted."""
        return self.env_steps / self.seconds


class Teaching(TypedDict):
    """The keywords of `teach`."""

    steps: int
    seed: int
    error: float
    rate: float
    delta: float
    active_gain: NotRequired[float]
    episodes: NotRequired[int | None]


def uniforms(rng: np.random.Generator) -> Iterator[float]:
    """Uniform numbers in [0, 1), drawn by the thousand because single draws are slow."""
    while True:
        yield from rng.random(4096).tolist()


def teach(
    learner: Learner,
    task: Task,
    *,
    steps: int,
    seed: int,
    error: float,
    rate: float,
    delta: float,
    active_gain: float = 0.0,
    episodes: int | None = None,
) -> PeerResult:
    """Teaches by the oracle (Alg. 4) for `steps` environment steps, or for so many episodes; all of it is timed.

    One uniform number u a step decides: u < chance is advice, u < chance * error the flipped sign. With an
    `active_gain` the chance grows with the human model's uncertainty, which is asked only where u leaves it open.
    """
    starts, coins = (np.random.default_rng([seed, stream]) for stream in range(2))
    coin, chance, largest = uniforms(coins), rate, rate
    uncertain = learner if active_gain and isinstance(learner, Uncertain) else None
    if uncertain is not None:
        largest = min(1.0, rate + active_gain * uncertain.largest_sigma)
    returns: list[float] = []
    taken = corrections = 0
    begin = time.perf_counter()
    while taken < steps and len(returns) != episodes:
        state, total, length, terminated = task.reset(starts), 0.0, 0, False
        limit = min(task.max_steps, steps - taken)
        while length < limit and not terminated:
            obs = task.observe(state)
            action = learner.act(obs)
            state, reward, terminated = task.step(state, action)
            total += reward
            length += 1
            u = next(coin)
            if u < largest:
                if uncertain is not None:
                    chance = min(1.0, rate + active_gain * uncertain.sigma_human(obs, action))
                gap = task.expert(obs) - action
                if u < chance and abs(gap) > delta:
                    learner.correct(obs, action, 1 if (gap > 0) == (u >= chance * error) else -1)
                    corrections += 1
        if terminated or length == task.max_steps:
            returns.append(total)
        taken += length
    seconds = time.perf_counter() - begin
    return PeerResult(
        taken, seconds, corrections, tuple(returns), learner.policy_points, learner.human_points
    )
