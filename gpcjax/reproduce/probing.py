"""How a GPC learner is taught, and looked into, for the illustrations and the claims about them."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from gpcjax.engine.lanes import Lane
from gpcjax.engine.pool import Finished
from gpcjax.gp.posterior import Posterior
from gpcjax.learners.gpc import GPC, GPCState
from gpcjax.sweep.build import make_pool, start_of
from gpcjax.sweep.environment import programs_folder
from gpcjax.sweep.executables import Executables
from gpcjax.sweep.plan import Cell, plan
from gpcjax.sweep.spec import spec_of

AT_ONCE = 181
"""Places that are looked at by one call."""


def taught(episodes: int, seeds: Sequence[int]) -> tuple[list[Cell], list[Lane]]:
    """GPC on the pendulum after so many episodes with a teacher that does not err: cells and lanes, by seed.

    They are the runs of a sweep with these settings: task, preset and teacher are a sweep's defaults. So are the
    programs, which are kept for sweeps, and found if one was there before.
    """
    spec = spec_of(env="pendulum", algo="gpc", episodes=episodes, seeds=max(seeds) + 1)
    cells = [cell for cell in plan(spec) if cell.seed in seeds]
    starts, finished = iter([start_of(cell) for cell in cells]), list[Finished]()
    folder = programs_folder()
    pool = make_pool(cells[0], programs=None if folder is None else Executables(folder))
    pool.run(lambda: next(starts, None), finished.append)
    lanes = {each.name.seed: each.lane for each in finished}
    return cells, [lanes[cell.seed] for cell in cells]


@eqx.filter_jit
def idle_state(learner: GPC) -> GPCState:
    """The state before any advice."""
    return learner.init()


def look(
    learner: GPC, state: GPCState, observations: Float[ArrayLike, "n obs"]
) -> dict[str, Float[np.ndarray, " n"]]:
    """The action of a learner with one dimension at each observation, and the uncertainties a correction would meet.

    So many at a time that one program does: all matrices of all places at once would take gigabytes.
    """
    places = np.asarray(observations)
    padded = np.concatenate([places, np.repeat(places[:1], -len(places) % AT_ONCE, axis=0)])
    seen = [_look(learner, state, part) for part in np.split(padded, len(padded) // AT_ONCE)]
    return {name: np.concatenate([part[name] for part in seen])[: len(places)] for name in seen[0]}


@eqx.filter_jit
def _look(learner: GPC, state: GPCState, observations: Any) -> dict[str, Float[Array, " n"]]:
    policy = jax.tree.map(lambda leaf: leaf[0], state.policy)

    def at(obs: Float[Array, " obs"]) -> dict[str, Float[Array, ""]]:
        action = learner.act(state, obs)
        sigma_policy = learner.policy.uncertainty(policy, (), obs)
        sigma_human = learner.uncertainty(state, obs, action)[0]
        return {"policy": action[0], "sigma_policy": sigma_policy, "sigma_human": sigma_human}

    return jax.vmap(at)(observations)


@eqx.filter_jit
def sigmas(learner: GPC, state: GPCState, obs: Any, actions: Any) -> Float[Array, "n action"]:
    """sigma_h of each action dimension at one observation, for each of `actions` (n, action)."""
    return jax.vmap(lambda action: learner.uncertainty(state, obs, action))(actions)


def angles_of(posterior: Posterior) -> Float[np.ndarray, "points 2"]:
    """(theta, theta_dot) of a dictionary's points, (cos, sin, theta_dot) as observed."""
    points = np.asarray(posterior.points[0])[: int(posterior.count[0])]
    return np.stack([np.arctan2(points[:, 1], points[:, 0]), points[:, 2]], -1)


def as_gpc(learner: Any) -> GPC:
    """The learner, known to be GPC or GPC-NS; TypeError for another."""
    if not isinstance(learner, GPC):
        raise TypeError(f"{type(learner).__name__} is no GPC learner")
    return learner


def parameters_of(learner: Any, *without: str) -> np.ndarray:
    """The learner's hyperparameters in the thesis' symbols, "c_h = 0.01" and so on."""
    human, policy = learner.human.kernel, learner.policy.kernel
    numbers = {
        "c_h": human.variance,
        "l_h": human.length_scale,
        "c_p": policy.variance,
        "l_p": policy.length_scale,
        "nu_p": policy.smoothness,
        "c_r": learner.constant_rate,
        "sigma_n^2": learner.policy.noise,
    }
    lines = [f"{name} = {float(value):g}" for name, value in numbers.items() if name not in without]
    weights = ", ".join(f"{float(weight):g}" for weight in learner.scaling)
    return np.array([*lines, "w = 1 / sigma_m" if learner.policy.normalise else f"w = {weights}"])
