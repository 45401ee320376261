"""Small tasks, teachers and learners for the engine, and the plain loop that it must agree with."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from gpcjax.engine import streams
from gpcjax.engine.lanes import LOGGED_CORRECTIONS, Lane
from gpcjax.engine.pool import Finished, Pool, Start, Tier
from gpcjax.envs.base import Env, State, begin, parameter
from gpcjax.envs.host import HostEnv, Simulation
from gpcjax.learners.base import Learner, Status
from gpcjax.learners.factory import make_learner
from gpcjax.teachers.oracle import Oracle

EPISODES = 4
ALGORITHMS = ("gpc", "gpc-ns", "coach")
TIERS = {
    "gpc": (Tier(4, 8, 8), Tier(64, 64, 8)),
    "gpc-ns": (Tier(4, 4, 8), Tier(64, 64, 16)),
    "coach": (Tier(1, 1, 8),),
}
"""Small ones, so that lanes pass through them all."""


class Drift(Env):
    """Two unstable coordinates, each with an action of its own; an episode ends where one passes 2.

    With `force` 0 the actions move nothing, so the observations are a recording: they are the same for every learner,
    whatever its rounding errors. With `fails_at`, what that step brings fails by quadrant, and is well again at the
    next (see `failing`).
    """

    force: Float[Array, ""] = eqx.field(default=0.2, converter=parameter)
    max_steps: int = eqx.field(default=30, static=True)
    fails_at: int = eqx.field(default=1000, static=True)

    name = property(lambda self: "drift")
    obs_size = property(lambda self: 2)
    action_size = property(lambda self: 2)

    def reset(self, key: PRNGKeyArray) -> State:
        start = jax.random.uniform(key, (2,), minval=-1.0, maxval=1.0)
        far = (start[0] > FAR) if self.fails_at < 1000 else False
        return begin(start, jnp.where(far, jnp.nan, start))

    def step(self, state: State, action: Float[Array, 2]) -> State:
        at, time = state.physics, state.time + 1
        action = jnp.clip(action, -1.0, 1.0)
        push = self.force * action
        at = jnp.stack([1.06 * at[0] - 0.05 * at[1] + push[0], 1.04 * at[1] + 0.05 * at[0] + push[1]])
        reward = -(at[0] * at[0] + at[1] * at[1] + 0.1 * action[0])
        failed, failed_reward = failing(at[0], at[1])
        obs = jnp.where(time == self.fails_at, at + failed, at)
        reward = jnp.where(time == self.fails_at, reward + failed_reward, reward)
        return State(
            physics=at,
            obs=obs,
            reward=reward,
            terminated=(jnp.abs(at[0]) > 2.0) | (jnp.abs(at[1]) > 2.0),
            truncated=time >= self.max_steps,
            time=time,
        )


FAR = 0.7
"""With `fails_at`, an episode that starts further to the right has no number as its first observation."""


def failing(x: Any, y: Any, where: Any = jnp.where) -> tuple[Any, Any]:
    """What is added to an observation and to a reward: NaN, infinity, to the reward minus infinity, or nothing."""
    on_the_right = where(y > 0.0, np.nan, np.inf)
    return where(x > 0.0, on_the_right, 0.0), where((x <= 0.0) & (y > 0.0), -np.inf, 0.0)


def expert(obs: Float[Array, 2]) -> Float[Array, 2]:
    """What the teacher would do with `Drift`."""
    return jnp.clip(jnp.stack([-0.9 * obs[0], -0.7 * obs[1] - 0.2 * obs[0]]), -1.0, 1.0)


def oracle(kind: type[Oracle] = Oracle, **changes: float) -> Oracle:
    numbers = {"rate": 0.5, "error": 0.1, "delta": 0.02, "active_gain": 0.0} | changes
    active = numbers["active_gain"] > 0
    return kind(**{name: jnp.asarray(value, float) for name, value in numbers.items()}, active=active)


def learner(algo: str, capacity: int = 4, **options: Any) -> Learner:
    """A learner for `Drift`; its dictionaries begin with room for `capacity` points."""
    if algo == "coach":
        grid = {"lower": (-2.0, -2.0), "upper": (2.0, 2.0), "counts": (4, 5)}
        return make_learner(
            algo, **{"obs_size": 2, "action_size": 2, **grid, "beta": 3.0, "magnitude": 0.3, **options}
        )
    kernels = {
        "policy_length_scale": 0.7,
        "policy_variance": 0.01,
        "human_length_scale": 0.3,
        "human_variance": 0.01,
    }
    return make_learner(algo, **{"obs_size": 2, "action_size": 2, "capacity": capacity, **kernels, **options})


def start(name: Any, learner: Learner, teacher: Oracle, seed: int) -> Start:
    """With its numbers on the host, as in sweeps."""
    return Start(name, *jax.tree.map(np.asarray, (learner, teacher)), seed)


def starts(algo: str) -> list[Start]:
    """Runs that differ in seed, teacher and hyperparameters, and so in the tiers that they reach."""
    free = {"constant_rate": 0.1} if algo != "coach" else {"coach_constant": 0.6}
    settings: list[tuple[int, dict[str, float], dict[str, float]]] = [
        (0, {}, {}),
        (1, {}, {}),
        (2, {"error": 0.4}, {}),
        (0, {"rate": 0.9}, {}),
        (0, {"delta": 0.5}, {}),
        (5, {"rate": 0.02}, free),
        (6, {"rate": 1.0, "delta": 0.0}, free),
        (7, {"rate": 0.02}, {}),
        (8, {"rate": 0.1}, {}),
        (9, {"error": 0.2}, {}),
        (10, {"rate": 0.01}, {}),
    ]
    return [
        start(index, learner(algo, **options), oracle(**teaching), seed)
        for index, (seed, teaching, options) in enumerate(settings)
    ]


def make_pool(env: Env | HostEnv, template: Start, tiers: tuple[Tier, ...], episodes: int = EPISODES) -> Pool:
    return Pool(env, expert, episodes, template, tiers)


def run(pool: Pool, starts: Iterable[Start]) -> dict[Any, Lane]:
    """Each finished lane by its name."""
    waiting, finished = iter(starts), list[Finished]()
    pool.run(lambda: next(waiting, None), finished.append)
    assert len({each.name for each in finished}) == len(finished)
    return {each.name: each.lane for each in finished}


def kept(lane: Lane) -> dict[str, Any]:
    """All of a lane but the window of coins that was drawn last: when that is depends on the block."""
    return {name: value for name, value in vars(lane).items() if name not in ("window", "window_start")}


def in_numpy(tree: Any) -> Any:
    """A tree of arrays on the host, where looking at a number takes no time."""
    return jax.tree.map(np.asarray, tree)


@dataclasses.dataclass
class Plain:
    """What a plain loop measured: rows of numbers for each episode, and its corrections."""

    rows: dict[str, np.ndarray]
    log: dict[str, np.ndarray]
    status: int
    state: Any


def plain(env: Env | HostEnv, start: Start, tier: Tier, episodes: int = EPISODES) -> Plain:
    """One run as anyone would write it: act, ask the teacher, correct, step; every chance worked out at every step.

    The dictionaries have the room of `tier` from the start.
    """
    learner, given = jax.tree.map(jnp.asarray, (start.learner, start.teacher))
    seed = start.seed
    state = learner.resize(learner.init(), tier.policy_capacity, tier.human_capacity)
    names = (
        "returns",
        "length",
        "corrections",
        "rate_sum",
        "policy_points",
        "human_points",
        "clipped",
        "full",
        "asked",
        "chance_sum",
    )
    rows = {name: np.zeros(episodes) for name in names}
    log: dict[str, list] = {"moments": [], "values": [], "outcome": []}
    status = Status.OK
    for episode in range(episodes):
        at, teacher = reset(env, start_key(seed, episode)), given
        if teacher.schedule is not None:
            rates = np.asarray(start.teacher.schedule)
            rate = jnp.asarray(rates[min(episode, len(rates) - 1)])
            teacher = dataclasses.replace(teacher, rate=rate, schedule=None)
        while not at.done and status == Status.OK:
            step = int(at.time)
            drawn = coins(seed, episode, step, learner.action_size)
            action, clipped, h, asked, chance, finite = in_numpy(
                propose(learner, teacher, state, at.obs, drawn)
            )
            if not (finite and np.isfinite(at.obs).all() and np.isfinite(rows["returns"][episode])):
                status = Status.NON_FINITE
                break
            rows["asked"][episode] += asked
            rows["chance_sum"][episode] += chance if asked else 0.0
            if h.any():
                state, info = learner.correct(state, at.obs, action, h)
                info = in_numpy(info)
                status = Status(int(info.status))
                if status == Status.FULL and learner.on_full == "drop":
                    status = Status.OK
                for i in np.flatnonzero(h):
                    log["moments"].append((episode, step, i))
                    log["values"].append(
                        [values[i] for values in (info.rate, info.sigma_policy, info.sigma_human)]
                    )
                    log["outcome"].append([values[i] for values in (info.appended, info.replaced, info.full)])
                    rows["corrections"][episode] += info.rate[i] > 0
                    rows["rate_sum"][episode] += info.rate[i]
                    rows["full"][episode] += info.full[i]
            at = advance(env, at, action)
            rows["returns"][episode] += at.reward
            rows["clipped"][episode] += clipped
        rows["length"][episode] = at.time
        rows["policy_points"][episode], rows["human_points"][episode] = learner.points(state)
        if not (np.isfinite(rows["returns"][episode]) and np.isfinite(at.obs).all()):
            status = Status.NON_FINITE
        if status == Status.NON_FINITE:
            rows["returns"][episode] = np.nan
        if status != Status.OK:
            break
    arrays = {name: np.asarray(values[:LOGGED_CORRECTIONS]).reshape(-1, 3) for name, values in log.items()}
    return Plain(rows, arrays, int(status), state)


@dataclasses.dataclass
class At:
    """Where an episode stands, in numpy, for `plain`; `inside` is what the task goes on from."""

    inside: State | Simulation
    obs: np.ndarray
    time: Any = 0
    reward: Any = 0.0
    done: Any = False


def reset(env: Env | HostEnv, key: PRNGKeyArray) -> At:
    """The start of an episode; on the host of a new simulation."""
    if isinstance(env, Env):
        return _looked_at(*_reset(env, key))
    simulation = env.simulate()
    return At(simulation, simulation.reset(int(jax.random.key_data(key)[0])))


def advance(env: Env | HostEnv, at: At, action: Any) -> At:
    if isinstance(env, Env):
        return _looked_at(*_step(env, at.inside, action))
    got = at.inside.step(env.scaled(np.asarray(action)))
    return At(at.inside, got.obs, at.time + 1, got.reward, got.terminated or got.truncated)


def _looked_at(state: State, numbers: tuple) -> At:
    return At(state, *map(np.asarray, numbers))


def _numbers(state: State) -> tuple[State, tuple]:
    return state, (state.obs, state.time, state.reward, state.done)


_reset = jax.jit(lambda env, key: _numbers(env.reset(key)))
_step = jax.jit(lambda env, state, action: _numbers(env.step(state, action)))
coins = jax.jit(streams.coins, static_argnums=3)
coins_at = jax.jit(jax.vmap(streams.coins, in_axes=(None, 0, 0, None)), static_argnums=3)
"""Those of many places of one seed."""
start_key = jax.jit(streams.start_key)


@jax.jit
def propose(learner: Learner, teacher: Oracle, state: Any, obs: Array, coins: Array) -> tuple:
    """The action, whether it was clipped, the advice on it (Alg. 4 with the chance of (3.6), worked out at once), and
    whether the action is a number.
    """
    proposed = learner.controller(state)(obs)
    action = jnp.clip(proposed, -1.0, 1.0)
    chance = jnp.broadcast_to(teacher.rate, action.shape)
    if teacher.active:
        chance = jnp.minimum(teacher.active_gain * learner.uncertainty(state, obs, action) + chance, 1.0)
    gap = expert(obs) - action
    sign = jnp.sign(gap) * (jnp.abs(gap) > teacher.delta)
    h = jnp.where(coins < chance, sign, 0.0) * jnp.where(coins < chance * teacher.error, -1.0, 1.0)
    asked = (coins < jnp.minimum(teacher.active_gain * learner.largest_sigma() + teacher.rate, 1.0)).any()
    return action, (jnp.abs(proposed) > 1.0).any(), h, asked, chance.mean(), jnp.isfinite(proposed).all()
