"""The shipped oracles: policies that GPC learned, as the thesis' oracles were, and networks that learned without it.

For each task the teacher of its `gpc` oracles is the expert that no learner made, without errors. Kept are the first of
seeds 0, 1, 2, ... whose final policies, over 100 starts, do no worse than one standard error below that expert; as many
as the task has `gpc` oracles. Its `network` learns by reinforcement, from the task's reward alone (`gpcjax.sweep.ppo`):
the first of seeds 0, 1, 2, ... that is as good is kept. Tasks of brax are trained by brax
(`gpcjax.sweep.brax_oracles`); what does not ship goes into the folder `oracles/`.

Run as `python -m gpcjax.sweep.oracles ENV...`, on one thread like all that is recorded (`gpcjax.sweep.executors`).
"""

import dataclasses
import shutil
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax._x64 import seeded_key
from gpcjax.engine.evaluate import evaluate
from gpcjax.engine.pool import Finished
from gpcjax.envs.registry import make_env, make_expert, shipped
from gpcjax.policies.base import Controller, Policy
from gpcjax.policies.saved import save_controller, shipped_path
from gpcjax.sweep.brax_oracles import trained
from gpcjax.sweep.build import make_pool, start_of
from gpcjax.sweep.plan import Cell, plan
from gpcjax.sweep.ppo import Training, train
from gpcjax.sweep.spec import as_dict, spec_of

STARTS = 100
SEEDS = 32
NETWORK_SEEDS = 8

EXPERTS = {"cartpole": "lqr", "pendulum": "energy"}
"""Who no learner made: the teacher of the `gpc` oracles, and the measure of all."""

TEACHING: dict[str, dict[str, float]] = {
    "cartpole": {},
    # Within 40 episodes and a tolerance of 0.05 no seed comes near the swing-up's return: it needs fine corrections.
    "pendulum": {"episodes": 100, "delta": 0.01},
}
"""Settings of the sweep that makes `gpc` oracles, beside a sweep's defaults."""

NETWORKS: dict[str, Training] = {
    "cartpole": Training(scale=(1.0, 1.0, 5.0, 1.0), reward_scale=0.05, discount=0.99, updates=100),
    "pendulum": Training(scale=(1.0, 1.0, 0.25), reward_scale=0.1, discount=0.97, updates=300),
}
"""How the networks learn."""


def build(envs: Iterable[str]) -> None:
    """Learns the oracles of each task anew and puts them into the package; says what it did.

    Raises:
        RuntimeError: too few of the seeds were good enough.
    """
    for name in envs:
        if name.startswith("brax:"):
            _train(name)
        elif shipped(name):
            _build(name)
        else:
            print(f"{name}: its oracle is no learned policy")


def _build(env_name: str) -> None:
    expert_name = EXPERTS[env_name]
    target = np.asarray(evaluate(make_env(env_name), make_expert(env_name, expert_name), STARTS).returns)
    folders = shipped(env_name)
    network = folders.pop("network")
    _teach(env_name, expert_name, list(folders.values()), target)
    _reinforce(env_name, expert_name, network, target)


def _train(env_name: str) -> None:
    """A network for a task of brax; into the package where it ships, otherwise into a folder here."""
    controller, provenance = trained(env_name.removeprefix("brax:"))
    for name in shipped(env_name).values():
        _ship(name, controller, provenance)
        return
    path = Path("oracles", env_name.replace(":", "-"))
    shutil.rmtree(path, ignore_errors=True)
    save_controller(path, controller, provenance)
    print(f"{env_name}: return {provenance['return_mean']:.1f} over {STARTS} starts; use it as ORACLE={path}")


def _teach(env_name: str, teacher: str, names: list[str], target: np.ndarray) -> None:
    """GPC learns from `teacher`, whose returns are `target`; ships as many policies as there are names."""
    spec = spec_of(env=env_name, algo="gpc", oracle=teacher, seeds=SEEDS, **TEACHING[env_name])
    finished = _run(plan(spec))
    tried = []
    for run in sorted(finished, key=lambda run: run.name.seed):
        controller = run.lane.controller
        returns = _returns(env_name, controller)
        if _good(returns, target):
            seed = run.name.seed
            _ship(names.pop(0), controller, {
                "env": env_name,
                "learner": "gpc",
                "teacher": teacher,
                "seed": seed,
                "specification": as_dict(spec),
                "corrections": int(run.lane.rows.corrections.sum()),
                **_reached(returns, "teacher", target),
                "returns_of_earlier_seeds": tried,
            })  # fmt: skip
        tried = [*tried, round(float(returns.mean()), 1)]
        if not names:
            return
    raise RuntimeError(f"{env_name}: too few seeds below {SEEDS} are as good as {teacher}; returns: {tried}")


def _reinforce(env_name: str, expert_name: str, name: str, target: np.ndarray) -> None:
    """A network learns from the task's reward alone; ships the first that is as good as the expert."""
    training, tried = NETWORKS[env_name], []
    for seed in range(NETWORK_SEEDS):
        controller, _ = train(make_env(env_name), training, seeded_key(seed))
        returns = _returns(env_name, controller)
        if _good(returns, target):
            _ship(name, controller, {
                "env": env_name,
                "learner": "ppo",
                "seed": seed,
                "steps": training.steps,
                "optimiser": "adam",
                "training": dataclasses.asdict(training),
                "expert": expert_name,
                **_reached(returns, "expert", target),
                "returns_of_earlier_seeds": tried,
            })  # fmt: skip
            return
        tried = [*tried, round(float(returns.mean()), 1)]
    raise RuntimeError(
        f"{env_name}: no network below seed {NETWORK_SEEDS} is as good as {expert_name}: {tried}"
    )


def _returns(env_name: str, controller: Controller) -> np.ndarray:
    return np.asarray(evaluate(make_env(env_name), Policy(controller), STARTS).returns)


def _good(returns: np.ndarray, target: np.ndarray) -> bool:
    """No worse than one standard error below those of an expert."""
    return bool(returns.mean() >= target.mean() - target.std(ddof=1) / np.sqrt(STARTS))


def _reached(returns: np.ndarray, who: str, target: np.ndarray) -> dict[str, Any]:
    """For the card: what the policy and the expert it is measured by reach."""
    return {
        "starts": STARTS,
        "return_mean": float(returns.mean()),
        "return_std": float(returns.std(ddof=1)),
        f"{who}_return_mean": float(target.mean()),
        f"{who}_return_std": float(target.std(ddof=1)),
    }


def _run(cells: list[Cell]) -> list[Finished]:
    pool, starts, finished = make_pool(cells[0]), iter(cells), []
    pool.run(lambda: next((start_of(cell) for cell in starts), None), finished.append)
    return finished


def _ship(name: str, controller: Controller, provenance: dict[str, Any]) -> None:
    path = shipped_path(name)
    with tempfile.TemporaryDirectory(dir=path.parent.parent) as scratch:
        fresh = Path(scratch) / name
        save_controller(fresh, controller, provenance)
        shutil.rmtree(path, ignore_errors=True)
        path.parent.mkdir(exist_ok=True)
        fresh.rename(path)
    print(f"{name}: seed {provenance['seed']}, return {provenance['return_mean']:.1f} over {STARTS} starts")


if __name__ == "__main__":
    build(sys.argv[1:])
