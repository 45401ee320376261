"""Computes what the thesis' illustrative figures show, with the learners, tasks and teachers of gpcjax itself.

`compute` is called by a worker, on one thread like all that is recorded (`gpcjax.sweep.executors`). The records and
their file are `gpcjax.reproduce.records`, which loads no jax.
"""

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gpcjax.engine.lanes import Lane
from gpcjax.gp.fit import fit, log_marginal_likelihood
from gpcjax.gp.kernels import SQUARED_EXPONENTIAL, Kernel
from gpcjax.gp.posterior import Posterior
from gpcjax.gp.replacing import Replacing
from gpcjax.learners.factory import make_learner
from gpcjax.learners.gpc import GPC
from gpcjax.registry import find
from gpcjax.reproduce.probing import angles_of, as_gpc, idle_state, look, parameters_of, sigmas, taught
from gpcjax.reproduce.records import (
    Erroneous,
    Hyperparameters,
    Illustrations,
    Plane,
    Situations,
    Sparsification,
    read,
    write,
)
from gpcjax.reproduce.repetitions import repetitions
from gpcjax.sweep.plan import Cell

__all__ = ["compute", "erroneous", "hyperparameters", "plane", "read", "situations", "sparsification"]

EARLY, LATE = 5, 40
"""Episodes of teaching before Figs. 3.3 and 5.3."""

CARTPOLE_STATE = (0.0, 0.0, 0.05, 0.1)
"""A pole that leans and falls to the right, for the figures at one state: a stronger push to the right is right."""

SHORT, LONG = 0.1, 1.0
"""l_h of Fig. 5.9, which gives no numbers: about those of Table 5.2 (0.2 for GPC, 0.5 for GPC-NS)."""

REPEATED = 30
"""Runs and draws behind a claim about an illustration, which itself shows one."""


def compute(out: Path) -> None:
    """Computes all illustrations and writes them to `out`, whole or not at all.

    Raises:
        OSError: the folder is missing or cannot be written.
    """
    seeds = range(REPEATED)
    (cell, *_), early = taught(EARLY, seeds)
    (last, *_), late = taught(LATE, seeds)
    write(
        out,
        Illustrations(
            hyperparameters=hyperparameters(),
            situations=situations(),
            early=plane_of(cell, early[0]),
            sparsification=sparsification(),
            late=plane_of(last, late[0]),
            erroneous=erroneous(),
            repetitions=repetitions(early, late, (SHORT, LONG)),
        ),
    )


def hyperparameters() -> Hyperparameters:
    """Fig. 2.2: a poor guess, and what the marginal likelihood makes of it."""
    rng = np.random.default_rng(0)
    points = np.linspace(-4.5, 4.5, 16) + rng.uniform(-0.25, 0.25, 16)

    def truth(x: np.ndarray) -> np.ndarray:
        return np.sin(1.2 * x) + 0.3 * x

    targets = truth(points) + 0.15 * rng.normal(size=points.size)
    x = np.linspace(-6.0, 6.0, 241)
    one, short, little = (jnp.asarray(value, float) for value in (1.0, 0.25, 0.01))
    found = fit(points[:, None], targets, SQUARED_EXPONENTIAL)
    sets = ((Kernel(one, short, SQUARED_EXPONENTIAL), little), (found.kernel, found.noise))
    regressions = [_regression(kernel, noise, points, targets, x) for kernel, noise in sets]
    mean, deviation, likelihood = (np.stack(values) for values in zip(*regressions, strict=True))
    return Hyperparameters(
        points=points,
        targets=targets,
        x=x,
        truth=truth(x),
        mean=mean,
        deviation=deviation,
        variance=np.array([float(kernel.variance) for kernel, _ in sets]),
        length_scale=np.array([float(kernel.length_scale) for kernel, _ in sets]),
        noise=np.array([float(noise) for _, noise in sets]),
        log_likelihood=likelihood,
    )


@eqx.filter_jit
def _regression(
    kernel: Kernel, noise: Any, points: Any, targets: Any, x: Any
) -> tuple[Float[Array, " grid"], Float[Array, " grid"], Float[Array, ""]]:
    """Mean and standard deviation over `x`, and the log marginal likelihood."""
    process = Replacing(kernel, noise)

    def put(posterior: Posterior, pair: Any) -> tuple[Posterior, None]:
        point, target = pair[0][None], pair[1]
        reading = process.read(posterior, (), process.covariances(posterior, (), point))
        change = process.put(posterior, (), reading, point, target, posterior.count, jnp.array(True))
        return change.write(posterior, ()), None

    posterior, _ = jax.lax.scan(put, process.init(points.size, jnp.ones(1)), (points, targets))

    def at(place: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        mean = (process.covariances(posterior, (), place[None]) * posterior.weights).sum()
        return mean, process.uncertainty(posterior, (), place[None])

    return *jax.vmap(at)(x), log_marginal_likelihood(kernel, noise, points[:, None], targets)


def situations() -> Situations:
    """Fig. 3.2, with the lander's hyperparameters (Table 5.3), which are for unscaled states."""
    learner = as_gpc(make_learner("gpc", obs_size=1, action_size=1, capacity=8))
    x, actions = np.linspace(-1.5, 1.5, 181), np.linspace(-0.6, 1.0, 161)
    here, state, rows = np.zeros(1), idle_state(learner), []
    for advice in (1.0, 1.0, 0.0, 0.0):
        action = learner.act(state, here)
        after, info = learner.correct(state, here, action, [advice])
        seen = look(learner, state, x[:, None])
        rows.append(
            {
                "policy": seen["policy"],
                "sigma_policy": seen["sigma_policy"],
                "sigma_human": sigmas(learner, state, here, actions[:, None]),
                "action": action,
                "sigma_human_there": info.sigma_human,
                "advice": np.array([advice]),
                "rate": info.rate,
            }
        )
        state = after
    stacked = {name: np.stack([np.squeeze(row[name]) for row in rows]) for name in rows[0]}
    return Situations(x=x, actions=actions, parameters=parameters_of(learner), **stacked)


def plane(episodes: int, seed: int = 0, angles: int = 181, velocities: int = 145) -> Plane:
    """Figs. 3.3 and 5.3: the pendulum after so many episodes with a teacher that does not err (`probing.taught`)."""
    (cell,), (lane,) = taught(episodes, [seed])
    return plane_of(cell, lane, angles, velocities)


def plane_of(cell: Cell, lane: Lane, angles: int = 181, velocities: int = 145) -> Plane:
    """What the learner of a finished lane holds over the pendulum's plane."""
    learner = as_gpc(lane.learner)
    theta, theta_dot = np.linspace(-np.pi, np.pi, angles), np.linspace(-8.0, 8.0, velocities)
    grid = np.stack([*np.broadcast_arrays(np.cos(theta), np.sin(theta), theta_dot[:, None])], -1)
    seen = look(learner, lane.state, grid.reshape(-1, 3))
    maps = {name: values.reshape(grid.shape[:2]) for name, values in seen.items()}
    return Plane(
        theta=theta,
        theta_dot=theta_dot,
        rate=maps["sigma_policy"] + maps["sigma_human"] + float(learner.constant_rate),
        dictionary=angles_of(lane.state.policy),
        advised=angles_of(lane.state.human),
        returns=np.asarray(lane.rows.returns),
        settings=np.array(
            [
                f"{name} = {getattr(cell, name)}"
                for name in ("env", "oracle", "error", "delta", "rate", "seed", "episodes")
            ]
        ),
        parameters=parameters_of(learner),
        **maps,
    )


def sparsification(advices: int = 12) -> Sparsification:
    """Fig. 3.4: "more" again and again at one state, with the cart-pole's hyperparameters (Table 5.2)."""
    rows: dict[str, list[list[float]]] = {
        name: [] for name in ("action", "target", "after", "rate", "points")
    }
    obs = np.array(CARTPOLE_STATE)
    for sparsify in (False, True):
        learner = as_gpc(make_learner("gpc", "cartpole", capacity=16, sparsify=sparsify))
        state, seen = idle_state(learner), []
        for _ in range(advices):
            action = float(learner.act(state, obs)[0])
            state, info = learner.correct(state, obs, [action], [1.0])
            rate, after = float(info.rate[0]), float(learner.act(state, obs)[0])
            seen.append((action, action + rate, after, rate, int(state.policy.count[0])))
        for column, values in zip(rows.values(), zip(*seen, strict=True), strict=True):
            column.append(list(values))
    arrays = {name: np.array(values) for name, values in rows.items()}
    return Sparsification(state=obs, parameters=parameters_of(learner), **arrays)


def erroneous(advices: int = 16, wrong: int = 3, target: float = 1.0, tolerance: float = 0.05) -> Erroneous:
    """Fig. 5.9 for GPC and GPC-NS, with the cart-pole's hyperparameters (Table 5.2) but for l_h.

    The thesis shows it where it discusses GPC-NS, and does not tell its numbers.
    """
    algorithms = ("gpc", "gpc-ns")
    scanned, wrongs = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0), (2, 3, 4)
    runs, samples, parameters = [], [], []
    for algo in algorithms:
        learners = {
            scale: as_gpc(make_learner(algo, "cartpole", capacity=16, human_length_scale=scale))
            for scale in {*scanned, SHORT, LONG}
        }
        runs.append([_advise(learners[scale], advices, wrong, target, tolerance) for scale in (SHORT, LONG)])
        samples.append(
            [
                [_advise(learners[scale], advices, k, target, tolerance)["samples"] for k in wrongs]
                for scale in scanned
            ]
        )
        parameters.append(parameters_of(make_learner(algo, "cartpole"), "l_h"))
    stacked = {name: np.array([[run[name] for run in pair] for pair in runs]) for name in runs[0][0]}
    return Erroneous(
        algorithms=np.array(algorithms),
        length_scales=np.array([SHORT, LONG]),
        wrong=np.array(wrong),
        thesis_length_scales=np.array(
            [find("task", "cartpole").presets[algo]["human_length_scale"] for algo in algorithms]
        ),
        scanned_length_scales=np.array(scanned),
        scanned_wrong=np.array(wrongs),
        scanned_samples=np.array(samples),
        target=np.array(target),
        tolerance=np.array(tolerance),
        state=np.array(CARTPOLE_STATE),
        parameters=np.array(parameters),
        **stacked,
    )


def _advise(learner: GPC, advices: int, wrong: int, target: float, tolerance: float) -> dict[str, Any]:
    """One run: what each advice met and did, NaN once the teacher is silent, and the samples of compensation.

    The advice that errs is one that the teacher gives; where it is silent, as in Alg. 4, nothing is inverted.
    """
    names = ("advice", "rate", "sigma_policy", "sigma_human")
    columns: dict[str, Any] = {name: np.full(advices, np.nan) for name in names}
    actions, samples, state = np.full(advices + 1, np.nan), np.nan, idle_state(learner)
    actions[0] = 0.0
    for k in range(advices):
        if target - actions[k] < tolerance:
            break
        advice = -1.0 if k + 1 == wrong else 1.0
        state, info = learner.correct(state, np.array(CARTPOLE_STATE), [actions[k]], [advice])
        actions[k + 1] = float(learner.act(state, np.array(CARTPOLE_STATE))[0])
        columns["advice"][k] = advice
        for name in names[1:]:
            columns[name][k] = float(getattr(info, name)[0])
        if np.isnan(samples) and k >= wrong and actions[k + 1] >= actions[wrong - 1]:
            samples = k + 1 - wrong
    return {"action": actions, "samples": samples, **columns}
